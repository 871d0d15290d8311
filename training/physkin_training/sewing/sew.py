"""Sew a cut around a body: seams close around a paper doll of it, the doll grows to the body's shape, and cloth hangs.

The doll is the body shrunk towards its bones and pressed flat, with panels in front of it and behind it. Every step
minimises an incremental potential, from rest until cloth falls, so that little swings, and cloth keeps off itself. Most
of it is done with a draft in longer edges.

Dimensions: `t` vertices of a cut, `n` of the sewn garment, `V` of the body. Metres, root frame, canonical pose.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import torch

from physkin_core.avatar.avatar import Avatar
from physkin_core.model.garment import Garment, GarmentError
from physkin_core.model.garment_model import Material
from physkin_core.model.rest_shape import flat_areas
from physkin_core.model.surface_paths import pieces
from physkin_core.rig.rig import Rig
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY
from physkin_training.contact.surface_queries import BodySurface
from physkin_training.dynamics.incremental_potential import IncrementalPotential
from physkin_training.dynamics.step_solver import StepSolver
from physkin_training.energies.energy import view
from physkin_training.energies.motion import Dynamics
from physkin_training.energies.seams import THREAD_GAP, Seams
from physkin_training.physics.energy_hessian import EnergyHessian
from physkin_training.physics.newton_solver import Point
from physkin_training.quiet_warp import wp
from physkin_training.sewing.cloth_contact import ClothContact
from physkin_training.sewing.cut import Cut
from physkin_training.sewing.paper_doll import Arms, paper_doll
from physkin_training.sewing.pattern import PatternError
from physkin_training.sewing.squashed_faces import opened, squashed

__all__ = ["sewn"]

Watch = Callable[[np.ndarray, np.ndarray, np.ndarray], None]

NEAR = 0.3
"""Share of the panels' distance in front of or behind the root that is left when sewing begins."""
LIFT, LIFT_STEP = 0.12, 0.01
"""[m] How far panels are lifted at most, for shoulders higher than those of the pattern's body, and in what steps."""
CLEARANCE = 0.03
"""[m] How much lower panels could hang without a seam that closes through the doll."""
MOST_THROUGH = 0.7
"""Share of a seam that may close through the doll: up to 0.4 does where a bodice hangs low, all of it between wrong
edges."""
CLOSING, SETTLING, GROWING, SOFTENING, HANGING, CALMING = 25, 5, 40, 30, 25, 15
"""Steps of each phase. First seams close within sleeves, within the body and within legs, then, in as many steps, those
between them; closed all at once, sleeves would leave the arms. Then seams settle, the doll grows to the body's shape,
cloth becomes soft while arms go down and hands grow, and hangs. Last the garment in its own edges comes to rest."""
HIGHEST = 0.05
"""While seams close, the panel that stays at its height is held by its seams up to this far [m] below the highest, so
that nothing pulls a bodice off the shoulders."""
STEP, CARDBOARD_STEP, CALM_STEP = 0.05, 0.5, 0.02
"""[s] of a step: in the first, gravity alone moves cloth by 2.5 cm; in the second, next to nothing holds it; in the
third, the garment comes to rest."""
MOMENTUM = 0.7
"""Share of its movement in the last step with which cloth goes on under the whole of gravity, so that it falls in few
steps and yet swings little."""
CARDBOARD = 300.0
"""Times that cloth bends as stiffly until then: panels come together as they are instead of curling up, and sleeves
stay open."""
SEAM_STIFFNESS = 100.0, 3000.0
"""[N/m] of a pair of vertices while seams close, and once they are closed."""
LIGHT = 0.1
"""Of gravity while the doll grows: cloth stays on the shoulders, and does not slip off while they are narrow."""
NO_SEAMS = np.zeros((0, 2), dtype=np.int32)
STILL = 5e-4
"""[m] Cloth of which nothing moves farther in a step hangs."""
LARGEST_GAP = 0.01  # [m]
CLOSING_OFFSET = 0.006
"""[m] at which the body is felt until the cloth hangs, however far from it that is to be: sleeves leave raised arms
little room."""
REACH = 0.3
LOOKS = 4
"""Times in a step that cloth is looked for beside cloth which moves far."""
EFFORT = {"tolerance": 1e-3, "iterations": 4, "products": 60}
"""Of a step: residual force [N], Newton steps, matrix products for each."""


def sewn(
    cut: Cut,
    avatar: Avatar,
    rig: Rig,
    material: Material,
    device: torch.device,
    *,
    draft: Cut | None = None,
    watch: Watch | None = None,
) -> Garment:
    """The garment that a cut makes, as it hangs on an avatar in the canonical pose, with its panels as rest shape.

    Panels hang about a body of the avatar's size that stands on its floor. draft: the same pattern in longer edges, for
    all until the garment hangs, which is then quicker; default the cut itself. watch: called after every step with the
    vertices, their faces and the body's vertices. Raises PatternError for a panel without a stitch, and where seams do
    not close or no surface is sewn.
    """
    draft = draft or cut
    if loose := set(range(len(cut.names))) - set(cut.panel_of[cut.seams].flat):
        raise PatternError(f"panel {cut.names[min(loose)]!r} is not sewn to anything; every panel needs a stitch")
    watch = watch or (lambda *_: None)
    doll = paper_doll(avatar, rig)
    body = wp.Mesh(view(_vectors(doll, device)), wp.array(avatar.faces.ravel(), dtype=wp.int32, device=str(device)))
    vertex, hung = _sewn_together(draft), _about(draft, doll, avatar)
    for closed, shape in _close(draft, vertex, hung, material, body, (doll, avatar.vertices), Arms(avatar, rig)):
        watch(closed, draft.faces, shape)
    _check_closed(draft, closed)
    shape = _at_seams(closed, vertex)[vertex]
    vertex = _sewn_together(cut)
    garment = _made(cut, _at_seams(_laid_on(cut, draft, shape), vertex), vertex[cut.faces])
    cloth = _Cloth(garment, material, body, garment.vertices, cut, np.unique(vertex, return_index=True)[1], vertex)
    hanging = garment.vertices
    for _ in range(CALMING):
        before, hanging = hanging, cloth.step(1.0, seconds=CALM_STEP, momentum=MOMENTUM)
        watch(hanging, garment.faces, avatar.vertices)
        if np.linalg.norm(hanging - before, axis=1).max() < STILL:
            break
    return _made(cut, hanging, garment.faces)


def _laid_on(cut: Cut, draft: Cut, shape: np.ndarray) -> np.ndarray:
    """Vertices (t, 3) of a cut on the surface that a draft of the same pattern has, vertices (t', 3) `shape`."""
    places = np.empty_like(cut.hung)
    for panel in range(len(cut.names)):
        vertices = np.unique(draft.faces[draft.panel == panel])
        faces = np.searchsorted(vertices, draft.faces[draft.panel == panel])
        own = cut.panel_of == panel
        closest = BodySurface(_flat(draft.drawn[vertices]), faces).closest(_flat(cut.drawn[own]))
        places[own] = np.einsum("vc,vcx->vx", closest.barycentric, shape[vertices][faces[closest.face]])
    return places


def _flat(places: np.ndarray) -> np.ndarray:
    return np.column_stack([places, np.zeros(len(places))])


def _sewn_together(cut: Cut) -> np.ndarray:
    """(t,) the vertex of the garment that each of the cut becomes. Raises PatternError where more than two faces would
    share an edge, before anything is simulated."""
    vertex = pieces(cut.seams, len(cut.places))
    edges = np.sort(vertex[cut.faces][:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1)
    _, first, count = np.unique(edges, axis=0, return_index=True, return_counts=True)
    if count.max() > 2:
        panel = cut.names[cut.panel[first[count.argmax()] // 3]]
        raise PatternError(
            f"it cannot be sewn so: an edge of panel {panel!r} would join {count.max()} pieces of cloth, at most 2 are "
            "allowed; is it in two stitches?"
        )
    return vertex


def _about(cut: Cut, doll: np.ndarray, avatar: Avatar) -> np.ndarray:
    """Where the vertices (t, 3) [m] of a cut begin: every panel close to the flat doll and at the height of those that
    it is sewn to. All are lifted so that as few seams as possible close through the doll, here and up to CLEARANCE
    lower. Raises PatternError for a stitch that would still do so."""
    hung = cut.hung + [0.0, 0.0, avatar.vertices[:, 2].min()]
    panel_of = cut.panel_of
    hung[:, 0] -= (1 - NEAR) * (np.bincount(panel_of, hung[:, 0]) / np.bincount(panel_of))[panel_of]
    hung[:, 2] += _against_each_other(hung[:, 2], cut)[panel_of]
    surface, below = BodySurface(doll, avatar.faces), round(CLEARANCE / LIFT_STEP)
    lifts = LIFT_STEP * np.arange(-below, round(LIFT / LIFT_STEP) + 1)
    through = np.array([_closing_through(hung + [0.0, 0.0, lift], cut.seams, surface) for lift in lifts])
    windows = np.lib.stride_tricks.sliding_window_view(through.sum(axis=1), below + 1).sum(axis=1)
    lift = below + windows.argmin()
    stitches, stitch = np.unique(cut.stitches, return_inverse=True)
    share = np.bincount(stitch, through[lift]) / np.bincount(stitch)
    if share.max() > MOST_THROUGH:
        raise PatternError(
            f"the seam of {stitches[share.argmax()]} would close through the body, as these panels hang; are they the "
            "right edges, and does it fit the body?"
        )
    return hung + [0.0, 0.0, lifts[lift]]


def _staying(cut: Cut) -> int:
    """The panel that stays at its height, so that a skirt comes up to its bodice and a hood down to it: the largest one
    for the body, or the largest of all."""
    areas = np.bincount(cut.panel, flat_areas(cut.places[cut.faces]))
    on_body = np.array(cut.labels) == "body"
    return int((areas * (on_body if on_body.any() else 1.0)).argmax())


def _against_each_other(heights: np.ndarray, cut: Cut) -> np.ndarray:
    """How far (p,) [m] to move each panel up so that the ends of seams are at heights (t,) as equal as possible."""
    panels, rows = cut.panel_of[cut.seams], np.arange(len(cut.seams))
    between = np.zeros((len(rows) + 1, len(cut.names)))
    between[rows, panels[:, 0]] += 1.0
    between[rows, panels[:, 1]] -= 1.0
    between[-1, _staying(cut)] = 1.0
    apart = heights[cut.seams[:, 1]] - heights[cut.seams[:, 0]]
    return np.linalg.lstsq(between, np.append(apart, 0.0), rcond=None)[0]


def _closing_through(hung: np.ndarray, seams: np.ndarray, body: BodySurface) -> np.ndarray:
    """Which (s,) of the seams' pairs close through the body."""
    ends = hung[seams]
    apart = ends[:, 1] - ends[:, 0]
    length = np.maximum(np.linalg.norm(apart, axis=1, keepdims=True), 1e-9)
    through = np.zeros(len(seams), bool)
    for start, direction in ((ends[:, 0], apart / length), (ends[:, 1], -apart / length)):  # faces are met from outside
        face, at = body.facing(start, direction, float(length.max()))
        hit = np.einsum("sc,scx->sx", at, body.vertices[body.faces[face]])
        through |= (face >= 0) & (np.linalg.norm(hit - start, axis=1) < length[:, 0])
    return through


def _close(
    cut: Cut,
    vertex: np.ndarray,
    hung: np.ndarray,
    material: Material,
    body: wp.Mesh,
    shapes: tuple[np.ndarray, np.ndarray],
    arms: Arms,
) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Vertices (t, 3) of the cut and (V, 3) of the body step by step, until seams are closed about its own shape.

    shapes: of the body, the doll and its own."""
    doll, skin = shapes
    flat = Garment(np.column_stack([cut.places, np.zeros(len(cut.places))]), cut.faces)
    pairs = np.concatenate([cut.seams, cut.threads])
    material = replace(material, contact_offset=CLOSING_OFFSET)
    cloth = _Cloth(flat, material, body, hung, cut, np.arange(len(vertex)), vertex, pairs=pairs)
    cloth.bend_stiffer(CARDBOARD)
    cloth.contact.let_through()
    seams, (loose, tight) = cloth.seams, SEAM_STIFFNESS
    seams.stiffness.fill_(loose)
    apart = torch.as_tensor(np.linalg.norm(hung[pairs[:, 1]] - hung[pairs[:, 0]], axis=1))
    last = torch.as_tensor(np.repeat([0.0, THREAD_GAP], [len(cut.seams), len(cut.threads)]))
    heights = hung[cut.seams, 2].mean(axis=1)
    staying = (cut.panel_of[cut.seams] == _staying(cut)).any(axis=1)
    highest = cut.seams[staying & (heights > heights[staying].max() - HIGHEST)]
    labels = np.unique(cut.labels, return_inverse=True)[1][cut.panel_of[pairs]]
    begins = torch.as_tensor(np.where(labels[:, 0] == labels[:, 1], 0, CLOSING))
    for count in range(1, 2 * CLOSING + SETTLING + 1):
        seams.gap.copy_(torch.maximum(apart * (1 - (count - begins) / CLOSING).clamp(0.0, 1.0), last))
        shape = cloth.meets(arms.raised(doll))
        closed = cloth.step(0.0, seconds=CARDBOARD_STEP)
        arms.follow(cut, hung, closed)
        yield cloth.raised((hung[highest] - closed[highest])[..., 2].mean()), shape
    seams.stiffness.fill_(tight)
    cloth.contact.let_none_through()
    for count in range(1, GROWING + 1):
        shape = cloth.meets(arms.raised(doll + (count / GROWING) * (arms.without_hands(skin) - doll)))
        yield cloth.step(LIGHT), shape
    for count in range(1, SOFTENING + HANGING + 1):
        left = max(1 - count / SOFTENING, 0.0)
        cloth.bend_stiffer(CARDBOARD**left)
        shape = cloth.meets(arms.raised(arms.without_hands(skin, left), left))
        yield cloth.step(1.0, momentum=MOMENTUM), shape


def _check_closed(cut: Cut, closed: np.ndarray) -> None:
    """Raises PatternError where a seam of vertices (t, 3) is open."""
    gaps = np.linalg.norm(closed[cut.seams[:, 1]] - closed[cut.seams[:, 0]], axis=1)
    if not gaps.max() <= LARGEST_GAP:
        raise PatternError(
            f"the seam of {cut.stitches[gaps.argmax()]} does not close: {1000 * gaps.max():.0f} mm are left, allowed "
            f"are {1000 * LARGEST_GAP:g} mm; does it fit the body?"
        )


def _at_seams(closed: np.ndarray, vertex: np.ndarray) -> np.ndarray:
    """Vertices (n, 3) in the middle of those of a cut (t, 3) that become one."""
    return np.stack([np.bincount(vertex, axis) for axis in closed.T], axis=1) / np.bincount(vertex)[:, None]


def _made(cut: Cut, vertices: np.ndarray, faces: np.ndarray) -> Garment:
    """The garment of vertices (n, 3) and faces (f, 3). Where few faces are squashed, they are pulled open."""
    panels = cut.places, cut.faces
    vertices = opened(vertices, faces, *panels)
    vertex = np.empty(len(cut.places), int)
    vertex[cut.faces] = faces
    try:
        return Garment(vertices, faces, None, *panels, vertex[cut.threads] if len(cut.threads) else None)
    except GarmentError as error:
        bad = squashed(vertices, faces, *panels)
        most = cut.names[np.bincount(cut.panel[bad]).argmax()] if bad.any() else None
        where = f" ({bad.sum()} faces are squashed or drawn out, most of them of panel {most!r})" if most else ""
        raise PatternError(f"it cannot be sewn so, or does not fit the body{where}: {error}") from error


class _Cloth:
    """A garment at `start` (n, 3) [m] that moves from rest step by step, in contact with a body and with itself.

    of: (n,) a vertex of the cut that each vertex is, and vertex: (t,) what they become, see `_sewn_together`. pairs:
    (s, 2) vertices that `seams` draws together, default none.
    """

    def __init__(
        self,
        garment: Garment,
        material: Material,
        body: wp.Mesh,
        start: np.ndarray,
        cut: Cut,
        of: np.ndarray,
        vertex: np.ndarray,
        *,
        pairs: np.ndarray = NO_SEAMS,
    ) -> None:
        device = torch.device(wp.device_to_torch(body.device))
        still = Dynamics(air_drag=0.0, relaxation=0.0)
        self._potential = IncrementalPotential(garment, material, 1, device, step=STEP, dynamics=still, reach=REACH)
        self._down, self._here = _vectors(UPRIGHT_GRAVITY, device)[None], _vectors(start, device)[None]
        self._before = self._here
        cloth = self._potential.cloth
        self.seams = Seams(cloth, pairs, stiffness=0.0)
        self.contact = ClothContact(cloth, vertex[of], cut.panel_of[of], cut.places[of])
        self.contact.look(self._here)
        self._potential.energies += [self.seams, self.contact]
        self._solver = _Solver(EnergyHessian(self._potential), self.contact)
        self._body, self._nowhere = body, torch.zeros(1, 3, device=device)

    def bend_stiffer(self, times: float) -> None:
        """Let cloth bend so many times as stiffly as its material does."""
        self._potential.bend.stiffer.fill_(times)

    def meets(self, shape: np.ndarray) -> np.ndarray:
        """From now on the body has these vertices (V, 3) [m]; they are returned."""
        points = wp.to_torch(self._body.points)
        points.copy_(_vectors(shape, points.device))
        self._body.refit()
        return shape

    def step(self, gravity: float, *, seconds: float = STEP, momentum: float = 0.0) -> np.ndarray:
        """One step under a share of gravity, which goes on with a share of the last one's movement; vertices (n, 3)."""
        self._potential.time_step.seconds = seconds
        self._potential.begin(self._here, self._here + momentum * (self._here - self._before))
        self._before = self._here
        for _ in range(LOOKS):
            self.contact.look(self._here)
            solution = self._solver.minimise(self._here, gravity * self._down, self._body, self._nowhere, **EFFORT)
            self._here = solution.vertices
            if not self.contact.is_held_back(self._here):
                break
        return self._here[0].double().cpu().numpy()

    def raised(self, height: float) -> np.ndarray:
        """All of it moved up by a height [m]; vertices (n, 3)."""
        self._here = self._here + height * _vectors([0.0, 0.0, 1.0], self._here.device)
        return self._here[0].double().cpu().numpy()


class _Solver(StepSolver):
    """Takes no step that brings cloth through itself."""

    def __init__(self, hessian: EnergyHessian, contact: ClothContact) -> None:
        super().__init__(hessian, torch.ones(len(contact.elements), device=hessian.losses.cloth.device))
        self._contact = contact

    def step(self, here: Point) -> torch.Tensor:
        return self._contact.kept_apart(here.vertices + super().step(here)) - here.vertices


def _vectors(array: np.ndarray, device: torch.device) -> torch.Tensor:
    return torch.tensor(np.asarray(array), dtype=torch.float32, device=device)

"""Quality figures of a garment model on held-out bodies, beside plain skinning and the two minima.

Poses are uniform in the joint limits, or frames of motion; deterministic for a seed on one kind of device.
Dimensions: `B` samples of a batch, `n` garment vertices, `m` garment nodes.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cached_property

import numpy as np
import torch

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.check.sight import Cameras, Figure, Surface, what_shows, who_covers
from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.surface_paths import hem_distances
from physkin_core.motion.motion import Motion
from physkin_core.progress import progress_line
from physkin_core.rig.rig import Rig
from physkin_core.runtime.frame_input import STANDARD_GRAVITY
from physkin_core.runtime.garment_on_body import checked_fit
from physkin_core.separation.limb_separator import LimbSeparator
from physkin_training.contact.surface_queries import piercing_edges
from physkin_training.contact.wearing import Wearing
from physkin_training.energies.rest_data import RestData
from physkin_training.evaluate.figures import Figures
from physkin_training.evaluate.minimum import subspace_minimum
from physkin_training.networks.draping import Drape, RestShape, compose_nodes, delta_transforms
from physkin_training.networks.export import drape_from_model, encode_bodies
from physkin_training.networks.made_to_measure import MadeToMeasure
from physkin_training.physics.full_space_solver import FullSpaceSolver
from physkin_training.physics.newton_solver import Solution
from physkin_training.physics.physics_losses import Energies, PhysicsLosses
from physkin_training.sampling.chosen_bodies import held_out_groups
from physkin_training.sampling.evaluation_pairs import Pairs, motion_pairs, uniform_pairs
from physkin_training.sampling.posed_bodies import BodySet, PosedBodies

__all__ = ["Evaluation", "counting_line", "evaluate_model", "measured_clips"]

REACH = 0.3
"""Bodies are looked for up to this distance [m], beyond the deepest penetration."""
LARGEST_MEASURED, LARGEST_MINIMISED = 512, 64
"""Batches on a GPU: of pairs that are measured, and minimised."""
MINIMUM_COST = 500
"""How many measured pairs take about as long as one that is minimised."""
LOOKED_AT, CROSSED = 32, 128
"""Pairs that cameras look at, and that are searched for cloth in itself, spread over all: some tenths of a second each,
and some hundredths."""
OF_A_GROUP = 512
"""Pairs of each set, at most, on which a group of bodies is measured, spread over all."""
MOTION_RATE = 60.0
"""Frames a second at which motion is measured; clips of another rate are resampled."""


@dataclass(frozen=True)
class Batch:
    """One batch of held-out (body, pose) pairs, ready to drape. The first `count` count, the others only fill it up."""

    count: int
    posed_nodes: torch.Tensor
    modulation: torch.Tensor
    positions: torch.Tensor
    gravity: torch.Tensor
    body: torch.Tensor
    rest: RestShape | None = None


class Evaluation:
    """Held-out bodies and seeded poses for one garment model on one device.

    bodies: how many, the first of the held-out adults; or the indices of which ones. of: (S, c) shape coefficients of
    other bodies than these. fit: of the garment, as in `Draper`; strains are against the rest shape at that fit.
    wearing: of the garment, if it has been found already. watch: is told of every batch how many measured pairs it was
    worth.
    Raises ValueError when the model is for another rig than the body model's, or there are not so many bodies.
    """

    def __init__(
        self,
        model: GarmentModel,
        device: torch.device,
        *,
        bodies: int | Sequence[int],
        poses: int,
        seed: int,
        batch: int = 64,
        of: np.ndarray | None = None,
        fit: float | None = None,
        wearing: Wearing | None = None,
        watch: Callable[[int], None] = lambda pairs: None,
    ) -> None:
        fit = checked_fit(model, fit)
        body_model = load_body_model()
        held_out = body_model.held_out_bodies if of is None else of
        if isinstance(bodies, int):
            if not 1 <= bodies <= len(held_out):
                raise ValueError(f"bodies must be 1 to {len(held_out)}, got {bodies}")
            bodies = range(bodies)
        if poses < 1:
            raise ValueError(f"poses must be at least 1, got {poses}")
        if model.rig.to_json() != body_model.rig.to_json():
            difference = _difference(model.rig, body_model.rig)
            raise ValueError(f"garment model {model.name!r} is for another rig than the body model's: {difference}")
        self.model, self.device, self.poses, self.seed, self.watch = model, device, poses, seed, watch
        self.drape: Drape = drape_from_model(model).to(device).eval()
        self.bodies = BodySet(body_model, held_out[list(bodies)], device)
        self.batch = min(batch, len(bodies) * poses)
        self.posed_bodies = PosedBodies(body_model, self.bodies, self.batch)
        self.wearing = wearing or Wearing.of(model.garment, body_model)
        self._fits: MadeToMeasure | None = None
        if fit:
            self._fits = MadeToMeasure(model.garment, self.drape, self.bodies, body_model, fit=fit)
        shapes = self._fits.shapes if self._fits else None
        self.rest = RestData(model.garment, model.material, device, shapes=shapes)
        self.losses = PhysicsLosses(
            model.garment, model.material, self.batch, device, wearing=self.wearing, reach=REACH, rest=self.rest
        )
        self._body_model = body_model
        self.modulations = encode_bodies(self.drape, self.bodies.vertices.cpu().numpy(), body_model.faces, fit=fit)
        self.node_positions = self.drape.node_positions(self.bodies)

    def uniform(self, *, upright: bool) -> Pairs:
        """The seed's pairs of every body with `poses` poses uniform in the limits."""
        return uniform_pairs(self.model.rig, bodies=len(self.bodies), poses=self.poses, seed=self.seed, upright=upright)

    def batches(self, pairs: Pairs) -> Iterator[Batch]:
        """All pairs in order, `self.batch` at a time: kernels keep their size, so a last partial batch is filled up
        with pairs that do not count."""
        for start in range(0, len(pairs), self.batch):
            pick = torch.arange(start, start + self.batch) % len(pairs)
            q, g, b = (a[pick].to(self.device) for a in (pairs.positions, pairs.gravity, pairs.body))
            bones = self.posed_bodies.pose(q, b)
            positions, rest = self.node_positions[b], None
            if self._fits is not None:
                worn = self._fits.worn(b, torch.ones_like(b, dtype=torch.bool))
                positions, rest = worn.node_positions, worn.rest
                self.losses.rest_row.copy_(worn.rows)
            posed_nodes = self.drape.posed_nodes(bones, positions)
            yield Batch(min(self.batch, len(pairs) - start), posed_nodes, self.modulations[b], q, g, b, rest)

    def rest_garment(self, body: int) -> Garment:
        """The garment in the rest shape that body `body` of this evaluation wears."""
        garment = self.model.garment
        return garment.reshaped(self._fits.shape_of(body)) if self._fits else garment

    def new_figures(self) -> Figures:
        """Figures that count nothing yet, with strains against this evaluation's rest shapes."""
        return Figures(self.model.garment, self.device, rest=self.rest)

    def energy(self, vertices: torch.Tensor, batch: Batch) -> tuple[torch.Tensor, Energies]:
        """Mean energy and energies of drapes (B, n, 3) against the bodies of the batch posed last."""
        return self.losses(vertices, batch.gravity, self.posed_bodies.mesh, self.posed_bodies.offset)

    def count_in(self, figures: Figures, vertices: torch.Tensor, batch: Batch, *, motion: bool = False) -> None:
        """Count drapes (B, n, 3) of the batch posed last in. motion: they are frames, each body's a take."""
        with torch.no_grad():
            energies = self.energy(vertices, batch)[1]
        takes = batch.body if motion else None
        figures.add(vertices, energies, rest_row=self.losses.rest_row, takes=takes, count=batch.count)

    def figures(
        self, *, upright: bool, only: Collection[str] = ("model", "skinning", "fewer_influences")
    ) -> dict[str, dict[str, float]]:
        """The model, plain skinning, and the model by the skinning weights for engines ("fewer_influences"), over all
        pairs; of these, those in `only`."""
        rows = self._rows(self.uniform(upright=upright), only)
        return {name: figures.result() for name, figures in rows.items()}

    def of_a_group(self, clips: Sequence[Motion]) -> dict[str, dict[str, float]]:
        """The model on some of the pairs: `uniform`, and with clips `everyday`, of their frames, and `separated`, the
        same as they are worn where an avatar is drawn."""
        sets = {"uniform": self.uniform(upright=True).spread(OF_A_GROUP)}
        if clips:
            sets["everyday"] = Pairs.joined([self.frames(clip) for clip in clips]).spread(OF_A_GROUP)
            sets["separated"] = self.separated(sets["everyday"])
        return {name: self._rows(pairs, ["model"])["model"].result() for name, pairs in sets.items()}

    def separated(self, pairs: Pairs) -> Pairs:
        """The pairs with each body's limbs moved out of its trunk and each other."""
        avatars = (avatar_from_body(self._body_model, body) for body in self.bodies.coefficients)
        separators = [LimbSeparator(self.model.rig, avatar) for avatar in avatars]
        positions = [separators[body].separate(pose)[0] for pose, body in zip(pairs.positions.numpy(), pairs.body)]
        return replace(pairs, positions=torch.as_tensor(np.stack(positions)))

    def frames(self, motion: Motion) -> Pairs:
        """Every frame of a clip with every body, body by body."""
        return motion_pairs(motion, self.model.rig, bodies=len(self.bodies))

    def motion(self, motions: Sequence[Motion]) -> dict:
        """Model, also by skinning weights learnt for engines, and plain skinning on every frame of clips on every body:
        `model`, `fewer_influences`, `skinning`, `jitter_ratio`; `clips` by name with the same; `counts`.

        Raises MotionError when a clip moves none of the rig's joints, ValueError when one is too short, stands still or
        comes twice.
        """
        clips = {clip.name: clip for clip in measured_clips(motions)}
        total = {name: self.new_figures() for name in ("model", "skinning", "fewer_influences")}
        results: dict = {"clips": {}}
        for name, motion in clips.items():
            rows = self._rows(self.frames(motion), total, motion=True)
            for row, figures in rows.items():
                total[row].include(figures)
            results["clips"][name] = _with_jitter_ratio(rows)
        results["counts"] = {
            "clips": len(clips),
            "frames": sum(motion.frame_count for motion in clips.values()),
            "bodies": len(self.bodies),
            "rate_hz": MOTION_RATE,
        }
        return _with_jitter_ratio(total) | results

    def skin_seen(self, pairs: Pairs) -> dict[str, float]:
        """`skin_seen_percent` of the model's drapes of a few pairs, as `physkin check` finds it at rest: of the pixels
        that should show cloth those that show skin."""
        garment, faces = self.model.garment, self._body_model.faces
        hems = hem_distances(garment.vertices, garment.faces)

        def surfaces(body: np.ndarray, cloth: np.ndarray) -> list[Surface]:
            return [Surface(body, faces), Surface(cloth, garment.faces, hems)]

        made_on = self._body_model.vertices(self._body_model.garment_body)
        cover = who_covers(*surfaces(made_on, garment.vertices))
        shows = pixels = 0
        for body, cloth in self._own_drapes(pairs.spread(LOOKED_AT)):
            figure = Figure(surfaces(body, cloth), Cameras(cloth))
            shown = what_shows(figure, {(0, 1): cover})[0, 1]
            shows, pixels = shows + shown.shows, pixels + shown.pixels
        return {"skin_seen_percent": 100 * shows / max(pixels, 1)}

    def in_itself(self, pairs: Pairs) -> dict[str, float]:
        """`in_itself_percent` of the model's drapes of some of the pairs: vertices with an edge through the garment's
        own cloth."""
        garment, crossed, spread = self.model.garment, 0, pairs.spread(CROSSED)
        for _, cloth in self._own_drapes(spread):
            through = garment.edges[piercing_edges(cloth, garment.faces, garment.edges)]
            crossed += len(np.unique(through))
        return {"in_itself_percent": 100 * crossed / (len(spread) * len(garment.vertices))}

    def _own_drapes(self, pairs: Pairs) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """The body (V, 3) and the model's drape (n, 3) of each pair."""
        for batch in self.batches(pairs):
            bodies = self.posed_bodies.vertices[: batch.count].cpu().numpy()
            with torch.no_grad():
                drapes = self.own_drape(batch)[: batch.count].cpu().numpy()
            yield from zip(bodies, drapes)

    def _rows(self, pairs: Pairs, only: Collection[str], *, motion: bool = False) -> dict[str, Figures]:
        drapes = {name: self._fewer if name == "fewer_influences" else self.drape for name in only}
        rows = {name: self.new_figures() for name in drapes}
        with torch.no_grad():
            for batch in self.batches(pairs):
                raw, detail = self._corrections(batch)
                for name, drape in drapes.items():
                    plain = name == "skinning"
                    delta = delta_transforms(torch.zeros_like(raw) if plain else raw)
                    nodes = compose_nodes(batch.posed_nodes, delta)
                    vertices = drape.skin(nodes, batch.rest, None if plain else detail)
                    self.count_in(rows[name], vertices, batch, motion=motion)
                self.watch(batch.count)
        return rows

    @cached_property
    def _fewer(self) -> Drape:
        return drape_from_model(self.model.for_engines()).to(self.device).eval()

    def minima(self, pairs: Pairs) -> dict[str, dict[str, float]]:
        """The model, subspace minimum and full-space minimum on the pairs: `model_on_subset`, `subspace_minimum`,
        `minimum`.

        The full-space minimum starts from the lower of the other two. The latter also has the
        `converged_percent` of its samples (see `Solution`).
        """
        rows = {name: self.new_figures() for name in ("model_on_subset", "subspace_minimum", "minimum")}
        converged: list[bool] = []
        for batch in self.batches(pairs):

            def objective(vertices: torch.Tensor, batch: Batch = batch) -> torch.Tensor:
                return self.energy(vertices, batch)[0]

            with torch.no_grad():
                raw, detail = self._corrections(batch)
                own = self.own_drape(batch)
            subspace = subspace_minimum(objective, self.drape, batch.posed_nodes, raw, rest=batch.rest, detail=detail)
            with torch.no_grad():
                better = self.energy(subspace, batch)[1].total < self.energy(own, batch)[1].total
            solution = self.full_space_minimum(torch.where(better[:, None, None], subspace, own), batch)
            converged += solution.converged[: batch.count].tolist()
            for name, vertices in zip(rows, (own, subspace, solution.vertices)):
                self.count_in(rows[name], vertices, batch)
            self.watch(MINIMUM_COST * batch.count)
        results = {name: figures.result() for name, figures in rows.items()}
        results["minimum"]["converged_percent"] = 100 * sum(converged) / len(converged)
        return results

    def full_space_minimum(self, start: torch.Tensor, batch: Batch, **limits: int) -> Solution:
        """Minimise over all vertices from drapes (B, n, 3), against the bodies of the batch posed last. limits: of
        `FullSpaceSolver.minimise`."""
        bodies = self.posed_bodies
        return self._solver.minimise(start, batch.gravity, bodies.mesh, bodies.offset, **limits)

    @cached_property
    def _solver(self) -> FullSpaceSolver:
        return FullSpaceSolver(self.losses)

    def own_drape(self, batch: Batch) -> torch.Tensor:
        """What the model makes of a batch, (B, n, 3)."""
        return self.drape(batch.modulation, batch.positions, batch.gravity, batch.posed_nodes, batch.rest)

    def _corrections(self, batch: Batch) -> tuple[torch.Tensor, torch.Tensor | None]:
        vector = self.drape.pose_vector(batch.positions, batch.gravity)
        return self.drape.networks(batch.modulation, vector, batch.posed_nodes)


def counting_line(doing: str, total: int) -> Callable[[int], None]:
    """A `progress_line` that is told how much more of `total` is done."""
    line, done = progress_line(doing), 0

    def watch(more: int) -> None:
        nonlocal done
        done += more
        line(done / total)

    return watch


def measured_clips(motions: Sequence[Motion]) -> list[Motion]:
    """Clips at the rate of measuring. Raises ValueError when one is too short, stands still or comes twice."""
    if len({motion.name for motion in motions}) < len(motions):
        raise ValueError(f"clips must have different names, got {', '.join(motion.name for motion in motions)}")
    clips = [motion if motion.rate_hz == MOTION_RATE else motion.resampled(MOTION_RATE) for motion in motions]
    for clip in clips:
        if clip.frame_count < 3:
            raise ValueError(f"motion {clip.name!r} is too short: jitter needs 3 frames at {MOTION_RATE:g} Hz")
        if not np.ptp(clip.positions, axis=0).any():
            raise ValueError(f"motion {clip.name!r} stands still: jitter is measured against plain skinning's")
    return clips


def _with_jitter_ratio(rows: dict[str, Figures]) -> dict:
    results: dict = {name: figures.result() for name, figures in rows.items()}
    return results | {"jitter_ratio": results["model"]["jitter_mm"] / results["skinning"]["jitter_mm"]}


def _difference(rig: Rig, other: Rig) -> str:
    if rig.bone_names != other.bone_names:
        return f"{rig.bone_count} bones, expected {other.bone_count}, or other names"
    if rig.dofs != other.dofs:
        return f"{len(rig.dofs)} degrees of freedom, expected {len(other.dofs)}, or other axes or limits"
    return "bones of other parents or in other places"


def evaluate_model(
    model: GarmentModel,
    device: torch.device,
    *,
    bodies: int,
    poses: int,
    seed: int = 0,
    minimum: int = 0,
    motions: Sequence[Motion] = (),
) -> dict:
    """All rows of one model as plain data; on a terminal, progress is shown meanwhile.

    minimum: pairs for the minima, uniform ones and as many of motion, in one size and made to measure, 0 to leave them
    out. motions: clips for the rows on motion. `energy_ratio`: model / full-space minimum. `groups`: the model, made to
    measure, on each of `held_out_groups`; all else is of adults.
    Raises ValueError for another rig than the body model's, impossible counts and clips that cannot be used.
    """
    clips = measured_clips(motions)
    frames = sum(clip.frame_count for clip in clips)
    groups = held_out_groups(load_body_model(), bodies)
    measured = 2 * bodies * (2 * poses + frames)
    measured += sum(min(OF_A_GROUP, len(of) * each) for of in groups.values() for each in (poses, frames, frames))
    minimised = min(minimum, bodies * poses) + 2 * min(minimum, bodies * frames)
    batch = LARGEST_MEASURED if device.type == "cuda" else min(16, bodies * poses)
    watch = counting_line(f"measuring {model.name}", measured + MINIMUM_COST * minimised)
    given = {"bodies": bodies, "poses": poses, "seed": seed, "batch": batch, "watch": watch}
    evaluation = Evaluation(model, device, **given, fit=0.0)
    given["wearing"] = evaluation.wearing
    scores: dict = evaluation.figures(upright=True)
    scores["tilted"] = evaluation.figures(upright=False, only=["model"])["model"]
    scores["counts"] = {"bodies": bodies, "poses": poses, "seed": seed, "pairs": scores["model"]["pairs"]}
    scores["counts"]["influences"] = model.influence_weights.shape[1]
    scores["material"] = asdict(model.material)
    fitted = Evaluation(model, device, **given, fit=1.0)
    made: dict = fitted.figures(upright=True, only=["model", "skinning"])
    made["tilted"] = fitted.figures(upright=False, only=["model"])["model"]
    if clips:
        every_frame = Pairs.joined([fitted.frames(clip) for clip in clips])
        made["motion"] = fitted.motion(clips)
        made["motion"]["model"] |= fitted.skin_seen(every_frame) | fitted.in_itself(every_frame)
    scores["made_to_measure"] = made
    scores["groups"] = {}
    for name, of in groups.items():
        of_group = Evaluation(model, device, **given | {"bodies": len(of)}, of=of, fit=1.0)
        scores["groups"][name] = of_group.of_a_group(clips)
    scores["weight_n"] = float(model.garment.vertex_areas.sum() * model.material.density * STANDARD_GRAVITY)
    if clips:
        scores["motion"] = evaluation.motion(clips)
        scores["motion"]["model"] |= evaluation.skin_seen(every_frame) | evaluation.in_itself(every_frame)
    if minimum:
        given["batch"] = min(batch, LARGEST_MINIMISED)
        evaluation = Evaluation(model, device, **given, fit=0.0)
        scores |= evaluation.minima(evaluation.uniform(upright=True).spread(minimum))
        scores["counts"]["minimum_pairs"] = scores["minimum"]["pairs"]
        scores["energy_ratio"] = scores["model_on_subset"]["energy_j"] / scores["minimum"]["energy_j"]
    if minimum and clips:
        chosen = every_frame.spread(minimum)
        scores["motion"] |= evaluation.minima(chosen)
        made["motion"] |= Evaluation(model, device, **given, fit=1.0).minima(chosen)
    return scores

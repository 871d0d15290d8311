"""Draper: joint positions in, garment out. Chains rig, networks and skinning for one garment on one body.

Dimensions: `d` scalar degrees of freedom, `n` garment vertices, `m` garment nodes. Radians, metres, root frame.
"""

from __future__ import annotations

import logging
import math
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import cached_property, partial
from pathlib import Path
from typing import Literal

import numpy as np

from physkin_core.avatar.avatar import Avatar, AvatarWarning
from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel
from physkin_core.rig.bone_rotations import BoneRotations
from physkin_core.runtime.binding import bind_garment, bind_points
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import make_evaluator
from physkin_core.runtime.rest_look import RestLook, look_at_rest
from physkin_core.runtime.worn_garment import checked_fit
from physkin_core.separation.limb_separator import LimbSeparator
from physkin_core.sway.pace import FrameClock
from physkin_core.sway.sway import Sway

__all__ = [
    *("BACKENDS", "LARGEST_EFFECTIVE_GRAVITY", "STANDARD_GRAVITY", "UPRIGHT_GRAVITY"),
    *("Draper", "in_units_of_gravity"),
]

log = logging.getLogger(__name__)

BACKENDS = ("native", "numpy")
STANDARD_GRAVITY = 9.81
"""[m/s2] what a gravity direction stands for."""
LARGEST_EFFECTIVE_GRAVITY = 3.0
"""In units of gravity; training knows no more."""
UPRIGHT_GRAVITY = np.array([0.0, 0.0, -1.0])
"""Gravity direction in the root frame of an upright body."""
FULL_TURN = 2 * np.pi


class Draper:
    """Drapes one garment on one body, a pose at a time.

    backend: "native" (C++, the one to use) or "numpy" (readable reference, slow); never switched silently.
    precision: of the native backend's network weights, "fp32", "bf16" or "int8" (see `NativeEvaluator`); None for its
        default, int8. The NumPy backend knows fp32 only.
    fit: 1 for a garment made to measure for this body, 0 for the garment's one size, or between; above 0 only for
        models with the body model's rig. None, the default: 1 for those, 0 for others. Above 0 it takes some tenths of
        a second more when the body is bound, nothing a frame.
    normals: "skinned", rest normals carried along with their vertices, or "faces", recomputed from the draped mesh:
        truer where the cloth ripples or slides, for some 5 ns a vertex.
    points, point_normals: optionally another mesh's vertices (n, 3) or a point set of the same garment, in canonical
        space; they have no faces.
    separate_limbs: move arms and legs out of the trunk and of each other before draping, on this body, by joint
        positions changed as little as that takes (`LimbSeparator`). `separated_positions` tells which.
    binding: `bound` of another draper of the same model, avatar and fit, which saves encoding the body again.
    `at_rest` is what binding found of how the garment sits, None with `binding` or `points`. Where it does not sit,
    that joins the `warnings` of `avatar`, and is issued as AvatarWarning.
    A joint more than a full turn beyond its limits is probably in degrees: the first such one is logged as a warning.
    Raises TypeError for anything but a model and an avatar; ValueError for an unknown backend, precision or kind of
    normals, a body of another rig, a fit that the model has not learnt, points that are not this garment's, or normals
    of faces where there are points without any.
    """

    def __init__(
        self,
        model: GarmentModel,
        avatar: Avatar,
        *,
        backend: Literal["native", "numpy"] = "native",
        precision: Literal["fp32", "bf16", "int8"] | None = None,
        fit: float | None = None,
        normals: Literal["skinned", "faces"] = "skinned",
        points: np.ndarray | None = None,
        point_normals: np.ndarray | None = None,
        separate_limbs: bool = False,
        binding: BoundGarment | None = None,
    ) -> None:
        if not isinstance(model, GarmentModel) or not isinstance(avatar, Avatar):
            given = f"{type(model).__name__}, {type(avatar).__name__}"
            raise TypeError(f"Draper takes a garment model, then an avatar: Draper(model, avatar), got Draper({given})")
        if backend not in BACKENDS:
            raise ValueError(f"unknown backend {backend!r}; allowed: {', '.join(BACKENDS)}")
        if backend == "numpy" and precision not in (None, "fp32"):
            raise ValueError(f"the numpy backend computes with the model's own network weights, not in {precision!r}")
        self.fit = checked_fit(model, fit)
        bound = bind_garment(model, avatar, fit=self.fit, backend=backend) if binding is None else binding
        self._rest = rest = bound.vertices
        if points is not None:
            bound = replace(bound, **bind_points(model, points, normals=point_normals, rest=rest))
        self.model = model
        self.avatar = avatar
        self.backend = backend
        self.bound: BoundGarment = bound
        self._sway, self._clock = Sway(backend=backend), FrameClock()
        self._degrees_told = False
        self._bone_rotations: dict[str, BoneRotations] = {}
        self._evaluator = make_evaluator(backend, bound, precision=precision, normals=normals)
        self._limb_separator = self._separate_limbs() if separate_limbs else None
        self._separated = model.rig.rest.astype(np.float32)
        self.at_rest: RestLook | None = None
        if binding is None and points is None:
            self.at_rest = look_at_rest(self.drape(model.rig.rest)[:, :3], model.garment.faces, avatar)
            if not self.at_rest.sits:
                self._warn(f"{model.name} on {avatar.source}: {self.at_rest}")
        log.info("draping %s on %s with the %s backend", model.name, avatar.source, backend)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """(d,) names of the joint positions, in the order `drape` takes them."""
        return self.model.rig.joint_names

    @property
    def instruction_set(self) -> str:
        """What evaluates: the native evaluator's instruction set, or "numpy"."""
        return self._evaluator.instruction_set

    @property
    def precision(self) -> str:
        """Of the network weights it computes with: "fp32", "bf16" or "int8"."""
        return self._evaluator.precision

    @property
    def vertex_count(self) -> int:
        """Number of points n that `drape` writes."""
        return len(self.bound.vertices)

    @cached_property
    def rest_garment(self) -> Garment:
        """The model's mesh in the rest shape worn here, which depends on the fit: what strains are measured against."""
        return self.model.garment.reshaped(self._rest)

    @property
    def faces(self) -> np.ndarray:
        """(f, 3) int32 triangles between the points that `drape` writes; (0, 3) when `points` were given."""
        return self.bound.faces

    @property
    def separated_positions(self) -> np.ndarray:
        """(d,) float32 [rad] the joint positions of the last drape, limbs separated, for whoever draws the body.

        At rest before the first drape. Raises ValueError for a draper without `separate_limbs`.
        """
        if self._limb_separator is None:
            raise ValueError("this draper separates no limbs and drapes positions as given; see separate_limbs")
        return self._separated.copy()

    def drape(
        self,
        joint_positions: np.ndarray | Mapping[str, float],
        gravity: np.ndarray = UPRIGHT_GRAVITY,
        *,
        effective_gravity: np.ndarray | None = None,
        time: float | None = None,
        root: np.ndarray | None = None,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """Deform the garment for one pose.

        joint_positions: (d,) [rad] in the order of `joint_names`, or positions by joint name, the others being at rest.
        gravity: (3,) direction in the root frame, any length but zero, of a root that is not accelerated.
        effective_gravity: (3,) [m/s2] in the root frame, of one that is: gravity less the root's acceleration, zero in
        free fall, at most three times gravity; takes the place of `gravity`. time [s]: when this is; frames are then to
        be given in their order, and cloth that would leap goes over at its pace (`physkin_core.sway.pace`). root (7,),
        with time: where the root is in the world, as of `Sway.felt`, which then tells gravity: cloth lags, swings and
        settles as much as `sway` says. A model with a sway network moves by that instead, without a root by the joints
        alone, and not under effective gravity.
        out: (n, 6) or (n, 3) writable float32 view, any row stride; default a new (n, 6).
        Returns `out`: x, y, z [m], then the unit normal.
        Raises ValueError on wrong lengths, unknown joints or values that are not finite, naming the joint.
        """
        twist, learnt = 0.0, bool(self.bound.sway_layers) and effective_gravity is None
        if root is not None:
            gravity, effective_gravity, twist = self._sway.gravity(
                time, root, effective_gravity, accelerated=True, learnt=learnt
            )
        positions, down = self.checked_pose(joint_positions, gravity, effective_gravity)
        if time is not None:
            told = self._clock.passed(time), self._clock.elapsed
            down = self._sway.moment(*told, twist=twist, learnt=learnt, rooted=root is not None).after(down)
        if out is None:
            out = np.empty((self.vertex_count, 6), dtype=np.float32)
        self._evaluator.evaluate(positions, down, out)
        return out

    @property
    def sway(self) -> float:
        """How much the cloth swings where `drape` is told time and root, 1 (the default) all of it. 0: not at all, and
        every drape is by itself, whatever time it is."""
        return self._sway.amount

    @sway.setter
    def sway(self, amount: float) -> None:
        self._sway.amount = amount

    def reset(self) -> None:
        """Let the cloth hang still, as if the next frame were the first; see `Sway.reset`."""
        self._sway.reset()
        self._clock.reset()

    def checked_pose(
        self,
        joint_positions: np.ndarray | Mapping[str, float],
        gravity: np.ndarray | None = UPRIGHT_GRAVITY,
        effective_gravity: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """A pose given as to `drape`, as evaluators take it: joint positions (d,) [rad] and gravity (3,), float32.

        gravity: may be None where effective_gravity is given.
        Raises ValueError as `drape` does.
        """
        if isinstance(joint_positions, Mapping):
            joint_positions = self.model.rig.joint_positions(joint_positions)
        positions = np.ascontiguousarray(joint_positions, dtype=np.float32)
        if positions.shape != self.bound.dof_bone.shape:
            raise ValueError(f"joint positions have shape {positions.shape}, expected {self.bound.dof_bone.shape}")
        self.check_unusual(positions)
        if self._limb_separator is not None:
            positions, _ = self._limb_separator.separate(positions, out=self._separated)
        down = _direction(gravity) if effective_gravity is None else self._felt(effective_gravity)
        return positions, down.astype(np.float32)

    def drape_rotations(
        self,
        rotations: np.ndarray | Mapping[str, Sequence[float]],
        gravity: np.ndarray = UPRIGHT_GRAVITY,
        *,
        skeleton: Literal["rig", "vrm"] = "rig",
        effective_gravity: np.ndarray | None = None,
        out: np.ndarray | None = None,
    ) -> np.ndarray:
        """As `drape`, of a pose given as rotations of bones: unit quaternions (x, y, z, w) by bone, others at rest.

        rotations, skeleton: see `BoneRotations`. Raises ValueError as `drape` and `BoneRotations.joint_positions` do.
        """
        if skeleton not in self._bone_rotations:
            self._bone_rotations[skeleton] = BoneRotations(self.model.rig, skeleton=skeleton)
        positions = self._bone_rotations[skeleton].joint_positions(rotations)
        return self.drape(positions, gravity, effective_gravity=effective_gravity, out=out)

    def _separate_limbs(self) -> LimbSeparator:
        separator = LimbSeparator(self.model.rig, self.avatar, backend=self.backend)
        for warning in separator.warnings:
            self._warn(f"{self.avatar.source}: {warning}")
        return separator

    def _warn(self, warning: str) -> None:
        """Issue it, and add it to the avatar's."""
        self.avatar = replace(self.avatar, warnings=(*self.avatar.warnings, warning))
        warnings.warn(warning, AvatarWarning, stacklevel=3)

    def bind_step(self, joint_positions: np.ndarray, gravity: np.ndarray, out: np.ndarray) -> Callable[[], None]:
        """A frame bound to its arrays: `step()` drapes what they hold now into `out`, with nothing to convert.

        joint_positions: (d,) [rad] and gravity: (3,) unit direction, or effective gravity `in_units_of_gravity`; or
        with the moment behind, as of `physkin_core.sway.moment`. C-contiguous float32, to be changed in place. out: as
        for `drape`.
        Raises TypeError or ValueError for other arrays; `step()` raises ValueError when a value or what the networks
        make of it is not finite (`out` is then unchanged).
        """
        separator = self._limb_separator
        draped = joint_positions if separator is None else self._separated
        if self.backend == "native":
            from physkin_core.runtime.native_evaluator import _native

            evaluate = self._evaluator.bind_step(draped, gravity, out).step
            ordinary = _native.PoseCheck(joint_positions, FULL_TURN).ordinary
        else:
            evaluate = partial(self._evaluator.evaluate, draped, gravity, out)

            def ordinary() -> bool:
                return joint_positions.dot(joint_positions) <= FULL_TURN**2

        def step() -> None:
            if not ordinary():
                self.check_unusual(joint_positions)
            if separator is not None:
                separator.separate(joint_positions, out=draped)
            evaluate()

        return step

    def _felt(self, effective_gravity: np.ndarray) -> np.ndarray:
        """Effective gravity (3,) [m/s2] in units of gravity, as the networks know it."""
        return in_units_of_gravity(effective_gravity)

    def check_unusual(self, positions: np.ndarray) -> None:
        """Raise ValueError for joint positions (d,) that are not finite; warn, once, of what looks like degrees."""
        if positions.dot(positions) <= FULL_TURN**2:  # the cheapest question that all usual poses pass, and no NaN
            return
        if not np.isfinite(positions).all():
            joint = int(np.flatnonzero(~np.isfinite(positions))[0])
            raise ValueError(f"joint {self.joint_names[joint]!r} is {positions[joint]}; positions must be finite [rad]")
        rig = self.model.rig
        beyond = np.maximum(rig.lower - positions, positions - rig.upper)
        if not self._degrees_told and beyond.max() > FULL_TURN:
            self._degrees_told = True
            joint = int(beyond.argmax())
            log.warning(
                "joint %r is %g, a full turn beyond its limits of %.2f to %.2f rad: degrees? Positions are in radians",
                *(self.joint_names[joint], positions[joint], rig.lower[joint], rig.upper[joint]),
            )

    def save_bound(self, path: str | Path) -> None:
        """Write what is bound here for hosts without Python: see native/include/physkin.h."""
        from physkin_core.runtime.bound_file import save_bound_garment

        model = self.model
        save_bound_garment(self.bound, path, name=model.name, joint_names=self.joint_names, accelerated=True)

    def node_transforms(self) -> np.ndarray:
        """Garment node transforms chi (m, 3, 4) of the last `drape`, canonical garment node frame to root frame."""
        return self._evaluator.node_transforms()

    def bone_transforms(self, joint_positions: np.ndarray) -> np.ndarray:
        """(b, 3, 4) canonical-to-posed transforms of this body's bones, for posing the body beside the garment.

        joint_positions: (d,) [rad], as `drape` takes them: limbs are separated here, too, where they are there.
        """
        if self._limb_separator is not None:
            joint_positions, _ = self._limb_separator.separate(joint_positions)
        return self.model.rig.bone_transforms(joint_positions, heads=self.avatar.bone_heads)


def in_units_of_gravity(effective_gravity: np.ndarray) -> np.ndarray:
    """Effective gravity (3,) [m/s2] as (3,) float64, 1 long for a root at rest.

    Raises ValueError unless it is finite and at most three times gravity.
    """
    felt = np.asarray(effective_gravity, dtype=np.float64) / STANDARD_GRAVITY
    if felt.shape != (3,) or not math.hypot(*felt) <= LARGEST_EFFECTIVE_GRAVITY:
        allowed = f"(3,), finite, up to {LARGEST_EFFECTIVE_GRAVITY * STANDARD_GRAVITY:.1f} m/s2 long"
        raise ValueError(f"effective_gravity must be {allowed}, got {np.asarray(effective_gravity).tolist()}")
    return felt


def _direction(gravity: np.ndarray) -> np.ndarray:
    down = np.asarray(gravity, dtype=np.float64)
    length = math.hypot(*down.tolist()) if down.shape == (3,) else math.nan
    if not 1e-9 <= length < math.inf:
        raise ValueError(f"gravity must be a finite, non-zero direction (3,), got {down.tolist()}")
    return down / length

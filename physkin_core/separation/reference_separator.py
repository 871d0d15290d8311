"""Readable reference of `native/src/separation/limb_separator.cpp`, which does the same in single precision.

A few damped Gauss-Newton steps lessen, over the joint positions q of each limb,
    sum over contacts of soft(depth + onset - allowed)^2 / 2  +  pull |q - q_given|^2 / 2,
every limb by itself: where two limbs give way to each other, each counts the contact twice in its curvature, so that
both together do not go too far. The number of steps is fixed and everything in a step is continuous: what comes out is
a continuous function of the pose. Dimensions: as in `collision_shape`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.rig.rig import forward_kinematics
from physkin_core.separation.collision_shape import TRUNK, CollisionShape, capsule_depth

__all__ = ["ReferenceLimbSeparator", "SeparationSettings"]


@dataclass(frozen=True)
class SeparationSettings:
    """How gently limbs are separated.

    onset: [m] outside the skin where a contact begins to count. softness: [m] over which it comes to count in full.
    pull: [m2/rad2] of a joint towards where it was given. damping: [m2/rad2] towards where the last step left it.
    blend: [m] of height over which a trunk bone takes over from the one below. steps: how many.
    """

    onset: float = 0.01
    softness: float = 0.03
    pull: float = 0.01
    damping: float = 0.01
    blend: float = 0.06
    steps: int = 3


class ReferenceLimbSeparator:
    """Separates the limbs of one body, slowly."""

    def __init__(self, shape: CollisionShape, settings: SeparationSettings) -> None:
        self._shape, self._settings = shape, settings
        self._limbs = range(len(shape.limb_start) - 1)

    def separate(self, positions: np.ndarray, out: np.ndarray) -> float:
        """As `LimbSeparator.separate`. positions, out: (d,); raises ValueError where one is not finite."""
        if not np.isfinite(positions).all():
            joint = int(np.flatnonzero(~np.isfinite(positions))[0])
            raise ValueError(f"joint_positions[{joint}] is {positions[joint]}; every value must be finite")
        shape, settings = self._shape, self._settings
        given = np.asarray(positions, dtype=np.float64)
        lowest, highest = np.minimum(shape.dof_lower, given), np.maximum(shape.dof_upper, given)
        q = given.copy()
        for _ in range(settings.steps):
            curvature, slope, met = self._gather(q)
            for limb in self._limbs:
                dofs = shape.limb_dofs[shape.limb_start[limb] : shape.limb_start[limb + 1]]
                if not met[limb] and np.array_equal(q[dofs], given[dofs]):
                    continue
                normal = curvature[limb] + (settings.pull + settings.damping) * np.eye(len(dofs))
                step = np.linalg.solve(normal, -slope[limb] - settings.pull * (q[dofs] - given[dofs]))
                q[dofs] = np.clip(q[dofs] + step, lowest[dofs], highest[dofs])
        out[:] = q
        return float(np.abs(q - given).max(initial=0.0))

    def _gather(self, q: np.ndarray) -> tuple[list[np.ndarray], list[np.ndarray], list[bool]]:
        """By limb: curvature (D, D) and slope (D,) of the contacts' sum, and whether there are any."""
        shape = self._shape
        transforms, axes, pivots = self._pose(q)
        sphere = transforms[shape.sphere_bone]
        centres = np.einsum("sij,sj->si", sphere[:, :, :3], shape.sphere_centre) + sphere[:, :, 3]
        counts = np.diff(shape.limb_start)
        curvature = [np.zeros((count, count)) for count in counts]
        slope = [np.zeros(count) for count in counts]
        met = [False] * len(counts)
        for group, target, contact in shape.pairs:
            members = np.arange(*shape.groups[group])
            limb = shape.sphere_limb[members[0]]
            if target == TRUNK:
                depth, normal = self._trunk_depth(centres[members], transforms)
                other = -1
            else:
                first, last = shape.capsules[target]
                ends, radii = shape.capsule(target, centres)
                depth, normal, along = capsule_depth(centres[members], ends, radii)
                other = shape.sphere_limb[first]
                if other >= 0 and shape.limb_kind[limb] != shape.limb_kind[other]:
                    other = -1  # legs do not give way to arms
            allowed = shape.allowed[contact : contact + len(members)]
            excess = depth + shape.sphere_radius[members] + self._settings.onset - allowed
            value, weight = soft(excess, self._settings.softness)
            for k in np.flatnonzero(value > 0):
                counted = 2.0 if other >= 0 else 1.0
                way = self._moves(members[k], limb, centres[members[k]], normal[k], axes, pivots)
                curvature[limb] += counted * weight[k] ** 2 * np.outer(way, way)
                slope[limb] -= value[k] * weight[k] * way
                met[limb] = True
                if other >= 0:
                    point = ends[0] + along[k] * (ends[1] - ends[0])
                    way = (1 - along[k]) * self._moves(first, other, point, normal[k], axes, pivots)
                    way = way + along[k] * self._moves(last, other, point, normal[k], axes, pivots)
                    curvature[other] += counted * weight[k] ** 2 * np.outer(way, way)
                    slope[other] += value[k] * weight[k] * way
                    met[other] = True
        return curvature, slope, met

    def _pose(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bone transforms (b, 3, 4); posed axes (d, 3) and pivots (d, 3) of the joints."""
        shape = self._shape
        heads = shape.heads.astype(np.float64)
        turned = q - shape.dof_rest
        transforms = forward_kinematics(shape.parents, heads, shape.dof_bone, shape.dof_axis.astype(float), turned)
        axes = np.empty((len(q), 3))
        for k, bone in enumerate(shape.dof_bone):
            later = (shape.dof_bone == bone) & (np.arange(len(q)) >= k)  # these do not turn the axis
            before = forward_kinematics(
                shape.parents, heads, shape.dof_bone, shape.dof_axis.astype(float), np.where(later, 0.0, turned)
            )
            axes[k] = before[bone, :, :3] @ shape.dof_axis[k]
        posed = np.einsum("bij,bj->bi", transforms[:, :, :3], heads) + transforms[:, :, 3]
        return transforms, axes, posed[shape.dof_bone]

    def _moves(self, sphere, limb, point, normal, axes, pivots) -> np.ndarray:
        """(D,) how far a point that a sphere's bone carries goes along a normal by each joint of the limb [m/rad]."""
        shape = self._shape
        dofs = shape.limb_dofs[shape.limb_start[limb] : shape.limb_start[limb + 1]]
        way = np.cross(axes[dofs], point - pivots[dofs]) @ normal
        return np.where(np.arange(len(dofs)) < shape.sphere_joints[sphere], way, 0.0)

    def _trunk_depth(self, points: np.ndarray, transforms: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depth (V,) of points (V, 3) in the posed trunk, and unit normals (V, 3)."""
        shape = self._shape
        canonical, turn = None, None
        for bone, height in zip(shape.trunk_bones, shape.trunk_heights):
            back = transforms[bone, :, :3].T
            seen = (points - transforms[bone, :, 3]) @ back.T
            if canonical is None:
                canonical, turn = seen, np.broadcast_to(back, (len(points), 3, 3))
                continue
            share = np.clip(0.5 + (0.5 * (canonical + seen)[:, 2] - height) / self._settings.blend, 0.0, 1.0)
            share = share**2 * (3 - 2 * share)
            canonical = canonical + share[:, None] * (seen - canonical)
            turn = turn + share[:, None, None] * (back - turn)
        depth, normal = shape.trunk.depth(canonical)
        return depth, np.einsum("vij,vi->vj", turn, normal)


def soft(excess: np.ndarray, softness: float) -> tuple[np.ndarray, np.ndarray]:
    """Nothing below zero, then a parabola, then a straight line of slope 1; and its slope."""
    bent = np.clip(excess, 0.0, softness)
    return bent**2 / (2 * softness) + np.maximum(excess - softness, 0.0), bent / softness

"""Limbs moved out of a body: a few damped Gauss-Newton steps lessen, over the joint positions q of each limb,

    sum over contacts of soft(depth + onset - allowed)^2 / 2  +  pull |q - q_given|^2 / 2,

every limb by itself: where two limbs give way to each other, each counts the contact twice in its curvature, so that
both together do not go too far. The number of steps is fixed and everything in a step is continuous.

Dimensions: as in `physkin_core.separation.collision_shape`, whose shape this reads, and measures depths by.
"""

import numpy as np

from physkin_core.separation.collision_shape import TRUNK, capsule_depth
from reference.skeleton import bone_transforms, rotation_about


class ReferenceLimbSeparator:
    """Separates the limbs of one body. shape: its `CollisionShape`; settings: `SeparationSettings`."""

    def __init__(self, shape, settings):
        self._shape, self._settings = shape, settings
        self._dofs = np.split(shape.limb_dofs, shape.limb_start[1:-1])

    def separate(self, positions):
        """Joint positions (d,) moved as little as needed, and the largest change."""
        shape, settings, given = self._shape, self._settings, np.asarray(positions, dtype=np.float64)
        lowest, highest = np.minimum(shape.dof_lower, given), np.maximum(shape.dof_upper, given)
        q = given.copy()
        for _ in range(settings.steps):
            for dofs, ways in zip(self._dofs, self._contacts(q)):
                if not ways and np.array_equal(q[dofs], given[dofs]):
                    continue
                normal = (settings.pull + settings.damping) * np.eye(len(dofs))
                slope = settings.pull * (q[dofs] - given[dofs])
                for way, value, weight, counted in ways:
                    normal += counted * weight**2 * np.outer(way, way)
                    slope += value * weight * way
                q[dofs] = np.clip(q[dofs] - np.linalg.solve(normal, slope), lowest[dofs], highest[dofs])
        return q, np.abs(q - given).max(initial=0.0)

    def _contacts(self, q):
        """Of each limb its contacts: how much deeper they get by each of its joints (D,) [m/rad], the value and the
        slope of `soft`, and how often they are counted."""
        shape, found = self._shape, [[] for _ in self._dofs]
        skeleton = shape.parents, shape.heads, shape.dof_bone, shape.dof_axis
        bones = bone_transforms(*skeleton, q - shape.dof_rest)
        sphere = bones[shape.sphere_bone]
        centres = (sphere[:, :, :3] @ shape.sphere_centre[..., None])[..., 0] + sphere[:, :, 3]
        for group, target, contact in shape.pairs:
            members = np.arange(*shape.groups[group])
            limb, other = shape.sphere_limb[members[0]], -1
            if target == TRUNK:
                depth, normal = self._trunk_depth(centres[members], bones)
            else:
                first, last = shape.capsules[target]
                ends, radii = shape.capsule(target, centres)
                depth, normal, along = capsule_depth(centres[members], ends, radii)
                if shape.sphere_limb[first] >= 0 and shape.limb_kind[limb] == shape.limb_kind[shape.sphere_limb[first]]:
                    other = shape.sphere_limb[first]  # legs do not give way to arms
            allowed = shape.allowed[contact : contact + len(members)]
            excess = depth + shape.sphere_radius[members] + self._settings.onset - allowed
            value, weight = soft(excess, self._settings.softness)
            for k in np.flatnonzero(value > 0):
                told = value[k], weight[k], 2 if other >= 0 else 1
                found[limb].append((-self._way(q, bones, members[k], limb, centres[members[k]], normal[k]), *told))
                if other >= 0:
                    point = ends[0] + along[k] * (ends[1] - ends[0])
                    way = (1 - along[k]) * self._way(q, bones, first, other, point, normal[k])
                    found[other].append((way + along[k] * self._way(q, bones, last, other, point, normal[k]), *told))
        return found

    def _way(self, q, bones, sphere, limb, point, normal):
        """(D,) how far a point that a sphere's bone carries goes along a normal by each joint of the limb [m/rad]."""
        shape, dofs = self._shape, self._dofs[limb]
        way = np.zeros(len(dofs))
        for k, dof in enumerate(dofs[: shape.sphere_joints[sphere]]):
            bone = shape.dof_bone[dof]
            turn, head = bones[bone, :, :3], shape.heads[bone]
            for later in np.flatnonzero((shape.dof_bone == bone) & (np.arange(len(q)) >= dof))[::-1]:
                # joints of a bone turn it one after the other: those from here on do not turn the axis
                turn = turn @ rotation_about(shape.dof_axis[later].astype(float), q[later] - shape.dof_rest[later]).T
            pivot = bones[bone, :, :3] @ head + bones[bone, :, 3]
            way[k] = np.cross(turn @ shape.dof_axis[dof], point - pivot) @ normal
        return way

    def _trunk_depth(self, points, bones):
        """Depth (V,) of points (V, 3) in the posed trunk, and unit normals (V, 3)."""
        shape, canonical = self._shape, None
        for bone, height in zip(shape.trunk_bones, shape.trunk_heights):
            back = bones[bone, :, :3].T
            seen = (points - bones[bone, :, 3]) @ back.T
            if canonical is None:
                canonical, turn = seen, np.broadcast_to(back, (len(points), 3, 3))
                continue
            share = np.clip(0.5 + (0.5 * (canonical + seen)[:, 2] - height) / self._settings.blend, 0.0, 1.0)
            share = (share**2 * (3 - 2 * share))[:, None]
            canonical, turn = canonical + share * (seen - canonical), turn + share[..., None] * (back - turn)
        depth, normal = shape.trunk.depth(canonical)
        return depth, np.einsum("vij,vi->vj", turn, normal)


def soft(excess, softness):
    """Nothing below zero, then a parabola, then a straight line of slope 1; and its slope."""
    bent = np.clip(excess, 0.0, softness)
    return bent**2 / (2 * softness) + np.maximum(excess - softness, 0.0), bent / softness

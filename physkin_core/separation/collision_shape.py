"""The compact collision shape of a body: limbs of spheres and capsules, a smooth trunk, a head, and what may touch.

Dimensions: `b` bones, `S` spheres, `C` capsules, `G` groups of spheres, `P` pairs of a group and what it is kept out
of, `A` contacts (a sphere of a pair's group), `L` limbs, `K` trunk bones, `D` joints that may move. Metres, canonical
pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.body_shape.limb_chains import Limb, find_limbs
from physkin_core.body_shape.radial_shape import RadialShape
from physkin_core.body_shape.skin_by_part import SkinByPart, SkinPoints, trunk_of
from physkin_core.native_module import as_float32, native
from physkin_core.rig.rig import Rig
from physkin_core.separation.limb_shape import CAPSULES, END, LOWER, SPHERES, UPPER, fit_limb

__all__ = ["CollisionShape", "fit_collision_shape"]

TRUNK = -1
"""Stands for the trunk in place of a capsule's index."""
CAPSULE_BLUR: float = native.constants["capsule_blur"]
"""[m] This near to a capsule's axis all directions out of it are alike: arms may pass through each other."""
SLACK = 0.02
"""[m] By which twist joints within a group may change how far its spheres are from its middle one."""


@dataclass(frozen=True)
class CollisionShape:
    """What a limb separator needs of rig and body; arrays of indices int32, others float32.

    parents (b,), heads (b, 3) of the body, dof_bone, dof_axis, dof_rest, dof_lower, dof_upper: as of `BoundGarment`.
    trunk_bones: (K,) from the pelvis up. trunk_heights: (K,) [m] above which each of them takes over from the last.
    trunk_frame: (4,) X and Y of the axis, heights between which the surface was fitted.
    trunk_coefficients: (J, 2 H + 1), see `RadialShape`.
    sphere_bone (S,), sphere_centre (S, 3), sphere_radius (S,).
    sphere_limb: (S,) whose joints move it, -1 for none; sphere_joints: (S,) how many of these, from the trunk outwards.
    capsules: (C, 2) spheres that span them. groups: (G, 2) first sphere, and one after the last. group_reach: (G,) [m]
    of its spheres' surfaces from the middle one's centre. pairs: (P, 3) group, capsule or -1 for the
    trunk, first contact.
    allowed: (A,) [m] how deep a contact is in the canonical pose, at least 0: so deep it may be.
    limb_start: (L + 1,) into limb_dofs (D,). limb_kind: (L,) 0 for arms, 1 for legs,
    which give way to legs only.
    """

    parents: np.ndarray
    heads: np.ndarray
    dof_bone: np.ndarray
    dof_axis: np.ndarray
    dof_rest: np.ndarray
    dof_lower: np.ndarray
    dof_upper: np.ndarray
    trunk_bones: np.ndarray
    trunk_heights: np.ndarray
    trunk_frame: np.ndarray
    trunk_coefficients: np.ndarray
    sphere_bone: np.ndarray
    sphere_centre: np.ndarray
    sphere_radius: np.ndarray
    sphere_limb: np.ndarray
    sphere_joints: np.ndarray
    capsules: np.ndarray
    groups: np.ndarray
    group_reach: np.ndarray
    pairs: np.ndarray
    allowed: np.ndarray
    limb_start: np.ndarray
    limb_dofs: np.ndarray
    limb_kind: np.ndarray

    @property
    def trunk(self) -> RadialShape:
        """The smooth surface of the trunk, in single precision as it is used."""
        x, y, low, high = self.trunk_frame.astype(np.float64)
        return RadialShape(np.array([x, y]), low, high, self.trunk_coefficients.astype(np.float64))

    def depths(self, centres: np.ndarray, trunk_points: np.ndarray) -> np.ndarray:
        """How deep each contact is, (A,) [m], negative outside. centres: (S, 3) of the spheres in a pose; trunk_points:
        (S, 3) the same as the canonical trunk sees them."""
        found = []
        for group, target, _ in self.pairs:
            members = np.arange(*self.groups[group])
            if target == TRUNK:
                depth = self.trunk.depth(trunk_points[members])[0]
            else:
                depth = capsule_depth(centres[members], *self.capsule(target, centres))[0]
            found.append(depth + self.sphere_radius[members])
        return np.concatenate(found)

    def capsule(self, index: int, centres: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Ends (2, 3) and radii (2,) of a capsule, of centres (S, 3)."""
        ends = self.capsules[index]
        return centres[ends], self.sphere_radius[ends].astype(np.float64)


def capsule_depth(points: np.ndarray, ends: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """How deep points (V, 3) are in a capsule, (V,); normals (V, 3), of unit length except near the axis; and where
    along the axis the nearest place is, (V,) 0 to 1. The radius changes smoothly from one end to the other.
    """
    axis = ends[1] - ends[0]
    along = np.clip((points - ends[0]) @ axis / max(axis @ axis, 1e-9), 0.0, 1.0)
    offset = points - ends[0] - along[:, None] * axis
    distance = np.sqrt((offset**2).sum(axis=1) + CAPSULE_BLUR**2)
    smooth = along**2 * (3 - 2 * along)
    return radii[0] + smooth * (radii[1] - radii[0]) - distance, offset / distance[:, None], along


def fit_collision_shape(avatar: Avatar, rig: Rig, *, onset: float) -> tuple[CollisionShape, tuple[str, ...]]:
    """The shape of this body, and warnings: limbs that are left out, and why.

    onset: [m] distance at which a contact begins to count. Raises ValueError where no limb was found, or none has skin.
    """
    found = find_limbs(rig)
    heads = avatar.bone_heads.astype(np.float64)
    warnings = [f"{name} is not separated: the rig has no bones for it, or no joints" for name in found.missing]
    skin = SkinByPart(avatar, rig, found)
    spheres, limbs = _Spheres(rig, heads), []
    for index, limb in enumerate(found.limbs):
        try:
            fitted = fit_limb(heads[list(limb.ends)], skin.of(3 * index, 3 * index + 1), skin.of(3 * index + 2))
        except ValueError as error:
            warnings.append(f"{limb.name} is not separated: {error}")
            continue
        spheres.add_limb(limb, *fitted)
        limbs.append(limb)
    if not limbs:
        raise ValueError(f"limbs of {avatar.source} cannot be separated: {'; '.join(warnings)}")
    head = skin.head()
    if len(head.points):
        spheres.add_head(found.head, head)
    groups, pairs = _pairs(limbs, with_head=bool(len(head.points)))
    trunk = trunk_of(skin, found, heads)
    arrays = spheres.arrays() | {"groups": groups, "pairs": pairs}
    centre, radius = arrays["sphere_centre"], arrays["sphere_radius"]
    reach = []
    for first, last in groups:
        middle = centre[(first + last) // 2]
        reach.append((np.linalg.norm(centre[first:last] - middle, axis=1) + radius[first:last]).max() + SLACK)
    bones = np.array(found.trunk)
    shape = CollisionShape(
        parents=np.asarray(rig.parents, dtype=np.int32),
        heads=as_float32(heads),
        dof_bone=rig.dof_bones,
        dof_axis=as_float32(rig.dof_axes),
        dof_rest=as_float32(rig.rest),
        dof_lower=as_float32(rig.lower),
        dof_upper=as_float32(rig.upper),
        trunk_bones=bones.astype(np.int32),
        trunk_heights=as_float32(heads[bones, 2]),
        trunk_frame=as_float32([*trunk.centre, trunk.low, trunk.high]),
        trunk_coefficients=as_float32(trunk.coefficients),
        group_reach=as_float32(reach),
        allowed=np.zeros(int(sum(groups[group, 1] - groups[group, 0] for group in pairs[:, 0])), dtype=np.float32),
        limb_start=np.cumsum([0, *(len(limb.dofs) for limb in limbs)]).astype(np.int32),
        limb_dofs=np.array([k for limb in limbs for k in limb.dofs], dtype=np.int32),
        limb_kind=np.array([0 if limb.is_arm else 1 for limb in limbs], dtype=np.int32),
        **arrays,
    )
    at_rest = shape.depths(centre.astype(np.float64), centre.astype(np.float64))
    return replace(shape, allowed=as_float32(np.maximum(at_rest + onset, 0.0))), tuple(warnings)


class _Spheres:
    """Spheres and capsules, gathered limb by limb."""

    def __init__(self, rig: Rig, heads: np.ndarray) -> None:
        self._rig, self._heads = rig, heads
        self._rows: list[tuple] = []  # bone, centre, radius, limb, joints
        self._capsules: list[tuple[int, int]] = []
        self._limbs = 0

    def add_limb(self, limb: Limb, centres: np.ndarray, radii: np.ndarray) -> None:
        first = len(self._rows)
        self._capsules += [(first + start, first + end) for start, end in CAPSULES]
        for k, (centre, radius) in enumerate(zip(centres, radii)):
            bone = limb.ends[2] if k >= END.start else self._bone_at(limb, centre, int(k >= LOWER.start))
            above = self._rig.ancestors(bone)
            joints = sum(int(self._rig.dof_bones[dof]) in above for dof in limb.dofs)
            self._rows.append((bone, centre, radius, self._limbs, joints))
        self._limbs += 1

    def _bone_at(self, limb: Limb, centre: np.ndarray, segment: int) -> int:
        """The last bone of a segment whose head lies before a centre."""
        start, stop = limb.ends[segment], limb.ends[segment + 1]
        above = self._rig.ancestors(stop)
        direction = self._heads[stop] - self._heads[start]
        passed = [bone for bone in above[1 : above.index(start)] if (centre - self._heads[bone]) @ direction >= 0]
        return passed[0] if passed else start

    def add_head(self, bone: int, skin: SkinPoints) -> None:
        low, high = np.quantile(skin.points[:, 2], [0.02, 0.98])
        middle = np.average(skin.points, axis=0, weights=skin.areas)
        radius = float(np.average(np.linalg.norm((skin.points - middle)[:, :2], axis=1), weights=skin.areas))
        first = len(self._rows)
        self._capsules.append((first, first + 1))
        half = max(0.5 * (high - low) - radius, 0.0)
        for side in (-1, 1):
            centre = np.array([middle[0], middle[1], 0.5 * (low + high) + side * half])
            self._rows.append((bone, centre, radius, -1, 0))

    def arrays(self) -> dict[str, np.ndarray]:
        bone, centre, radius, limb, joints = zip(*self._rows)
        return {
            "sphere_bone": np.array(bone, dtype=np.int32),
            "sphere_centre": as_float32(centre),
            "sphere_radius": as_float32(radius),
            "sphere_limb": np.array(limb, dtype=np.int32),
            "sphere_joints": np.array(joints, dtype=np.int32),
            "capsules": np.array(self._capsules, dtype=np.int32),
        }


def _pairs(limbs: list[Limb], *, with_head: bool) -> tuple[np.ndarray, np.ndarray]:
    """Groups (G, 2) and pairs (P, 3). Arms keep out of the trunk, the head, legs and each other, legs out of the trunk
    and each other. Spheres by which a limb is joined to the trunk are exempt."""
    groups, pairs = [], []
    head = len(CAPSULES) * len(limbs)
    for own, limb in enumerate(limbs):
        first = len(groups)
        groups += [(SPHERES * own + part.start, SPHERES * own + part.stop) for part in (UPPER, LOWER, END)]
        if not limb.is_arm:  # near the knee the thigh meets the belly; halfway up it is joined to it
            groups[first] = (groups[first][0] + 1, groups[first][1] + 1)
            groups[first + 1] = (groups[first + 1][0] + 1, groups[first + 1][1])
        pairs += [(first + part, TRUNK) for part in ((0, 1, 2) if limb.is_arm else (0,))]
        for other, another in enumerate(limbs):
            if other == own or another.is_arm and not limb.is_arm:
                continue
            parts = (1, 2) if limb.is_arm else (0, 1, 2)
            targets = (0, 1) if limb.is_arm and not another.is_arm else (0, 1, 2)
            pairs += [(first + part, len(CAPSULES) * other + target) for part in parts for target in targets]
        if limb.is_arm and with_head:
            pairs += [(first + part, head) for part in (1, 2)]
    sizes = [groups[group][1] - groups[group][0] for group, _ in pairs]
    starts = np.cumsum([0, *sizes[:-1]])
    rows = [(*pair, start) for pair, start in zip(pairs, starts)]
    return np.array(groups, dtype=np.int32), np.array(rows, dtype=np.int32).reshape(-1, 3)

"""How a garment is worn: which body parts each vertex lies on, where it may touch itself, and the band along a rim that
holds it up.

All are read off a body at the canonical pose, the garment maker's as a rule; other bodies share its mesh.
Dimensions: `n` garment vertices, `b` bones, `f` contact faces, `k` band vertices. Metres.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from physkin_core.avatar.avatar import Avatar, avatar_from_body
from physkin_core.avatar.body_model import ADULT_STATURE, BodyModel
from physkin_core.body_shape.limb_chains import find_limbs
from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.model.surface_paths import openings
from physkin_core.rig.rig import Rig
from physkin_core.runtime.turned_cloth import turned_cloth
from physkin_training.contact.surface_queries import FARTHEST, BodySurface, covering_faces
from physkin_training.contact.touching_places import TouchingPlaces, moved_with_skin
from physkin_training.sampling.chosen_bodies import bodies_by_girth

__all__ = ["TO_THE_HEM", "Wearing", "holding_rim"]

WORN_WITHIN = 0.15
"""A vertex is worn on body parts that come this close [m] at the canonical pose."""
WORN_BESIDE = 0.02
"""It is worn on the closest part, on those at most this much [m] farther away, and on the parts joined to these: cloth
slides along a limb, but the side of a shirt is not worn on the arm that hangs beside it."""
HUNG_BESIDE = 4 / 3
"""Cloth that is farther from all of the body hangs around it. It is worn on the closest part of each limb, and on those
at most this many times as far away: a heel comes up behind a cape."""
BEHIND = -0.35
"""Cosine between the direction to a part and the cloth's normal. Below this the part is behind the cloth, as all parts
are that a skirt hangs around; otherwise it is beside the cloth or in front of it."""
RIM_WITHIN = 0.02
"""Cloth is worn on a bare limb where all other parts are farther away, by at least this [m]: the rim on a shoulder."""
GOES_AROUND = 0.3
"""An opening goes around the bone that is closest to its centre if that is at most this share of its radius away."""
FACES_ACROSS = 0.03
"""A limb has a far side where a face of the same part is this close [m] to the near one reflected in the bone."""
POSED_BODIES = 32
"""Training bodies of which the leanest and the stoutest adults show where a garment may touch itself."""
BAND_WIDTH = 0.03
"""Vertices this close [m] to the rim that holds the garment make up the band."""
TO_THE_HEM, COLLAR = 0.4, 0.1
"""A rim that is higher [m] than this is neckline, front edges and hem in one, as that of a cape or a cardigan is: only
this much of it [m], from its highest point down, holds the garment. Where arms leave such a garment through openings of
their own, cloth on the shoulders holds it instead."""
BESIDE_NECK, BEFORE, ABOVE = 0.75, 0.2, (0.2, 0.65)
"""Cloth on the shoulders: how far aside it is from the middle of the shoulder joints and before it at most, and how far
above, in halves of their distance."""
ON_SKIN = 0.03
"""[m] It is no farther from the body."""


@dataclass(frozen=True)
class Wearing:
    """A garment on a body.

    faces: (f, 3) int32, faces of the body that cloth may be in contact with; face_bone: (f,) int32, the bone that moves
    each most. worn: (n, b) bool, the vertex lies on that bone's part, or hangs around it, far from all. other_limb:
    (n, b) bool, it lies on no part of that bone's limb, which is beside the cloth or in front of it, as an arm is to
    the side of a shirt, and presses it towards its own place on the body alone. bare: (b,) bool, the bone of an arm
    that leaves through an armhole, an opening on the trunk without a sleeve: only cloth from which all other parts are
    farther is worn on it. own_face: (n,) int32, of the `faces` of worn parts the one whose centre is closest. far_face:
    (n,) int32, of cloth in a sleeve or a trouser leg the face across the limb from that, elsewhere -1. band: (k,) int32
    vertices of the neckband or waistband, or on the shoulders; band_place: (k,) int32 the body vertex closest to each,
    band_distance: (k,) float32 [m] away. inside_out: (n,) bool, the outside of this cloth faces the body. touching:
    where cloth may touch itself; None: it passes through itself.
    """

    faces: np.ndarray
    face_bone: np.ndarray
    worn: np.ndarray
    other_limb: np.ndarray
    bare: np.ndarray
    own_face: np.ndarray
    far_face: np.ndarray
    band: np.ndarray
    band_place: np.ndarray
    band_distance: np.ndarray
    inside_out: np.ndarray
    touching: TouchingPlaces | None = None

    @classmethod
    def of(cls, garment: Garment, body_model: BodyModel) -> Wearing:
        """Read off the garment maker's body. Raises ValueError for a garment without an opening."""
        some = body_model.train_bodies[:POSED_BODIES]
        some = some[body_model.statures(some) > ADULT_STATURE]
        chosen = some[bodies_by_girth(body_model, min(2, len(some)), of=some)] if len(some) else some
        made_on, *bodies = (avatar_from_body(body_model, body) for body in (body_model.garment_body, *chosen))
        return cls.on(garment, made_on, body_model.rig, bodies=bodies)

    @classmethod
    def on(cls, garment: Garment, avatar: Avatar, rig: Rig, *, bodies: Sequence[Avatar] = ()) -> Wearing:
        """Read off a body in the canonical pose of `rig`. bodies: others of its mesh that show where the garment may
        touch itself; by default it does. Raises ValueError for a garment without an opening."""
        body, faces = avatar.vertices, avatar.faces
        vertex_bone = avatar.influence_bones[np.arange(len(body)), avatar.influence_weights.argmax(axis=1)]
        corner_bones = vertex_bone[faces]
        face_bone = np.where(corner_bones[:, 1] == corner_bones[:, 2], corner_bones[:, 1], corner_bones[:, 0])
        distance = np.full((len(garment.vertices), rig.bone_count), np.inf)
        outwards = np.full(distance.shape, -np.inf)
        outside = vertex_normals(garment.vertices, garment.faces)
        inside_out = turned_cloth(np.hstack([garment.vertices, outside]), garment.faces, avatar)
        normals = outside * np.where(inside_out, -1, 1)[:, None]
        for bone in np.unique(vertex_bone):
            part = body[vertex_bone == bone]
            distance[:, bone], closest = cKDTree(part).query(garment.vertices)
            outwards[:, bone] = np.einsum("vi,vi->v", part[closest] - garment.vertices, normals)
        limbs = _limbs(rig.parents)
        left_by = _left_by(garment, avatar)
        bare = _bare(left_by, avatar, vertex_bone, limbs, rig.parents)
        dressed = distance[:, ~bare].min(axis=1, keepdims=True)
        distance_worn = np.where(bare & (distance + RIM_WITHIN > dressed), np.inf, distance)
        beside = distance_worn <= distance_worn.min(axis=1, keepdims=True) + WORN_BESIDE
        worn = (beside | _joined(beside, rig.parents)) & (distance_worn <= WORN_WITHIN)
        limb = np.eye(rig.bone_count, dtype=int)[np.where(bare, np.arange(rig.bone_count), limbs)]
        on_limb = (worn @ limb) @ limb.T > 0
        other_limb = ~on_limb & worn.any(axis=1, keepdims=True) & (outwards > BEHIND * distance)
        free = np.flatnonzero(~worn.any(axis=1))
        worn[free] = _hung_around(garment, free, distance_worn[free], avatar, vertex_bone, limbs)
        near = np.flatnonzero(worn.any(axis=0)[face_bone])
        band = _band(garment, avatar, rig)
        gap, place = cKDTree(body).query(garment.vertices[band])
        own = near[cKDTree(body[faces[near]].mean(axis=1)).query(garment.vertices)[1]]
        sleeved = (np.isin(limbs, [limbs[bone] for bone, _ in left_by]) & ~bare)[face_bone[own]]
        sleeved[free] = False
        shapes = moved_with_skin(garment, faces[own, 0], avatar, bodies or [avatar], rig)
        return cls(
            faces=faces,
            face_bone=face_bone.astype(np.int32),
            worn=worn,
            other_limb=other_limb,
            bare=bare,
            own_face=own.astype(np.int32),
            far_face=np.where(sleeved, _across(own, avatar, face_bone), -1).astype(np.int32),
            band=band.astype(np.int32),
            band_place=place.astype(np.int32),
            band_distance=gap.astype(np.float32),
            inside_out=inside_out,
            touching=TouchingPlaces.find(garment, shapes, inside_out),
        )

    def worn_faces(self) -> Wearing:
        """Contact only with faces of parts on which some vertex of the garment lies, and of bare limbs."""
        keep = (self.worn.any(axis=0) | self.bare)[self.face_bone]
        kept = np.cumsum(keep) - 1
        return replace(
            self,
            faces=self.faces[keep],
            face_bone=self.face_bone[keep],
            own_face=kept[self.own_face].astype(np.int32),
            far_face=np.where(self.far_face < 0, -1, kept[self.far_face]).astype(np.int32),
        )


def _band(garment: Garment, avatar: Avatar, rig: Rig) -> np.ndarray:
    """(k,) vertices that hold a garment up. Raises ValueError where there is no opening."""
    loops = openings(garment.vertices, garment.faces)
    rim = holding_rim(garment.vertices, loops)
    if len(loops) > 2 and all(rim is not loop for loop in loops):
        shoulders = avatar.bone_heads[[limb.ends[0] for limb in find_limbs(rig).limbs if limb.is_arm]]
        from_middle = (garment.vertices - shoulders.mean(axis=0)) / (np.ptp(shoulders, axis=0).max() / 2)
        before, aside, above = from_middle.T
        near = (before < BEFORE) & (np.abs(aside) < BESIDE_NECK) & (ABOVE[0] < above) & (above < ABOVE[1])
        near &= cKDTree(avatar.vertices).query(garment.vertices)[0] < ON_SKIN
        if near.any():
            return np.flatnonzero(near)
    distance, _ = cKDTree(garment.vertices[rim]).query(garment.vertices, distance_upper_bound=BAND_WIDTH)
    return np.flatnonzero(np.isfinite(distance))


def _hung_around(
    garment: Garment,
    free: np.ndarray,
    distance: np.ndarray,
    avatar: Avatar,
    vertex_bone: np.ndarray,
    limbs: np.ndarray,
) -> np.ndarray:
    """(k, b) bool: the parts that the vertices `free` (k,) hang around, however far away; distance (k, b) [m]. They are
    those of each limb that can be seen from its closest point: no other cloth and no other skin is between."""
    face_at = np.zeros(len(garment.vertices), dtype=int)
    face_at[garment.faces] = np.arange(len(garment.faces))[:, None]
    face = face_at[free]
    place = garment.vertices[garment.faces[face]].mean(axis=1)
    surface = BodySurface(avatar.vertices, avatar.faces)
    around = np.zeros(distance.shape, dtype=bool)
    for limb in np.unique(limbs[vertex_bone]):
        skin = np.flatnonzero(limbs[vertex_bone] == limb)
        skin = skin[cKDTree(avatar.vertices[skin]).query(place)[1]]
        directions = place - avatar.vertices[skin]
        directions /= np.linalg.norm(directions, axis=1, keepdims=True)
        seen = covering_faces(avatar.vertices[skin], directions, garment.vertices, garment.faces) == face
        seen &= (avatar.faces[surface.facing(place, -directions, FARTHEST)[0]] == skin[:, None]).any(axis=1)
        of_limb = np.where(limbs == limb, distance, np.inf)
        about_closest = of_limb <= HUNG_BESIDE * of_limb.min(axis=1, keepdims=True)
        around |= seen[:, None] & about_closest & np.isfinite(of_limb)
    return around


def _joined(parts: np.ndarray, parents: np.ndarray) -> np.ndarray:
    """(n, b) bool: parents and children of the parts (n, b)."""
    child = np.flatnonzero(parents >= 0)
    joined = np.zeros_like(parts)
    joined[:, child] |= parts[:, parents[child]]
    for bone in child:
        joined[:, parents[bone]] |= parts[:, bone]
    return joined


def _limbs(parents: np.ndarray) -> np.ndarray:
    """(b,) the first bone of each bone's limb, or of trunk or neck: they begin where bones fork."""
    children = np.bincount(parents[parents >= 0], minlength=len(parents))
    first = np.arange(len(parents))
    for bone, parent in enumerate(parents):
        if parent >= 0 and children[parent] == 1:
            first[bone] = first[parent]
    return first


def _left_by(garment: Garment, avatar: Avatar) -> list[tuple[int, np.ndarray]]:
    """Bones around which an opening goes, each with the opening's vertices (k, 3). The one that holds the garment up is
    not one of them."""
    found = []
    for loop in _highest_first(garment.vertices, openings(garment.vertices, garment.faces))[1:]:
        rim = garment.vertices[loop]
        centre = rim.mean(axis=0)
        away = _distances_to_bones(centre, avatar.bone_heads, avatar.bone_tails)
        bone = int(away.argmin())
        if away[bone] <= GOES_AROUND * np.linalg.norm(rim - centre, axis=1).mean():
            found.append((bone, rim))
    return found


def _bare(
    left_by: list[tuple[int, np.ndarray]],
    avatar: Avatar,
    vertex_bone: np.ndarray,
    limbs: np.ndarray,
    parents: np.ndarray,
) -> np.ndarray:
    """(b,) bool: bones of a limb without a sleeve, from the one on which it leaves through an opening that touches
    another limb or the trunk."""
    bare = np.zeros(len(parents), dtype=bool)
    for bone, rim in left_by:
        elsewhere = avatar.vertices[limbs[vertex_bone] != limbs[bone]]
        bare[bone] |= cKDTree(elsewhere).query(rim)[0].min() < WORN_BESIDE
    for bone, parent in enumerate(parents):
        bare[bone] |= parent >= 0 and limbs[parent] == limbs[bone] and bare[parent]
    return bare


def _across(own: np.ndarray, avatar: Avatar, face_bone: np.ndarray) -> np.ndarray:
    """(n,) of each face `own` the face of the same part across the bone, or -1 where the part has no far side."""
    centres, far = avatar.vertices[avatar.faces].mean(axis=1), np.full(len(own), -1)
    for bone in np.unique(face_bone[own]):
        mine, part = face_bone[own] == bone, np.flatnonzero(face_bone == bone)
        head, axis = avatar.bone_heads[bone], avatar.bone_tails[bone] - avatar.bone_heads[bone]
        from_head = centres[own[mine]] - head
        along = np.outer(from_head @ axis / (axis @ axis), axis)
        distance, closest = cKDTree(centres[part]).query(head + 2 * along - from_head)
        far[mine] = np.where(distance <= FACES_ACROSS, part[closest], -1)
    return far


def _distances_to_bones(point: np.ndarray, heads: np.ndarray, tails: np.ndarray) -> np.ndarray:
    """(b,) [m] from a point to each bone's segment."""
    along = tails - heads
    share = np.einsum("bi,bi->b", point - heads, along) / np.maximum(np.einsum("bi,bi->b", along, along), 1e-12)
    return np.linalg.norm(heads + np.clip(share, 0, 1)[:, None] * along - point, axis=1)


def holding_rim(vertices: np.ndarray, loops: list[np.ndarray]) -> np.ndarray:
    """Vertices of a mesh, (n, 3) [m], Z up, that hold it on the body: of the loops of its boundary the one that reaches
    highest, or where that goes down to the hem its uppermost part. Raises ValueError where there is no loop."""
    if not loops:
        raise ValueError("the garment has no opening: every edge has two faces")
    loop = _highest_first(vertices, loops)[0]
    height = vertices[loop, 2]
    return loop[height >= height.max() - COLLAR] if np.ptp(height) > TO_THE_HEM else loop


def _highest_first(vertices: np.ndarray, loops: list[np.ndarray]) -> list[np.ndarray]:
    return sorted(loops, key=lambda loop: -vertices[loop, 2].max())

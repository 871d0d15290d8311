"""Which parts of an avatar are its body, which are clothes that it wears already, and which are accessories, such as
hair, eyes, glasses and shoes: for pictures.

A part is what one material draws of one mesh. Its names say what it may be. Where they do not, how much surface a body
has there says whether the part is needed; of those that are not, what lies over the body is clothes, and what lies in
its gaps, as the joints of a robot do, is an accessory.

Dimensions: `V` vertices, `f` faces, `j` joints, `k` parts, `r` regions of the body. Metres.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.skinned_mesh import SkinnedMesh
from physkin_core.avatar.surface_matching import NORMAL_REACH, with_normals
from physkin_core.file_reading import shown
from physkin_core.model.garment import face_areas
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS
from physkin_core.rig.linear_blend_skinning import strongest_influence
from physkin_core.rig.rig import Rig

__all__ = [
    "APPENDAGE",
    "BODY",
    "UNKNOWN",
    "BodyParts",
    "free_bones",
    "kind_of_part",
    "split_body",
    "without_accessories",
]

BODY, UNKNOWN, CLOTHES, ACCESSORY = range(4)
APPENDAGE = "appendage"
"""A word in the names of parts that no human has."""
WORDS = {
    ACCESSORY: "hair bang ponytail eye eyebrow eyelash iris pupil cornea lash brow teeth tooth tongue gum mouth beard "
    "moustache mustache glass glasses eyewear goggle hat cap helmet headwear horn tail wing weapon sword bag backpack "
    f"jewel earring necklace ring helper outline collider collision hitbox {APPENDAGE}",
    CLOTHES: "cloth clothing outfit top bottom shirt tshirt blouse sweater hoodie jacket coat vest suit dress skirt "
    "pant trouser jean short legging sock stocking shoe boot sneaker footwear sandal glove scarf tie belt underwear "
    "bra uniform kimono robe onepiece",
    BODY: "body skin face head torso arm leg hand foot feet human nude mannequin",
}
"""What the words in a part's names say that it is, the first that is found."""
FREE_BONES = "neck01", "wrist", "foot"
"""Where parts begin that garments leave free: what is worn there is shown with hair and the like."""
NEVER_SHOWN = {"helper", "cornea", "outline", "collider", "collision", "hitbox"}
"""Accessories that pictures show better without: helpers, clear shells and those turned inwards."""
PAINTED_ON_CARDS = {"lash", "eyelash", "brow", "eyebrow"}
"""What is shown only where its material says that one sees through the card that it is painted on."""
OVER, OVER_POINTS = 0.002, 500
"""[m] How far outside the body clothes are, at least, and how many points of a part are looked at."""
MARKED_JOINT = re.compile(r"joint[-_]", re.IGNORECASE)
"""How the names of the cubes begin that mark joints in MakeHuman's base mesh."""
WORD_KINDS = {word: kind for kind, words in WORDS.items() for word in words.split()}
REGION_BONES = (*LIMB_SEGMENTS, "neck01")
"""Bones at which a region of the body begins; the trunk is the last region."""
NEEDED = 0.5
"""Share of a part's surface for which there must be room, for it to be body."""
LARGEST_BODY = 1.5
"""Surface of a stout body over the mean body's: room for parts that are not clothes by name."""
LISTED_PARTS = 8
BARE = 0.15
"""Share of the mean body's skin below which a part has hardly any."""
PARTS = {"upperarm01": "upper arm", "lowerarm01": "forearm", "upperleg01": "thigh", "lowerleg01": "shin"}
PARTS |= {"neck01": "the head", "trunk": "the trunk"}


def kind_of_part(names: Sequence[str]) -> int:
    """`BODY`, `CLOTHES`, `ACCESSORY` or `UNKNOWN`, by the first name that says something."""
    for name in names:
        if MARKED_JOINT.match(name):
            return ACCESSORY
        found = {WORD_KINDS.get(word) for word in _forms(name)}
        for kind in WORDS:
            if kind in found:
                return kind
    return UNKNOWN


def without_accessories(
    vertices: np.ndarray, faces: np.ndarray, *, part_names: Sequence[Sequence[str]], face_parts: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and faces of a mesh less hair, glasses and the like, by name; of all that, if there is nothing else."""
    if len(part_names) < 2:
        return vertices, faces
    kept = np.array([kind_of_part(names) != ACCESSORY for names in part_names])[face_parts]
    used, corners = np.unique(faces[kept if kept.any() else ...], return_inverse=True)
    return vertices[used], corners.reshape(-1, 3)


@dataclass(frozen=True)
class BodyParts:
    """A mesh in parts. accessories: None where there are none. clothes: one each."""

    body: SkinnedMesh
    accessories: SkinnedMesh | None = None
    clothes: tuple[SkinnedMesh, ...] = ()


def split_body(mesh: SkinnedMesh, joint_bones: np.ndarray, rig: Rig, *, scale: float) -> BodyParts:
    """What of a mesh is its body, its clothes and its accessories; a warning says so, where it is not all body.

    joint_bones: (j,) bone of `rig` that each joint belongs to. scale: size of the skeleton over the rig's.
    """
    if len(mesh.part_names) < 2:
        return BodyParts(mesh)
    bones = joint_bones[strongest_influence(mesh.influence_joints, mesh.influence_weights)[mesh.faces[:, 0]]]
    face_area = face_areas(mesh.vertices, mesh.faces)
    cells = len(mesh.part_names), len(REGION_BONES) + 1
    cell = np.ravel_multi_index((mesh.face_parts, _bone_regions(rig)[bones]), cells)
    areas = np.bincount(cell, face_area, cells[0] * cells[1]).reshape(cells)
    kinds = np.array([kind_of_part(names) for names in mesh.part_names])
    free = np.bincount(mesh.face_parts, face_area * free_bones(rig)[bones], len(areas)) > areas.sum(axis=1) / 2
    worn = (kinds == CLOTHES) & ~free & _skin_can_stand_in(rig, kinds)
    unworn, usual = areas * ~worn[:, None], scale**2 * _usual_areas(rig)
    taken = _taken(unworn, kinds, usual, LARGEST_BODY) & ~worn
    doubtful = taken & (kinds == UNKNOWN) & ~free & ~_taken(unworn, kinds, usual, 1.0)
    taken[doubtful] = [not _lies_over(mesh, part, taken & ~doubtful) for part in np.flatnonzero(doubtful)]
    if taken.all() and not (kinds == CLOTHES).any():
        return BodyParts(mesh)
    over = ~taken & (kinds == UNKNOWN) & ~free & (areas.sum(axis=1) > 0)
    over[over] = [_lies_over(mesh, part, taken) for part in np.flatnonzero(over)]
    worn |= over | (~taken & ~free & (kinds == CLOTHES))
    seen = np.ones(len(mesh.faces), dtype=bool) if mesh.seen is None else mesh.seen
    in_sight = np.bincount(mesh.face_parts, seen, len(areas)) > 0
    shown = ~taken & ~worn & in_sight
    shown &= [_is_shown(names, part in mesh.clear_parts) for part, names in enumerate(mesh.part_names)]
    warned = replace(mesh, warnings=(*mesh.warnings, _report(mesh.part_names, kinds, taken, worn, shown)))
    return BodyParts(
        _faces_of(warned, taken[mesh.face_parts]),
        _faces_of(warned, shown[mesh.face_parts] & seen) if shown.any() else None,
        tuple(_faces_of(warned, (mesh.face_parts == part) & seen) for part in np.flatnonzero(worn & in_sight)),
    )


def _skin_can_stand_in(rig: Rig, kinds: np.ndarray) -> bool:
    """Whether clothes need not be the body where there is no skin beneath (see `skin_beneath`)."""
    return rig.bone_names == load_body_model().rig.bone_names and bool(np.isin(kinds, (BODY, UNKNOWN)).any())


def _lies_over(mesh: SkinnedMesh, part: int, body: np.ndarray) -> bool:
    """Whether most of a part is outside the body, a mask of parts (k,), next to what faces alike."""
    from scipy.spatial import cKDTree

    own, skin = (
        with_normals(*sample_surface(mesh.vertices, mesh.faces[chosen], OVER_POINTS))
        for chosen in (mesh.face_parts == part, body[mesh.face_parts])
    )
    near = skin[cKDTree(skin).query(own)[1]]
    return float(np.median(((own - near)[:, :3] * near[:, 3:]).sum(axis=1) / NORMAL_REACH)) > OVER


def _faces_of(mesh: SkinnedMesh, kept: np.ndarray) -> SkinnedMesh:
    """The mesh with some of its faces, a mask (f,)."""
    used, corners = np.unique(mesh.faces[kept], return_inverse=True)
    return replace(
        mesh,
        vertices=mesh.vertices[used],
        faces=corners.reshape(-1, 3),
        influence_joints=mesh.influence_joints[used],
        influence_weights=mesh.influence_weights[used],
        face_parts=mesh.face_parts[kept],
        seen=None if mesh.seen is None else mesh.seen[kept],
        file_vertices=None if mesh.file_vertices is None else mesh.file_vertices[used],
        file_corners=None if mesh.file_corners is None else mesh.file_corners[kept],
    )


def _is_shown(names: Sequence[str], clear: bool) -> bool:
    hidden = NEVER_SHOWN if clear else NEVER_SHOWN | PAINTED_ON_CARDS
    return not any(MARKED_JOINT.match(name) or hidden & _forms(name) for name in names)


def _taken(areas: np.ndarray, kinds: np.ndarray, usual: np.ndarray, largest: float) -> np.ndarray:
    """(k,) which parts are body. areas: (k, r) [m2]. usual: (r,) [m2] of a body without clothes, which has `largest`
    times that at most."""
    taken, filled = np.zeros(len(areas), dtype=bool), np.zeros_like(usual)
    for part in np.lexsort((-areas.sum(axis=1), kinds)):
        full = usual if kinds[part] == CLOTHES else largest * usual
        room = np.minimum(areas[part], np.maximum(full - filled, 0)).sum()
        if kinds[part] == BODY or (kinds[part] != ACCESSORY and room >= NEEDED * areas[part].sum()):
            taken[part] = True
            filled += areas[part]
    return taken if taken.any() else ~taken


def bare_parts(avatar: Avatar, rig: Rig) -> tuple[str, ...]:
    """Parts of a person, in words, on which an avatar has hardly any skin; none on a rig that is not a person's."""
    body = load_body_model()
    if rig.bone_names != body.rig.bone_names:
        return ()
    regions = _bone_regions(rig)[
        strongest_influence(avatar.influence_bones, avatar.influence_weights)[avatar.faces[:, 0]]
    ]
    areas = np.bincount(regions, face_areas(avatar.vertices, avatar.faces), len(REGION_BONES) + 1)
    size = np.linalg.norm(avatar.bone_heads, axis=1).mean() / np.linalg.norm(body.mean_bones[:, 0], axis=1).mean()
    bare = np.flatnonzero(areas < BARE * size**2 * _usual_areas(rig))
    sides = {"L": "the left ", "R": "the right "}
    named = [(*REGION_BONES, "trunk")[region].split(".") for region in bare]
    return tuple("".join(sides[side] for side in more) + PARTS.get(part, part) for part, *more in named)


def _report(
    names: Sequence[Sequence[str]], kinds: np.ndarray, taken: np.ndarray, worn: np.ndarray, shown: np.ndarray
) -> str:
    dressed = taken & (kinds == CLOTHES)
    text = f"of {len(names)} parts these were taken as the body: {_listed(names, taken)}"
    if dressed.any():
        text += f" ({_listed(names, dressed)} though by name clothes, as there is too little skin under them)"
    for label, chosen in (
        ("worn already", worn),
        ("shown, though garments do not heed it", shown),
        ("left out", ~taken & ~worn & ~shown),
    ):
        text += f"; {label}: {_listed(names, chosen)}" if chosen.any() else ""
    return text


def _listed(names: Sequence[Sequence[str]], chosen: np.ndarray) -> str:
    labels = list(dict.fromkeys("/".join(dict.fromkeys(names[part][::-1])) for part in np.flatnonzero(chosen)))
    more = f" and {len(labels) - LISTED_PARTS} more" if len(labels) > LISTED_PARTS else ""
    return ", ".join(map(shown, labels[:LISTED_PARTS])) + more


def _bone_regions(rig: Rig) -> np.ndarray:
    """(b,) region of each bone."""
    starts = {bone: REGION_BONES.index(name) for bone, name in enumerate(rig.bone_names) if name in REGION_BONES}
    return rig.inherited(starts, len(REGION_BONES))


def free_bones(rig: Rig) -> np.ndarray:
    """(b,) bool: bones of head, hands and feet."""
    starts = {bone: 1 for bone, name in enumerate(rig.bone_names) if name.split(".")[0] in FREE_BONES}
    return rig.inherited(starts, 0).astype(bool)


def _usual_areas(rig: Rig) -> np.ndarray:
    """(r,) [m2] of the mean body of the compact body model; without bounds for a rig that it does not know."""
    body = load_body_model()
    if rig.bone_names != body.rig.bone_names:
        return np.full(len(REGION_BONES) + 1, np.inf)
    region = _bone_regions(rig)[strongest_influence(body.influence_bones, body.influence_weights)[body.faces[:, 0]]]
    return np.bincount(region, face_areas(body.mean_vertices, body.faces), len(REGION_BONES) + 1)


def _forms(name: str) -> set[str]:
    """Its words, in the singular, too."""
    return {form for word in _words(name) for form in (word, word.removesuffix("s"), word.removesuffix("es"))}


def _words(name: str) -> list[str]:
    """Lower-case words of a name like `Wolf3D_Outfit_Top`, `HairBack.001` or `eyeLashes`."""
    return [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)]

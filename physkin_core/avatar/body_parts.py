"""Which parts of an avatar are its body: not hair, eyes, glasses, nor clothes with skin under them. Hair, shoes
and the like are its accessories: for pictures.

A part is what one material draws of one mesh. Its names say what it may be; how much surface the body has where the
part is says whether it is needed: of avatars that were modelled dressed, the clothes are the body.

Dimensions: `V` vertices, `f` faces, `j` joints, `k` parts, `r` regions of the body. Metres.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.skinned_mesh import SkinnedMesh
from physkin_core.model.garment import face_areas
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS
from physkin_core.rig.rig import Rig

__all__ = ["kind_of_part", "split_body", "without_accessories"]

BODY, UNKNOWN, CLOTHES, ACCESSORY = range(4)
WORDS = {
    ACCESSORY: "hair bang ponytail eye eyebrow eyelash iris pupil cornea lash brow teeth tooth tongue gum mouth beard "
    "moustache mustache glass glasses eyewear goggle hat cap helmet headwear horn tail wing weapon sword bag backpack "
    "jewel earring necklace ring helper",
    CLOTHES: "cloth clothing outfit top bottom shirt tshirt blouse sweater hoodie jacket coat vest suit dress skirt "
    "pant trouser jean short legging sock stocking shoe boot sneaker footwear sandal glove scarf tie belt underwear "
    "bra uniform kimono robe onepiece",
    BODY: "body skin face head torso arm leg hand foot feet human nude mannequin",
}
"""What the words in a part's names say that it is, the first that is found."""
FREE_BONES = "neck01", "wrist", "foot"
"""Where parts begin that garments leave free: what is worn there is shown with hair and the like."""
NOT_SHOWN = {"helper", "lash", "eyelash", "brow", "eyebrow", "cornea"}
"""Accessories that pictures show better without: helpers, and what is painted on clear cards and shells."""
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


def split_body(
    mesh: SkinnedMesh, joint_bones: np.ndarray, rig: Rig, *, scale: float
) -> tuple[SkinnedMesh, SkinnedMesh | None]:
    """The mesh's parts that are its body, and those that are accessories to show, if there are any; a warning says
    which were taken and which left out.

    joint_bones: (j,) bone of `rig` that each joint belongs to. scale: size of the skeleton over the rig's.
    """
    if len(mesh.part_names) < 2:
        return mesh, None
    strongest = np.take_along_axis(mesh.influence_joints, mesh.influence_weights.argmax(axis=1)[:, None], axis=1)[:, 0]
    bones = joint_bones[strongest[mesh.faces[:, 0]]]
    face_area = face_areas(mesh.vertices, mesh.faces)
    cells = len(mesh.part_names), len(REGION_BONES) + 1
    cell = np.ravel_multi_index((mesh.face_parts, _bone_regions(rig)[bones]), cells)
    areas = np.bincount(cell, face_area, cells[0] * cells[1]).reshape(cells)
    kinds = np.array([kind_of_part(names) for names in mesh.part_names])
    taken = _taken(areas, kinds, scale**2 * _usual_areas(rig))
    if taken.all() and not (kinds == CLOTHES).any():
        return mesh, None
    free = np.bincount(mesh.face_parts, face_area * _are_free(rig)[bones], len(areas)) > areas.sum(axis=1) / 2
    shown = ~taken & ((kinds == ACCESSORY) | free)
    shown &= [k not in mesh.clear_parts and _is_shown(names) for k, names in enumerate(mesh.part_names)]
    warned = replace(mesh, warnings=(*mesh.warnings, _report(mesh.part_names, kinds, taken, shown)))
    return _parts_of(warned, taken), _parts_of(warned, shown) if shown[mesh.face_parts].any() else None


def _parts_of(mesh: SkinnedMesh, chosen: np.ndarray) -> SkinnedMesh:
    """The mesh with some of its parts, a mask (k,)."""
    kept = chosen[mesh.face_parts]
    used, corners = np.unique(mesh.faces[kept], return_inverse=True)
    return replace(
        mesh,
        vertices=mesh.vertices[used],
        faces=corners.reshape(-1, 3),
        influence_joints=mesh.influence_joints[used],
        influence_weights=mesh.influence_weights[used],
        face_parts=mesh.face_parts[kept],
        file_vertices=None if mesh.file_vertices is None else mesh.file_vertices[used],
        file_corners=None if mesh.file_corners is None else mesh.file_corners[kept],
    )


def _is_shown(names: Sequence[str]) -> bool:
    return not any(MARKED_JOINT.match(name) or NOT_SHOWN & _forms(name) for name in names)


def _taken(areas: np.ndarray, kinds: np.ndarray, usual: np.ndarray) -> np.ndarray:
    """(k,) which parts are body. areas: (k, r) [m2]. usual: (r,) [m2] of a body without clothes."""
    taken, filled = np.zeros(len(areas), dtype=bool), np.zeros_like(usual)
    for part in np.lexsort((-areas.sum(axis=1), kinds)):
        full = usual if kinds[part] == CLOTHES else LARGEST_BODY * usual
        room = np.minimum(areas[part], np.maximum(full - filled, 0)).sum()
        if kinds[part] == BODY or (kinds[part] != ACCESSORY and room >= NEEDED * areas[part].sum()):
            taken[part] = True
            filled += areas[part]
    return taken if taken.any() else ~taken


def _report(names: Sequence[Sequence[str]], kinds: np.ndarray, taken: np.ndarray, shown: np.ndarray) -> str:
    dressed = taken & (kinds == CLOTHES)
    text = f"of {len(names)} parts these were taken as the body: {_listed(names, taken)}"
    if dressed.any():
        text += f" ({_listed(names, dressed)} though by name clothes, as there is too little skin under them)"
    for label, chosen in (("shown, though garments do not heed it", shown), ("left out", ~taken & ~shown)):
        text += f"; {label}: {_listed(names, chosen)}" if chosen.any() else ""
    return text


def _listed(names: Sequence[Sequence[str]], chosen: np.ndarray) -> str:
    labels = list(dict.fromkeys("/".join(dict.fromkeys(names[part][::-1])) for part in np.flatnonzero(chosen)))
    more = f" and {len(labels) - LISTED_PARTS} more" if len(labels) > LISTED_PARTS else ""
    return ", ".join(map(repr, labels[:LISTED_PARTS])) + more


def _bone_regions(rig: Rig) -> np.ndarray:
    """(b,) region of each bone."""
    starts = {bone: REGION_BONES.index(name) for bone, name in enumerate(rig.bone_names) if name in REGION_BONES}
    return rig.inherited(starts, len(REGION_BONES))


def _are_free(rig: Rig) -> np.ndarray:
    """(b,) bool: bones of head, hands and feet."""
    starts = {bone: 1 for bone, name in enumerate(rig.bone_names) if name.split(".")[0] in FREE_BONES}
    return rig.inherited(starts, 0).astype(bool)


def _usual_areas(rig: Rig) -> np.ndarray:
    """(r,) [m2] of the mean body of the compact body model; without bounds for a rig that it does not know."""
    body = load_body_model()
    if rig.bone_names != body.rig.bone_names:
        return np.full(len(REGION_BONES) + 1, np.inf)
    rows = np.arange(len(body.mean_vertices))
    strongest = body.influence_bones[rows, body.influence_weights.argmax(axis=1)]
    region = _bone_regions(rig)[strongest[body.faces[:, 0]]]
    return np.bincount(region, face_areas(body.mean_vertices, body.faces), len(REGION_BONES) + 1)


def _forms(name: str) -> set[str]:
    """Its words, in the singular, too."""
    return {form for word in _words(name) for form in (word, word.removesuffix("s"), word.removesuffix("es"))}


def _words(name: str) -> list[str]:
    """Lower-case words of a name like `Wolf3D_Outfit_Top`, `HairBack.001` or `eyeLashes`."""
    return [word.lower() for word in re.findall(r"[A-Z]?[a-z]+|[A-Z]+(?![a-z])", name)]

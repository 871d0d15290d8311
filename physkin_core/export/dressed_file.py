"""An avatar's own file with clothes added: its document, its bytes and its clips stay, and in these the clothes move.

Garment nodes become joints that hang on the file's own: whatever moves these carries them, and the channels that are
added to a clip say what cloth does beside that. Triangles that cloth covers are left out of the file's indices; no
vertex is touched.

Dimensions: `T` frames, `b` bones, `m` garment nodes.
"""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.retargeting import covered_bones
from physkin_core.export.draped_clip import DrapedGarment, drape_clip
from physkin_core.export.gltf_motion import AnimatedScene, not_shown
from physkin_core.file_reading import ContentError
from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME, GltfBuilder, write_glb
from physkin_core.formats.gltf_compression import DRACO
from physkin_core.formats.gltf_document import GltfEntry
from physkin_core.formats.gltf_file import TRIANGLES, GltfFile
from physkin_core.formats.gltf_scene import drawn_primitives
from physkin_core.look.avatar_look import avatar_look
from physkin_core.look.cloth_look import cloth_colours
from physkin_core.mesh.look import Look, picture_kind
from physkin_core.mesh.surfaces import parts_of
from physkin_core.motion.gltf_clip import GltfClip, the_clip
from physkin_core.motion.motion import Motion
from physkin_core.motion.pose_solver import PoseSolver
from physkin_core.outfit.outfit import Outfit
from physkin_core.pictures.picture import BODY_COLOUR
from physkin_core.rig.rig import Rig, ancestors

__all__ = ["write_dressed_file"]

MOST_FRAMES = 4096
"""Of all clips together, 68 s at 60 Hz, which bounds the memory: half a gigabyte a garment."""
LIGHT = {"foot": 0.15, "wrist": 0.15, "neck01": 0.15, "head": 0.15}
"""How much a turn of these counts, which must not drag along limb or trunk; 1 is usual."""


def write_dressed_file(
    path: Path, file: GltfFile, outfit: Outfit, avatar: Avatar, looks: Sequence[Look | None], clip: str, rate_hz: float
) -> tuple[str, list[str]]:
    """Write the file that an avatar was read from with an outfit on it. Returns what was dressed, and what the file
    cannot show, a sentence each.

    outfit: as of `drape_clip`. looks: of garments, as of `garment_looks`. clip: name or number of the only one in which
    the clothes are to move; empty for all. rate_hz: of their channels.
    Raises ContentError and MotionError for clips that cannot be read, and OSError.
    """
    rig = outfit.rig
    animations = [the_clip(file, clip)] if clip else file.document.entries("animations")
    clips = [(entry, each) for entry in animations if (each := GltfClip(file, entry)).moved]
    counts = [1 + int(np.ceil((each.end - each.start) * rate_hz - 1e-6)) for _, each in clips]
    if sum(counts) > MOST_FRAMES:
        more = f"its clips have {sum(counts)} frames at {rate_hz:g} Hz, allowed are {MOST_FRAMES}"
        raise ContentError(f"{more}; choose one with #NAME after the file, or a lower --rate")
    times = [np.linspace(each.start, each.end, count) for (_, each), count in zip(clips, counts)]
    still = _own_motion(file, avatar, rig, GltfClip(file, GltfEntry({}, "")), np.zeros(1))
    motions = [_own_motion(file, avatar, rig, each, seconds) for (_, each), seconds in zip(clips, times)]
    draped = drape_clip(outfit, still, *motions, everyday=not clips)
    scene = AnimatedScene([(entry.members, each) for (entry, _), each in zip(clips, times)], _opened(file), still=1)
    carrier, colours = _carriers(avatar, rig), cloth_colours(outfit.garments)
    for garment, layer, colour, look in zip(draped.garments, outfit.layers, colours, looks):
        if garment.shown.any():
            own = None if look is None else look.of_faces(garment.shown, layer.faces)
            parents = avatar.file_joints[carrier[garment.given.node_bone]]
            scene.add_garment(_on_joints(garment, avatar, carrier, draped.bones), parents, colour, own)
    _add_lent_skin(scene, outfit.body_to_draw, draped.body_shown, carrier)
    worn, all_worn = outfit.body_to_draw.file_corners[draped.body_shown], avatar.with_accessories().file_corners
    lacking = _leave_out(file, scene.builder, np.setdiff1d(all_worn // 3, worn // 3))
    write_glb(path, scene.builder)
    said = ", ".join(f"{entry.text('name') or 'clip'} ({count} frames)" for (entry, _), count in zip(clips, counts))
    lacking += [warning for garment in draped.garments for warning in not_shown(garment)]
    return f"dressed in {said}" if clips else "no clip: clothes at rest, which its joints move", lacking


def _carriers(avatar: Avatar, rig: Rig) -> np.ndarray:
    """(b,) for each bone the one whose joint in the file moves the skin there: itself, the nearest above that has one,
    or else the first that has one."""
    own = np.flatnonzero(avatar.file_joints >= 0)
    return rig.inherited({int(bone): int(bone) for bone in own}, int(own[0]))


def _own_motion(file: GltfFile, avatar: Avatar, rig: Rig, clip: GltfClip, seconds: np.ndarray) -> Motion:
    """How the rig moves where the clip moves the file's joints, at evenly spaced times (T,) [s]. Raises ContentError,
    and MotionError for what is not finite."""
    bones = np.unique(_carriers(avatar, rig))
    joints, names = avatar.file_joints[bones], {rig.bone_names[bone] for bone in bones}
    inside = {above for joint in joints for above in ancestors(file.node_parents, joint)}
    nodes = [node for node in file.node_order if node in inside]
    worlds = dict(zip(nodes, clip.worlds(nodes, seconds)))
    moved = np.stack([worlds[joint] for joint in joints], axis=1) @ np.linalg.inv(avatar.file_joint_frames[bones])
    root, linear = moved[:, 0], moved[..., :3, :3]
    unit = np.cbrt(np.median(np.linalg.det(linear[:, 0])))  # the scene's, a metre
    follows = np.flatnonzero(np.isin(rig.turns_with[bones], rig.dof_bones) & (bones != bones[0]))
    axes = np.stack([LIGHT.get(rig.bone_names[bone].split(".")[0], 1.0) * np.eye(3) for bone in bones[follows]])
    solver = PoseSolver(rig, [covered_bones(int(bone), rig, names)[-1] for bone in bones[follows]], axes)
    turned = _turns(np.linalg.pinv(linear[:, :1]) @ linear[:, follows]).as_matrix()
    return Motion(
        rig.joint_names,
        solver.solve(turned.reshape(-1, *axes.shape) @ axes),
        _turns(FROM_ROOT_FRAME.T @ linear[:, 0] / unit).as_quat(),
        root[:, :3, 3] @ FROM_ROOT_FRAME / unit,
        rate_hz=(len(seconds) - 1) / (seconds[-1] - seconds[0]) if len(seconds) > 1 else 1.0,
    )


def _turns(linear: np.ndarray) -> Rotation:
    """Rotations of linear maps (..., 3, 3), all in one list; none of what is scaled to nothing."""
    linear = linear.reshape(-1, 3, 3)
    size = np.cbrt(np.linalg.det(linear))[:, None, None]
    return Rotation.from_matrix(np.where(size > 1e-3, linear / np.maximum(size, 1e-3), np.eye(3)))


def _on_joints(garment: DrapedGarment, avatar: Avatar, carrier: np.ndarray, bones: np.ndarray) -> DrapedGarment:
    """A garment whose nodes are seen from the joints of the file that carry them, glTF's axes being called as those of
    the root frame; at rest as in the first frame. carrier: (b,). bones: (T, b, 3, 4)."""
    of_node, last = garment.given.node_bone, [0.0, 0.0, 0.0, 1.0]
    moved = bones[:, of_node].astype(np.float64), garment.node_transforms.astype(np.float64)
    bone, node = (np.insert(each, 3, last, axis=2) for each in moved)
    seen = np.linalg.inv(avatar.file_joint_frames[carrier[of_node]]) @ np.linalg.inv(bone) @ node
    morphs = garment.morphs
    morphs = replace(morphs, resting=morphs.weights[0]) if len(morphs.targets) else morphs
    return replace(garment, node_transforms=FROM_ROOT_FRAME.T @ seen[:, :, :3], morphs=morphs)


def _add_lent_skin(scene: AnimatedScene, avatar: Avatar, shown: np.ndarray, carrier: np.ndarray) -> None:
    """Add what is shown of the skin that the body model lends to an avatar which has clothes only there: each of its
    faces has one corner of the file (`with_skin_beneath`). shown: (F,) bool. carrier: (b,)."""
    lent = shown & (avatar.file_corners[:, 0] == avatar.file_corners[:, 1])
    if lent.any():
        bones, place = np.unique(carrier, return_inverse=True)
        binds = np.linalg.inv(avatar.file_joint_frames[bones])
        binds[:, :, :3] = binds[:, :, :3] @ FROM_ROOT_FRAME.T
        inverse = scene.builder.add_accessor(binds.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32))
        skins = scene.builder.document["skins"]
        skins.append({"joints": avatar.file_joints[bones].tolist(), "inverseBindMatrices": inverse})
        (part,) = parts_of(avatar_look(avatar, lent), "skin", BODY_COLOUR, avatar.faces[lent])
        moved = replace(avatar, influence_bones=place[avatar.influence_bones])
        scene.add_body(moved, part, skin=len(skins) - 1)


def _opened(file: GltfFile) -> GltfBuilder:
    """A document and its bytes to add to, with what lies beside the file: buffers, and pictures that are there."""
    document, builder = file.document.members, GltfBuilder({})
    builder.document, builder.binary = document, bytearray(file.buffers[0])
    document["buffers"][0].pop("uri", None)
    for buffer, content in zip(document["buffers"][1:], file.buffers[1:]):
        if "uri" in buffer:
            buffer["uri"] = f"data:application/octet-stream;base64,{b64encode(content).decode()}"
    if not document.get("scenes"):
        document |= {"scene": 0, "scenes": [{"nodes": np.flatnonzero(file.node_parents < 0).tolist()}]}
    for number, image in enumerate(file.document.entries("images")):
        with suppress(ContentError, OSError):
            embedded = "uri" not in image or image.text("uri").startswith("data:")
            if not embedded and (kind := picture_kind(content := file.picture(number))):
                view = builder.add_view(np.frombuffer(content, dtype=np.uint8))
                del image.members["uri"]
                image.members |= {"mimeType": kind, "bufferView": view}
    return builder


def _leave_out(file: GltfFile, builder: GltfBuilder, hidden: np.ndarray) -> list[str]:
    """Leave triangles out of the file's indices. hidden: their numbers, counted over the whole file. Says if some have
    to stay."""
    drawn: dict[int, tuple[GltfEntry, np.ndarray]] = {}
    packed = 0
    for each in drawn_primitives(file):  # more than one node may show it
        key, seen = id(each.primitive.members), ~np.isin(each.corners[:, 0] // 3, hidden)
        drawn[key] = each.primitive, seen | drawn[key][1] if key in drawn else seen
    for primitive, seen in drawn.values():
        if DRACO in primitive.entry("extensions"):
            packed += int((~seen).sum())
        elif not seen.all():
            faces = file.triangles(primitive)[seen] if seen.any() else np.zeros((1, 3))  # none is not allowed
            indices = faces.astype(np.uint16 if faces.max() < 0xFFFF else np.uint32).reshape(-1)
            primitive.members |= {"indices": builder.add_accessor(indices), "mode": TRIANGLES}
    return [f"{packed} triangles that cloth covers stay, as {DRACO} holds them: skin may show"] if packed else []

"""An avatar's own file with clothes added: its document and its bytes stay, and so do its clips, in which the clothes
move, too.

Garment nodes become joints that hang on the file's own: they are carried by whatever moves these, and channels added to
a clip only say what cloth does beside that. Of the file's triangles those that cloth covers are left out of the indices;
no vertex is touched.

Dimensions: `T` frames, `b` bones, `m` garment nodes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.loading import GLTF_SUFFIXES
from physkin_core.export.draped_clip import DrapedGarment, drape_clip
from physkin_core.export.gltf_builder import FROM_ROOT_FRAME, GltfBuilder, write_glb
from physkin_core.export.gltf_motion import AnimatedScene, not_shown
from physkin_core.export.own_clips import carriers, own_motion
from physkin_core.file_reading import ContentError
from physkin_core.formats.gltf_compression import DRACO, meshopt_extension
from physkin_core.formats.gltf_document import GltfEntry
from physkin_core.formats.gltf_file import TRIANGLES, GltfFile
from physkin_core.formats.gltf_scene import drawn_primitives
from physkin_core.look.cloth_look import cloth_colours
from physkin_core.mesh.look import Look, picture_kind
from physkin_core.motion.gltf_clip import GltfClip, chosen_clip
from physkin_core.motion.source_clip import RATE_HZ
from physkin_core.outfit.outfit import Outfit

__all__ = ["is_skinned", "write_dressed_file"]

MOST_FRAMES = 1 << 14
"""Of all clips together, which bounds the memory: four and a half minutes at 60 Hz."""


def is_skinned(path: Path) -> bool:
    """Whether it is a glTF file with a skin that can be read."""
    try:
        return path.suffix.lower() in GLTF_SUFFIXES and GltfFile(path).document.count("skins") > 0
    except (ContentError, OSError):
        return False


def write_dressed_file(
    path: Path,
    source: Path,
    outfit: Outfit,
    avatar: Avatar,
    *,
    looks: Sequence[Look | None],
    clip: str = "",
    rate_hz: float | None = None,
) -> tuple[list[str], list[str]]:
    """Write the file that an avatar was read from with an outfit on it, as one .glb or .vrm. Returns what was dressed,
    and what the file cannot show, a sentence each.

    outfit: as of `drape_clip`, on the avatar. looks: of each garment, as of `garment_looks`. clip: name or number of
    the only one in which the clothes are to move; default all. rate_hz: of the clothes' channels; default `RATE_HZ`.
    Raises ContentError and MotionError for clips that cannot be read, and OSError.
    """
    file, rig = GltfFile(source, lenient=True), outfit.rig
    animations = [chosen_clip(file, clip)] if clip else file.document.entries("animations")
    clips = [(entry, each) for entry in animations if (each := GltfClip(file, entry)).moved]
    spans = [(each.start, each.end, (each.end - each.start) * (rate_hz or RATE_HZ)) for _, each in clips]
    if (frames := sum(span[2] for span in spans)) > MOST_FRAMES:
        raise ContentError(
            f"its clips have {frames:.0f} frames at {rate_hz or RATE_HZ:g} Hz, allowed are {MOST_FRAMES}; choose one "
            "with #NAME after the file, or a lower --rate"
        )
    seconds = [np.linspace(start, end, 1 + int(np.ceil(count - 1e-6))) for start, end, count in spans]
    still = own_motion(file, avatar, rig, GltfClip(file, GltfEntry({}, "")), np.zeros(1))
    motions = [own_motion(file, avatar, rig, each, times) for (_, each), times in zip(clips, seconds)]
    draped = drape_clip(outfit, still, *motions, everyday=not clips)

    scene = AnimatedScene(_opened(file), still=1)
    for (entry, _), times in zip(clips, seconds):
        scene.add_take(entry.members, times)
    carrier = carriers(avatar, rig)
    colours = cloth_colours(outfit.garments)
    for garment, layer, colour, look in zip(draped.garments, outfit.layers, colours, looks):
        if garment.shown.any():
            own = None if look is None else look.of_faces(garment.shown, layer.faces)
            parents = avatar.file_joints[carrier[garment.given.node_bone]].tolist()
            scene.add_garment(_on_joints(garment, avatar, carrier, draped.bones), parents, colour, own)
    worn, left = outfit.body_to_draw.file_corners[draped.body_shown], avatar.with_accessories().file_corners
    kept = _leave_out(file, scene.builder, np.setdiff1d(left // 3, worn // 3))
    write_glb(path, scene.builder)
    names = [entry.text("name") or "clip without a name" for entry, _ in clips]
    said = [f"{name}: {len(times)} frames" for name, times in zip(names, seconds)]
    if not clips:
        said = ["the file has no clip: the clothes lie at rest on its joints and move with these"]
    return said, [*kept, *(warning for garment in draped.garments for warning in not_shown(garment))]


def _on_joints(garment: DrapedGarment, avatar: Avatar, carrier: np.ndarray, bones: np.ndarray) -> DrapedGarment:
    """A garment whose nodes are seen from the joints of the file that carry them, as glTF's axes are turned to the root
    frame's; without animation as in the first frame. carrier: (b,). bones: (T, b, 3, 4)."""
    of_node = garment.given.node_bone
    to_joint = np.linalg.inv(avatar.file_joint_frames[carrier[of_node]])
    to_joint[:, :3] = FROM_ROOT_FRAME.T @ to_joint[:, :3]
    transforms = to_joint @ np.linalg.inv(_as_4x4(bones[:, of_node])) @ _as_4x4(garment.node_transforms)
    morphs = garment.morphs
    if len(morphs.targets):
        morphs = replace(morphs, resting=morphs.weights[0])
    return replace(garment, node_transforms=transforms[..., :3, :], morphs=morphs)


def _as_4x4(transforms: np.ndarray) -> np.ndarray:
    """(..., 4, 4) of (..., 3, 4)."""
    last = np.broadcast_to([0.0, 0.0, 0.0, 1.0], (*transforms.shape[:-2], 1, 4))
    return np.concatenate([transforms.astype(np.float64), last], axis=-2)


def _opened(file: GltfFile) -> GltfBuilder:
    """A file's document to add to, in one buffer with what lies beside the file, pictures too where they are there."""
    document, builder = file.document.members, GltfBuilder({})
    buffers, builder.document, place = document.get("buffers") or [], document, {}
    for number, content in enumerate(file.buffers):
        builder.binary += b"\0" * (-len(builder.binary) % 4)
        place[number] = len(builder.binary)
        builder.binary += content[: buffers[number]["byteLength"]]
    fallback = [each for number, each in enumerate(buffers) if not len(file.buffers[number])]
    for entry in file.document.entries("bufferViews"):
        for view in filter(None, (entry, meshopt_extension(entry))):
            number = view.integer("buffer")
            if len(file.buffers[number]):
                view.members |= {"buffer": 0, "byteOffset": place[number] + view.integer("byteOffset", 0)}
            else:
                view.members["buffer"] = 1 + next(k for k, each in enumerate(fallback) if each is buffers[number])
    document["buffers"] = [{**(buffers[0] if len(buffers) == 1 else {}), "byteLength": len(builder.binary)}, *fallback]
    document["buffers"][0].pop("uri", None)
    for key in ("bufferViews", "accessors"):
        document[key] = document.get(key) or []
    if not document.get("scenes"):
        document |= {"scene": 0, "scenes": [{"nodes": np.flatnonzero(file.node_parents < 0).tolist()}]}
    for number, image in enumerate(document.get("images") or []):
        if "uri" not in image or image["uri"].startswith("data:"):
            continue
        try:
            content = file.picture(number)
        except (ContentError, OSError):
            continue
        if kind := picture_kind(content):
            del image["uri"]
            image |= {"mimeType": kind, "bufferView": builder.add_view(np.frombuffer(content, dtype=np.uint8))}
    return builder


def _leave_out(file: GltfFile, builder: GltfBuilder, hidden: np.ndarray) -> list[str]:
    """Leave triangles out of the file's indices. hidden: their numbers, counted over the whole file. Returns a sentence
    if there are some that cannot be left out."""
    drawn: dict[int, tuple[GltfEntry, np.ndarray]] = {}
    for each in drawn_primitives(file):
        seen = ~np.isin(each.corners[:, 0] // 3, hidden)
        before = drawn.get(id(each.primitive.members), (None, False))[1]
        drawn[id(each.primitive.members)] = each.primitive, seen | before
    packed = 0
    for primitive, seen in drawn.values():
        if seen.all():
            continue
        if DRACO in primitive.entry("extensions"):
            packed += int((~seen).sum())
            continue
        faces = file.triangles(primitive)[seen] if seen.any() else np.zeros((1, 3), dtype=int)  # none is not allowed
        kind = np.uint16 if faces.max() < 0xFFFF else np.uint32
        primitive.members |= {"indices": builder.add_accessor(faces.astype(kind).reshape(-1)), "mode": TRIANGLES}
    return [f"{packed} triangles under the clothes stay in the file: they are compressed by {DRACO}"] if packed else []

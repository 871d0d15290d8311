"""Files with a clip of any skeleton, by suffix; one of them as motion of the default rig."""

from __future__ import annotations

import logging
import re
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from physkin_core.file_reading import ContentError, read_text, reading
from physkin_core.motion.landmark_files import has_landmarks
from physkin_core.motion.motion import Motion, MotionError
from physkin_core.motion.pace import doubtful_pace
from physkin_core.progress import Watch
from physkin_core.rig.bones_file import read_bones_file
from physkin_core.rig.rig import Rig

if TYPE_CHECKING:
    from physkin_core.motion.source_clip import SourceClip

__all__ = ["CLIP_SUFFIXES", "describe_clips", "is_clip", "load_clip"]

log = logging.getLogger(__name__)

GLTF_SUFFIXES = (".glb", ".gltf", ".vrm", ".vrma", ".fbx")
CLIP_SUFFIXES = (".bvh", ".amc", ".npz", *GLTF_SUFFIXES)
LARGEST_SKELETON = 1 << 22
"""[bytes] of an ASF file: that of 1,000 bones has some hundred thousand."""


def split_clip_name(path: str | Path) -> tuple[Path, str]:
    """A file and which of its clips, from `me.glb#Walk`; the clip is empty for all other names."""
    named = re.fullmatch(rf"(.*?(?:{'|'.join(GLTF_SUFFIXES)}))#(.*)", str(path), re.IGNORECASE)
    return (Path(named[1]), named[2]) if named and not Path(path).exists() else (Path(path), "")


def is_clip(path: str | Path) -> bool:
    """Whether a file is read as clips of any skeleton, by its suffix; an .npz may hold landmarks instead."""
    file, _ = split_clip_name(path)
    return file.suffix.lower() in CLIP_SUFFIXES and not has_landmarks(file)


def load_clip(
    path: str | Path,
    rig: Rig,
    *,
    bones: str | Path | None = None,
    skeleton: str | Path | None = None,
    source_rate_hz: float | None = None,
    watch: Watch = lambda share: None,
) -> tuple[Motion, dict[str, float]]:
    """Read a file as motion of the default rig at 60 Hz, standing on the floor and facing X at first.

    path: as `load_motion` takes it, of one of `CLIP_SUFFIXES`. rig: the default one. skeleton: the .asf of an .amc;
    None: `02.asf` for `02_02.amc`. bones, source_rate_hz, watch: as of `load_motion`. Frames of a calibration pose
    before the motion are left out, with a warning.
    Also returns the mean angle [degrees] between a bone's direction and the source's, by rig bone.
    Raises MotionError: unreadable, malformed, or a limb that is not recognised.
    """
    from physkin_core.motion.clip_retargeting import retarget_clip
    from physkin_core.motion.source_clip import check_clip_size

    if source_rate_hz is not None and not 0 < source_rate_hz < np.inf:
        raise MotionError(f"source_rate_hz must be positive and finite, got {source_rate_hz}")
    file, name = split_clip_name(path)
    with reading(f"motion file {path}", MotionError):
        clip = _read(file, name, skeleton)
        clip = replace(clip, by_hand=read_bones_file(bones, file, rig.bone_names, clip.names))
        if source_rate_hz is not None:
            check_clip_size(clip.frame_count, len(clip.names), source_rate_hz)
            clip = replace(clip, rate_hz=source_rate_hz)
        motion, report = retarget_clip(clip, rig, subject=str(path), name=name or file.stem, watch=watch)
    if doubt := doubtful_pace(motion, rig):
        log.warning("%s: %s", path, doubt)
    return motion, report


def describe_clips(path: str | Path, rig: Rig) -> dict[str, str]:
    """How long the clips of a file are, by number and name, and a bones file of them; empty where there are
    none. Raises MotionError."""
    from physkin_core.formats.gltf_file import GltfFile
    from physkin_core.motion.gltf_clip import gltf_clip_names, read_gltf_clip
    from physkin_core.rig.human_skeleton import find_human_skeleton

    (file, _), rows = split_clip_name(path), {}
    with reading(f"motion file {path}", MotionError):
        if file.suffix.lower() in GLTF_SUFFIXES:
            gltf = GltfFile(file)
            clips = zip(gltf_clip_names(gltf), gltf.document.entries("animations"))
            readers = [(name, partial(read_gltf_clip, gltf, animation)) for name, animation in clips]
        else:
            readers = [(file.stem, partial(_read, file, "", None))]
        bones = {}
        for number, (name, read) in enumerate(readers, 1):
            try:
                clip = read()
            except ContentError as error:  # as of a clip that moves a face alone
                if len(readers) == 1:
                    raise
                rows[f"clip {number}"] = f"{name}: {error}"
                continue
            seconds = clip.frame_count / clip.rate_hz
            rows[f"clip {number}"] = f"{name}: {seconds:.2f} s at {clip.rate_hz:.4g} Hz, {len(clip.names)} joints"
            if not bones:
                human = find_human_skeleton(clip.names, clip.parents, clip.rest, rig, humanoid=clip.humanoid)
                bones = {"bones": human.bones_file(clip.names, rig)}
    return rows | bones


def _read(file: Path, name: str, skeleton: str | Path | None) -> SourceClip:
    from physkin_core.formats.gltf_file import GltfFile
    from physkin_core.motion.amc_file import read_amc
    from physkin_core.motion.bvh_file import read_bvh
    from physkin_core.motion.gltf_clip import read_gltf_clip, the_clip
    from physkin_core.motion.smpl_clip import read_smpl_clip

    match file.suffix.lower():
        case ".bvh":
            return read_bvh(read_text(file), name=str(file))
        case ".amc":
            asf = Path(skeleton) if skeleton else file.with_name(f"{file.stem.split('_')[0]}.asf")
            with reading(f"skeleton {asf}", MotionError):
                bones = read_text(asf, most=LARGEST_SKELETON)
            return read_amc(read_text(file), bones)
        case ".npz":
            return read_smpl_clip(file)
    gltf = GltfFile(file)
    return read_gltf_clip(gltf, the_clip(gltf, name))

"""Loading motion: a bundled clip, a file that `save_motion` wrote, a clip of any skeleton, or a bag.

A clip is one safetensors file. It stays in single precision: half precision would move a hand by half a millimetre from
frame to frame, which is as much as cloth does between two frames.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from physkin_core.avatar.body_model import load_body_model
from physkin_core.extras import install_command
from physkin_core.file_reading import ContentError, read_bytes, reading, shown
from physkin_core.motion.clip_files import CLIP_SUFFIXES, is_clip, load_clip
from physkin_core.motion.landmark_files import LANDMARK_SUFFIXES, has_landmarks, load_landmarks
from physkin_core.motion.motion import Motion, MotionError
from physkin_core.progress import Watch
from physkin_core.rig.bones_file import read_bones_file
from physkin_core.tensor_file import read_tensors

__all__ = ["MOTIONS_DIRECTORY", "bundled_motions", "load_motion", "save_motion"]

BAG_SUFFIXES = (".mcap", ".db3")
ARRAYS = ("positions", "root_orientation", "root_position")
MOTIONS_DIRECTORY = Path(__file__).parents[1] / "assets" / "motions"


def bundled_motions() -> tuple[str, ...]:
    """Names of the motions that are included, sorted.

    Examples:
        >>> physkin.bundled_motions()
        ('cartwheel', 'crawl', 'dance', 'jump', 'kick', 'run', 'walk')
    """
    return tuple(sorted(path.stem for path in MOTIONS_DIRECTORY.glob("*.safetensors")))


def load_motion(
    path_or_name: str | Path,
    *,
    bones: str | Path | None = None,
    source_rate_hz: float | None = None,
    watch: Watch = lambda share: None,
) -> Motion:
    """Read a motion.

    Args:
        path_or_name: the name of an included motion (`bundled_motions`); a clip of any human skeleton, which is
            retargeted to the default rig: .bvh, .amc, .vrma, SMPL's .npz, or .glb, .gltf, .vrm and .fbx, whose first
            clip is taken or, with `me.glb#Walk` or `me.glb#2`, another; landmarks, .csv, .json or .npz, as
            `load_landmarks` reads them; a bag with joint states, .mcap, .db3 or their folder; or a file that
            `save_motion` wrote.
        bones: which joint is which bone, a JSON file (docs/avatars.md#bones-file). None: `NAME.bones.json` beside
            `NAME.bvh`, if it exists.
        source_rate_hz: at which a clip was recorded, where its file has no rate or a wrong one. None: what it says.
        watch: called while a clip is retargeted, with the fraction done so far, 0 to 1.

    Returns:
        The motion.

    Raises:
        MotionError: for an unknown name, an unreadable file, missing arrays, wrong shapes or values that are not
            finite.

    Examples:
        >>> motion = physkin.load_motion("walk")
        >>> motion.rate_hz, motion.positions.shape
        (60.0, (77, 52))
    """
    path = Path(path_or_name)
    if has_landmarks(path):
        return load_landmarks(path, rate_hz=source_rate_hz)
    if is_clip(path):
        return load_clip(path, load_body_model().rig, bones=bones, source_rate_hz=source_rate_hz, watch=watch)[0]
    if source_rate_hz is not None:
        raise MotionError(
            f"source_rate_hz is for clips of {', '.join(CLIP_SUFFIXES)} and landmarks; {path} has its own times"
        )
    bundled = str(path_or_name) in bundled_motions()
    if path.suffix.lower() in BAG_SUFFIXES or (path / "metadata.yaml").is_file() or (path.is_dir() and not bundled):
        return _read_bag(path, bones)
    if bones is not None:
        raise MotionError(f"bones are for files of others; {path} has the rig's own names")
    if path.suffix != ".safetensors":
        if not bundled:
            allowed = ", ".join((".safetensors", *CLIP_SUFFIXES, *LANDMARK_SUFFIXES[:2], *BAG_SUFFIXES))
            raise MotionError(
                f"no bundled motion {str(path_or_name)!r}; there are {', '.join(bundled_motions())} "
                f"(a clip of your own: give the path of its file, {allowed}, or of a bag's folder)"
            )
        path = MOTIONS_DIRECTORY / f"{path_or_name}.safetensors"
    with reading(f"motion file {path}", MotionError):
        return _read(path)


def _read_bag(path: Path, bones: str | Path | None) -> Motion:
    try:
        from physkin_core.motion.bag_motion import load_bag_motion
    except ModuleNotFoundError as error:
        raise MotionError(f"cannot read bag {path}: {error}; bags need: {install_command('replay')}") from error
    motion, rig = load_bag_motion(path), load_body_model().rig
    with reading(f"bag {path}", MotionError):
        by_hand = read_bones_file(bones, path, rig.joint_names, motion.joint_names)
    renamed = {number: joint for joint, number in by_hand.items()}
    return replace(motion, joint_names=tuple(renamed.get(k, joint) for k, joint in enumerate(motion.joint_names)))


def _read(path: Path) -> Motion:
    metadata, tensors = read_tensors(read_bytes(path))
    missing = [key for key in ARRAYS if key not in tensors]
    missing += [f"metadata {key!r}" for key in ("joint_names", "rate_hz") if key not in metadata]
    if missing:
        raise ContentError(f"it lacks {', '.join(missing)}")
    joint_names, rate_hz = json.loads(metadata["joint_names"]), float(metadata["rate_hz"])
    if not isinstance(joint_names, list):
        raise ContentError(f"its joint_names are {shown(joint_names)}, expected a list of names")
    arrays = {key: tensors[key] for key in ARRAYS}
    return Motion(tuple(map(str, joint_names)), **arrays, rate_hz=rate_hz, name=metadata.get("name", path.stem))


def save_motion(motion: Motion, path: Path, *, notes: Mapping[str, str] | None = None) -> None:
    """Write a clip to `path` (.safetensors). notes: further metadata, such as source and licence."""
    from safetensors.numpy import save_file

    described = {"name": motion.name, "rate_hz": repr(motion.rate_hz), "joint_names": json.dumps(motion.joint_names)}
    tensors = {key: np.ascontiguousarray(getattr(motion, key)) for key in ARRAYS}
    save_file(tensors, path, metadata={**(notes or {}), **described})

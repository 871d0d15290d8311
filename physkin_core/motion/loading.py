"""Loading motion: a bundled clip, a clip file, motion capture, or a bag.

A clip is one safetensors file. It stays in single precision: half precision would move a hand by half a millimetre from
frame to frame, which is as much as cloth does between two frames.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from physkin_core.avatar.body_model import load_body_model
from physkin_core.extras import install_command
from physkin_core.file_reading import ContentError, read_bytes, reading, shown
from physkin_core.motion.landmark_files import load_landmarks
from physkin_core.motion.motion import Motion, MotionError
from physkin_core.progress import Watch
from physkin_core.tensor_file import read_tensors

__all__ = ["MOCAP_SUFFIXES", "MOTIONS_DIRECTORY", "bundled_motions", "load_motion", "save_motion"]

MOCAP_SUFFIXES = (".bvh", ".amc")
BAG_SUFFIXES = (".mcap", ".db3")
LANDMARK_SUFFIXES = (".csv", ".json", ".npz")
ARRAYS = ("positions", "root_orientation", "root_position")
MOTIONS_DIRECTORY = Path(__file__).parents[1] / "assets" / "motions"


def bundled_motions() -> tuple[str, ...]:
    """Names of the motions that are included, sorted.

    Examples:
        >>> physkin.bundled_motions()
        ('cartwheel', 'crawl', 'dance', 'jump', 'kick', 'run', 'walk')
    """
    return tuple(sorted(path.stem for path in MOTIONS_DIRECTORY.glob("*.safetensors")))


def load_motion(path_or_name: str | Path, *, watch: Watch = lambda share: None) -> Motion:
    """Read a motion.

    Args:
        path_or_name: the name of an included motion (`bundled_motions`); motion capture, .bvh or .amc, which is
            retargeted to the default rig; landmarks, .csv, .json or .npz, as `load_landmarks` reads them; a bag with
            joint states, .mcap, .db3 or a folder with `metadata.yaml`; or a file that `save_motion` wrote.
        watch: called while motion capture is read, with the fraction read so far, 0 to 1.

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
    if path.suffix.lower() in MOCAP_SUFFIXES:
        from physkin_core.motion.mocap import load_mocap

        return load_mocap(path, load_body_model().rig, watch=watch)[0]
    if path.suffix.lower() in BAG_SUFFIXES or (path / "metadata.yaml").is_file():
        return _read_bag(path)
    if path.suffix.lower() in LANDMARK_SUFFIXES:
        return load_landmarks(path)
    if path.suffix != ".safetensors":
        if str(path_or_name) not in bundled_motions():
            raise MotionError(
                f"no bundled motion {str(path_or_name)!r}; there are {', '.join(bundled_motions())} "
                "(a clip of your own: give the path of its .safetensors, .bvh, .amc, .csv, .json, .npz, .mcap or .db3 "
                "file, or of a bag's folder)"
            )
        path = MOTIONS_DIRECTORY / f"{path_or_name}.safetensors"
    with reading(f"motion file {path}", MotionError):
        return _read(path)


def _read_bag(path: Path) -> Motion:
    try:
        from physkin_core.motion.bag_motion import load_bag_motion
    except ModuleNotFoundError as error:
        raise MotionError(f"cannot read bag {path}: {error}; bags need: {install_command('replay')}") from error
    return load_bag_motion(path)


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

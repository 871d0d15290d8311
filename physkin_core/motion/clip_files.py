"""Files with a clip of any skeleton, by suffix; one of them as motion of the default rig."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from physkin_core.file_reading import reading
from physkin_core.motion.clip_retargeting import retarget_clip
from physkin_core.motion.mocap import read_mocap
from physkin_core.motion.motion import Motion, MotionError
from physkin_core.progress import Watch
from physkin_core.rig.rig import Rig

__all__ = ["load_clip"]


def load_clip(
    path: str | Path,
    rig: Rig,
    *,
    skeleton: str | Path | None = None,
    source_rate_hz: float | None = None,
    watch: Watch = lambda share: None,
) -> tuple[Motion, dict[str, float]]:
    """Read a .bvh or .amc file as motion of the default rig at 60 Hz, standing on the floor and facing X at first.

    rig: the default one. skeleton: the .asf of an .amc; None: `02.asf` for `02_02.amc`. source_rate_hz: instead of the
    file's own rate. watch: told the share done. Frames of a calibration pose before the motion are left out, with a
    warning. Also returns the mean angle [degrees] between a bone's direction and the source's, by rig bone.
    Raises MotionError: unreadable, malformed, or a limb that is not recognised.
    """
    path = Path(path)
    if source_rate_hz is not None and not 0 < source_rate_hz < np.inf:
        raise MotionError(f"source_rate_hz must be positive and finite, got {source_rate_hz}")
    with reading(f"motion capture file {path}", MotionError):
        clip = read_mocap(path, skeleton=skeleton, source_rate_hz=source_rate_hz)
        return retarget_clip(clip, rig, subject=str(path), name=path.stem, watch=watch)

"""Clips of landmarks, .csv, .json and .npz, as motion of the default rig.

Dimensions: `T` frames, `K` landmarks.
"""

from __future__ import annotations

import csv
import io
import logging
import zipfile
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np

from physkin_core.avatar.body_model import load_body_model
from physkin_core.file_reading import ContentError, listed, read_bytes, read_json, read_text, reading, shown
from physkin_core.formats.npz_file import read_npz
from physkin_core.motion.landmarks import LANDMARK_SETS, LandmarkReader
from physkin_core.motion.motion import MOST_FRAMES, Motion, MotionError

__all__ = ["LANDMARK_SUFFIXES", "has_landmarks", "load_landmarks"]

log = logging.getLogger(__name__)

LANDMARK_SUFFIXES = (".csv", ".json", ".npz")
LARGEST = 1 << 26  # [bytes] of a file, and of what it unpacks to
USUAL_HZ = 30.0  # where a file does not say
MOST_LANDMARKS = 1000  # a face's 478 among them
LONGEST_STEP, PAUSES = 1.0, 4  # [s] between frames; times as long as without pauses
LONGEST_GAP = 0.5  # [s] over which a lost landmark moves in a straight line
LEAST_CONFIDENCE = 0.3
CONFIDENCE = ("confidence", "visibility", "score", "likelihood")
TIMES = {"time": 1.0, "t": 1.0, "time_s": 1.0, "timestamp": 1.0, "time_ms": 1e-3, "timestamp_ms": 1e-3}
"""Column of times -> its unit [s]."""
STANDING = (("y z x", "y -z -x"), ("z x y", "-z x -y"), ("x y z", "x -y -z"))
"""Axes forward, left and up of clips whose trunks stand along x, y or z, upwards and downwards."""


def has_landmarks(path: Path) -> bool:
    """Whether a file is read as landmarks: by its suffix, and of an .npz by its `points`, which other motion lacks."""
    kind = path.suffix.lower()
    if kind != ".npz":
        return kind in LANDMARK_SUFFIXES
    try:
        with zipfile.ZipFile(io.BytesIO(read_bytes(path))) as archive:
            return "points.npy" in archive.namelist()
    except (OSError, ContentError, zipfile.BadZipFile):
        return False


def load_landmarks(
    path: str | Path,
    *,
    names: str | Sequence[str] | None = None,
    axes: str | None = None,
    renamed: Mapping[str, str] | None = None,
    rate_hz: float | None = None,
) -> Motion:
    """Read a clip of landmarks as motion of the default rig, standing on the floor.

    Args:
        path: .csv with columns such as `nose_x`, `nose_y`, `nose_z`, perhaps `nose_confidence` and `time` [s]; .json, a
            list of frames, or `frames` beside `names`, `rate_hz` and `axes`, each frame a list of points or points by
            name, or these as `points` beside its `time`; or .npz with `points` (T, K, 3), perhaps `names`,
            `confidence` (T, K), `times` (T,) [s] or `rate_hz`, and `axes`.
        names, axes, renamed: as of `LandmarkReader`, in place of the file's. Where neither tracker nor axes are named,
            the axis is up along which most trunks stand.
        rate_hz: frames a second, in place of the file's.

    Returns:
        The motion. Gaps of up to half a second are bridged in a straight line.

    Raises:
        MotionError: for a file that cannot be read, is too large, or lacks landmarks, depth or names.

    Examples:
        >>> names = ["left_shoulder", "right_shoulder", "left_hip", "right_hip"]
        >>> frame = [[0.0, 0.2, 1.4], [0.0, -0.2, 1.4], [0.0, 0.1, 0.9], [0.0, -0.1, 0.9]]
        >>> np.savez("stands.npz", points=[frame] * 10, names=names, rate_hz=30.0)
        >>> physkin.load_landmarks("stands.npz").frame_count
        10
    """
    from physkin_core.motion.retargeting import on_floor

    path = Path(path)
    with reading(f"landmarks {path}", MotionError):
        read = {".csv": _csv, ".json": _json, ".npz": _npz}.get(path.suffix.lower())
        if read is None:
            raise ContentError("expected .csv, .json or .npz")
        clip = read(path)
        points = np.asarray(clip["points"], dtype=np.float64)
        _check_count(points.shape[1] if points.ndim > 1 else 0)
        if points.ndim != 3 or points.shape[2] not in (3, 4) or not 0 < len(points) <= MOST_FRAMES:
            raise ContentError(
                f"its points have shape {points.shape}; expected (T, K, 3), or 4 with confidence; where depth is "
                "missing, take world landmarks, or lift them"
            )
        confidence = points[:, :, 3] if points.shape[2] == 4 else clip.get("confidence", np.ones(points.shape[:2]))
        if np.shape(confidence) != points.shape[:2]:
            raise ContentError(f"its confidence has shape {np.shape(confidence)}; expected {points.shape[:2]}")
        points = np.where((np.asarray(confidence) < LEAST_CONFIDENCE)[..., None], np.nan, points[:, :, :3])
        names = clip.get("names") if names is None else names
        guessed = ""
        if names is None:
            sets = [each for each, known in LANDMARK_SETS.items() if len(known["names"].split()) == points.shape[1]]
            if len(sets) != 1:
                raise ContentError(f"{points.shape[1]} points need names, such as {' or '.join(sets or LANDMARK_SETS)}")
            names = guessed = sets[0]
        axes = axes or clip.get("axes")
        seen = points[np.isfinite(points).all(axis=2)]
        if len(seen) and 0 < seen[:, :2].min() < seen[:, :2].max() < 1 and seen[:, 2].min() < 0:
            log.warning("%s: x and y from 0 to 1 are those of a picture: take world landmarks, or undo its shape", path)
        try:
            reader = LandmarkReader(names, axes=axes or LANDMARK_SETS.get(guessed, {}).get("axes"), renamed=renamed)
            stands, mirrored = reader.facing(points)
            way = np.abs(stands).argmax()
            if axes is None and guessed and (way == 0 or stands[way] < 0):  # who is on the side may lie
                names = LANDMARK_SETS[guessed]["names"].split()
                return load_landmarks(path, names=names, renamed=renamed, rate_hz=rate_hz)
            if axes is None and not isinstance(names, str):
                reader = LandmarkReader(names, axes=STANDING[way][int(stands[way] < 0)], renamed=renamed)
        except MotionError as error:
            raise ContentError(str(error)) from error
        if mirrored:
            raise ContentError("noses point backwards: left and right are exchanged, or axes are mirrored; give axes")
        times = _times(clip, len(points), rate_hz)
        step = float(np.median(np.diff(times))) if len(times) > 1 else 1 / USUAL_HZ
        even = np.arange(times[0], times[-1] + step / 2, step)
        frames = [(*reader.read(each, time_s=t), reader.status) for each, t in zip(_bridged(points, times, even), even)]
        positions, roots, status = (np.array(part) for part in zip(*frames))
        if (status == "lost").all():
            raise ContentError("no frame shows both shoulders or both hips, and a limb")
        joints = load_body_model().rig.joint_names
        return on_floor(Motion(joints, positions, roots[:, 3:], roots[:, :3], 1 / step, path.stem))


def _times(clip: Mapping[str, Any], count: int, rate_hz: float | None) -> np.ndarray:
    """(T,) [s] of frames."""
    if rate_hz is not None and not 0 < rate_hz < np.inf:
        raise ContentError(f"rate_hz must be positive and finite, got {rate_hz}")
    rate_hz = rate_hz or clip.get("rate_hz")
    if not rate_hz and clip.get("times") is None:
        log.warning("landmarks do not say their rate: %g frames a second are assumed", USUAL_HZ)
        rate_hz = USUAL_HZ
    times = np.arange(count) / float(rate_hz) if rate_hz else np.asarray(clip["times"], dtype=np.float64)
    steps = np.diff(times)
    if times.shape != (count,) or not (np.isfinite(times).all() and (steps > 0).all()):
        raise ContentError(f"its times {shown(times[:3].tolist())} … are not {count} that rise")
    if count > 1 and (np.median(steps) > LONGEST_STEP or steps.mean() > PAUSES * np.median(steps)):
        raise ContentError(
            f"its {count} frames are {np.median(steps):.3g} s apart and span {steps.sum():.3g} s; allowed are steps of "
            f"{LONGEST_STEP:g} s, and {PAUSES} times the frames' own; give rate_hz, or cut pauses out"
        )
    return times


def _bridged(points: np.ndarray, times: np.ndarray, even: np.ndarray) -> np.ndarray:
    """Points (T, K, 3) at other times, NaN in long gaps."""
    moved = np.full((len(even), *points.shape[1:]), np.nan)
    for k in range(points.shape[1]):
        good = np.isfinite(points[:, k]).all(axis=1) & points[:, k].any(axis=1)
        if not good.any():
            continue
        known = times[good]
        after = np.searchsorted(known, even).clip(max=len(known) - 1)
        before = (np.searchsorted(known, even, side="right") - 1).clip(min=0)
        near = (known[after] - known[before] <= LONGEST_GAP) & (np.abs(even - even.clip(known[0], known[-1])) < 1e-6)
        for axis in range(3):
            moved[near, k, axis] = np.interp(even[near], known, points[good, k, axis])
    return moved


def _check_count(count: int) -> None:
    if count > MOST_LANDMARKS:
        raise ContentError(f"it has {count} landmarks, allowed are {MOST_LANDMARKS}")


def _csv(path: Path) -> dict[str, Any]:
    lines = [line for line in read_text(path, most=LARGEST).split("\n") if line.strip()] or [""]
    delimiter = max(",;\t", key=lines[0].count)
    titles, *rows = csv.reader(lines, delimiter=delimiter, skipinitialspace=True)
    titles = [title.strip() for title in titles] or [""]
    column = {title.lower(): number for number, title in enumerate(titles)}
    names = [title[:-2] for title in titles if title[-2:].lower() in ("_x", ".x", " x")]
    starts = [title[:-1].lower() for title in titles if title[-2:].lower() in ("_x", ".x", " x")]
    if lacking := [name for name, start in zip(names, starts) if not {f"{start}y", f"{start}z"} <= column.keys()]:
        raise ContentError(f"{listed(lacking)} lack columns for y and z")
    if not names or not rows:
        raise ContentError(f"it has columns {listed(titles)}; expected nose_x, nose_y, nose_z, and so on, and rows")
    for number, row in enumerate(rows, start=2):
        if len(row) != len(titles):
            raise ContentError(f"row {number} has {len(row)} values, its header {len(titles)}")
    table = np.array([[_number(cell) for cell in row] for row in rows])
    trusted = ((column[start + word] for word in CONFIDENCE if start + word in column) for start in starts)
    confidence = [np.ones(len(rows)) if k is None else table[:, k] for k in (next(each, None) for each in trusted)]
    points = np.stack([table[:, [column[start + axis] for axis in "xyz"]] for start in starts], axis=1)
    clip = {"names": names, "points": points, "confidence": np.stack(confidence, axis=1)}
    if title := next((title for title in TIMES if title in column), None):
        clip["times"] = table[:, column[title]] * TIMES[title]
    return clip


def _number(cell: str) -> float:
    """NaN for what is none, as for a lost point."""
    with suppress(ValueError):
        return float(cell.replace(",", "."))
    return np.nan


def _json(path: Path) -> dict[str, Any]:
    content = read_json(read_bytes(path, most=LARGEST))
    clip: dict[str, Any] = dict(content) if isinstance(content, dict) else {"frames": content}
    if not isinstance(clip.get("frames"), list) or not clip["frames"]:
        raise ContentError("it has no list of frames")
    frames = [each if isinstance(each, dict) and "points" in each else {"points": each} for each in clip["frames"]]
    if all("time" in frame for frame in frames):
        clip["times"] = [float(frame["time"]) for frame in frames]
    points: list[Any] = [frame["points"] or [] for frame in frames]  # none where nobody is seen
    if all(isinstance(each, dict) for each in points if each):
        clip["names"] = list(dict.fromkeys(name for each in points for name in each)) or clip.get("names")
        _check_count(len(clip["names"] or ()))
        points = [[each.get(name) for name in clip["names"]] if each else [] for each in points]
    count = max(map(len, points))
    if any(len(frame) not in (0, count) for frame in points):
        raise ContentError("its frames have different numbers of points; write null for one that is lost")
    clip["points"] = [[_point(point) for point in frame or [None] * count] for frame in points]
    return clip


def _point(value: Any) -> list[float]:
    """x, y, z and confidence, of a list, an object, or nothing."""
    if isinstance(value, dict):
        value = [*(value.get(axis) for axis in "xyz"), next((value[key] for key in CONFIDENCE if key in value), 1.0)]
    if value is None:
        value = [None] * 3
    if not isinstance(value, list) or len(value) not in (3, 4):
        raise ContentError(f"a point is {shown(value)}; expected x, y, z, and perhaps a confidence")
    return [np.nan if each is None else float(each) for each in (*value, 1.0)[:4]]


def _npz(path: Path) -> dict[str, Any]:
    clip: dict[str, Any] = read_npz(path, most=LARGEST)
    if "points" not in clip:
        raise ContentError(f"it has no array `points`, but {listed(list(clip))}")
    return clip | {name: np.squeeze(clip[name]).tolist() for name in ("names", "rate_hz", "axes") if name in clip}

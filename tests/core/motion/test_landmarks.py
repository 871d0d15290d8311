"""Landmarks to joint positions: our own body's landmarks give back its pose, with noise, gaps, and half of a body."""

import itertools
import json
import os

import numpy as np
import pytest
from posed_landmarks import (
    CAMERA,
    NAMES,
    RATE_HZ,
    SEGMENTS,
    angles_between,
    clip_of,
    in_order,
    landmarks_of,
    medians,
    read_all,
)

import physkin_core as physkin
from physkin_core import cli
from physkin_core.motion.everyday_poses import everyday_poses
from physkin_core.motion.landmarks import LANDMARK_SETS, USED
from physkin_core.motion.motion import MotionError, upright_orientation

NOISE = 0.02  # [m]
WORLD = np.array([0.3, -0.2, 0.0, 0.0, 0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def rig():
    return physkin.load_body_model().rig


def everyday(rig):
    """Landmarks of everyday poses, each far from the one before in time."""
    positions, gravity = everyday_poses(rig)
    root = np.concatenate([np.tile([0, 0, 0.914], (len(gravity), 1)), upright_orientation(gravity)], axis=1)
    return landmarks_of(rig, positions.astype(np.float64), root)


def test_poses_come_back(rig):
    """Without noise and lag, upper arms, legs and feet are where they were, as the rig can hold the pose. Forearms
    are off where they need a twist that the rig's limits do not leave to the upper arm."""
    truth = everyday(rig)
    read = read_all(physkin.LandmarkReader(USED), truth, rate_hz=0.01)
    found = medians(rig, read, truth)
    assert max(found[each] for each in ("upper arm", "thigh", "shin", "foot")) < 1
    assert found["forearm"] < 5


@pytest.mark.parametrize("name", ["walk", "dance", "kick", "crawl"])
def test_clips_without_noise(rig, name):
    """Within 5 degrees: what is left is the filter's lag."""
    *_, truth = clip_of(rig, name)
    found = medians(rig, read_all(physkin.LandmarkReader(USED), truth), truth)
    assert max(found.values()) < 5, found


@pytest.mark.parametrize("name", ["walk", "dance", "kick", "crawl"])
def test_clips_with_noise(rig, name):
    """2 cm turn a forearm of 24 cm by 6 degrees in the median; smoothed, and with lag, limbs are within 10."""
    *_, truth = clip_of(rig, name)
    noisy = truth + np.random.default_rng(3).normal(0, NOISE, truth.shape)
    found = medians(rig, read_all(physkin.LandmarkReader(USED), noisy), truth)
    assert max(found.values()) < 10, found


def test_someone_who_stands_does_not_shake(rig, monkeypatch):
    """Noise in a still pose: joint positions jitter by less than a third of what they do unfiltered. A filter of 0.7 Hz
    at 30 frames a second lets through an eighth of a frame's change; speed that noise feigns opens it further."""
    *_, truth = clip_of(rig, "walk")
    still = np.repeat(truth[:1], 90, axis=0) + np.random.default_rng(0).normal(0, NOISE, (90, *truth.shape[1:]))

    def jitter():
        positions, _ = read_all(physkin.LandmarkReader(USED), still)
        return np.sqrt((np.diff(positions[15:], 2, axis=0) ** 2).mean())

    smooth = jitter()
    monkeypatch.setattr("physkin_core.motion.landmarks.SLOWEST_HZ", 1e6)
    assert smooth < jitter() / 3


def test_bursts_of_lost_landmarks(rig):
    """A fifth of the landmarks is lost, 5 to 15 frames at a time: nothing is ever NaN, and limbs are within 15
    degrees in the median. A foot is held where any of four landmarks is lost: it is not asked for."""
    rng = np.random.default_rng(5)
    for name in ("walk", "dance"):
        *_, truth = clip_of(rig, name)
        points = truth + rng.normal(0, NOISE, truth.shape)
        for landmark in range(points.shape[1]):
            for start in np.flatnonzero(rng.random(len(points)) < 0.022):
                points[start : start + rng.integers(5, 16), landmark] = np.nan
        reader = physkin.LandmarkReader(USED)
        positions, roots = read_all(reader, points)
        assert np.isfinite(positions).all() and np.isfinite(roots).all()
        found = medians(rig, (positions, roots), truth)
        assert max(found[each] for each in SEGMENTS if each != "foot") < 15, found


@pytest.mark.parametrize("tracker", LANDMARK_SETS)
def test_trackers(rig, tracker):
    """Each tracker's names and axes: the same pose, but for feet and head where it has none. In millimetres, too."""
    truth = everyday(rig)
    names = LANDMARK_SETS[tracker]["names"].split()
    axes = {"kinect_v2": np.array([[0.0, -1, 0], [0, 0, 1], [-1, 0, 0]])}.get(tracker, CAMERA)
    points = 1000 * in_order(truth, names) @ axes.T
    read = read_all(physkin.LandmarkReader(tracker), points, rate_hz=0.01)
    found = medians(rig, read, truth)
    assert max(found[each] for each in ("upper arm", "thigh", "shin")) < 1
    if tracker != "coco":
        assert found["foot"] < 1


def test_coco_keeps_feet_at_rest(rig):
    points = in_order(everyday(rig), LANDMARK_SETS["coco"]["names"].split()) @ CAMERA.T
    reader = physkin.LandmarkReader("coco")
    positions, _ = read_all(reader, points, rate_hz=0.01)
    feet = [rig.joint_indices[f"foot.{side}_{axis}"] for side in "LR" for axis in "yz"]
    assert (positions[:, feet] == rig.rest[feet]).all()
    assert reader.status == "seen"


def test_names_of_ones_own(rig):
    """A list with a map; confidence says what is lost as NaN does."""
    names = [f"marker {row}" for row in range(len(USED))]
    truth = everyday(rig)
    reader = physkin.LandmarkReader(names, renamed=dict(zip(names, USED)))
    expected = physkin.LandmarkReader(USED).read(truth[3], time_s=0.0)
    np.testing.assert_array_equal(reader.read(truth[3], time_s=0.0)[0], expected[0])
    sure = np.ones(len(names))
    sure[USED.index("wrist.L")] = 0.1
    reader.reset()
    reader.read(truth[3], sure, time_s=0.0)
    assert (reader.status, reader.lost) == ("part", ("left arm",))


def test_hips_at_the_origin_stand_on_the_floor(rig):
    """World landmarks of MediaPipe start at the hips: the lowest foot stands on Z = 0. Landmarks that have a place keep
    it, and a jump is seen."""
    *_, truth = clip_of(rig, "walk")
    hips = truth[:, 7:9].mean(axis=1, keepdims=True)
    points = in_order(truth - hips, NAMES) @ CAMERA.T
    _, roots = read_all(physkin.LandmarkReader(), points)
    assert np.abs(roots[:, :2]).max() == 0
    assert (np.abs(roots[:, 2] - 0.9) < 0.05).all()
    _, roots = read_all(physkin.LandmarkReader(USED), truth)
    assert np.linalg.norm(roots[-1, :2] - hips[-1, 0, :2]) < 0.1
    jump = np.repeat(truth[:1], 40, axis=0)
    jump[20:26] += [0, 0, 0.3]
    _, roots = read_all(physkin.LandmarkReader(USED), jump)
    assert roots[25, 2] - roots[10, 2] > 0.15
    assert abs(roots[39, 2] - roots[10, 2]) < 0.05


def test_half_a_body(rig):
    """Only head, arms and shoulders: legs and hips hang at rest below, arms follow, also while the person turns."""
    truth = everyday(rig)[:1]
    upper = np.repeat(truth, 90, axis=0)
    reader = physkin.LandmarkReader(USED)
    for part in ("hip", "knee", "ankle", "heel", "toe"):
        for side in "LR":
            upper[:, USED.index(f"{part}.{side}")] = np.nan
    positions, roots = read_all(reader, upper)
    assert (reader.status, reader.lost) == ("part", ("left leg", "right leg", "hips"))
    legs = [rig.joint_indices[f"{joint}.{side}_y"] for joint in ("upperleg01", "lowerleg01") for side in "LR"]
    np.testing.assert_allclose(positions[:, legs], np.tile(rig.rest[legs], (90, 1)), atol=1e-9)
    arms = angles_between(landmarks_of(rig, positions[-1:], roots[-1:]), truth, {"": SEGMENTS["upper arm"]})[""]
    assert arms.max() < 10
    quarter = upper @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # to the left
    for frame, points in enumerate(quarter, start=90):
        _, root = reader.read(points, time_s=frame / RATE_HZ)
    turned = 2 * np.degrees(np.arctan2(root[5], root[6]) - np.arctan2(roots[-1, 5], roots[-1, 6]))
    assert abs(turned - 90) < 15


def test_a_lost_person_comes_to_rest(rig):
    """Held for a second, then eased, without a jump, to the rest pose, upright and looking where it looked."""
    truth = everyday(rig)
    reader = physkin.LandmarkReader(USED)
    points = np.concatenate([np.repeat(truth[-1:], 30, axis=0), np.full((600, *truth.shape[1:]), np.nan)])
    positions, roots = read_all(reader, points)
    assert reader.status == "lost"
    np.testing.assert_array_equal(positions[45], positions[32])
    np.testing.assert_allclose(positions[-1], rig.rest, atol=1e-3)
    np.testing.assert_allclose(roots[-1, 3:5], 0, atol=1e-3)
    assert np.abs(np.diff(positions[30:], axis=0)).max() < 0.05
    nothing = physkin.LandmarkReader()
    np.testing.assert_allclose(nothing.read(np.zeros((33, 3)), time_s=5.0)[0], rig.rest, atol=1e-12)
    assert nothing.status == "lost"


def test_nothing_breaks_it(rig):
    """Points that are all one, in a line, huge, or random never give NaN or a pose beyond the rig's limits."""
    rng = np.random.default_rng(1)
    reader = physkin.LandmarkReader(USED)
    lower, upper = rig.lower - 1e-9, rig.upper + 1e-9
    line = np.linspace(0, 1, len(USED))[:, None] * [0.0, 0.0, 1.0]
    kinds = [np.ones((21, 3)), line, 1e300 * np.ones((21, 3)), *rng.normal(size=(60, 21, 3))]
    for time, points in enumerate(kinds * 2):
        points = np.where(rng.random((21, 1)) < 0.2, np.inf, points)
        positions, root = reader.read(points, time_s=float(rng.normal(time / 30, 0.05)))
        assert ((positions >= lower) & (positions <= upper)).all()
        assert np.isfinite(root).all() and abs(np.linalg.norm(root[3:]) - 1) < 1e-6


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"names": "mediapip"}, "no tracker 'mediapip'; there are mediapipe, coco"),
        ({"names": ["nose", "left_shoulder"]}, "no landmark for shoulder.R, hip.L, hip.R among 'nose'"),
        ({"axes": "x y"}, "axes are 'x y'; expected"),
        ({"axes": "x y y"}, "axes are 'x y y'; expected"),
    ],
)
def test_refused_readers(arguments, said):
    with pytest.raises(MotionError, match=said):
        physkin.LandmarkReader(**arguments)


@pytest.mark.parametrize(
    ("points", "confidence", "time_s", "said"),
    [
        (np.zeros((33, 2)), None, 0.0, "these lack depth: take world landmarks"),
        (np.zeros((17, 3)), None, 0.0, r"expected \(33, 3\)"),
        (np.zeros((33, 3)), np.zeros(3), 0.0, r"confidence \(3,\)"),
        (np.zeros((33, 3)), None, np.nan, "nan s"),
    ],
)
def test_refused_frames(points, confidence, time_s, said):
    with pytest.raises(MotionError, match=said):
        physkin.LandmarkReader().read(points, confidence, time_s=time_s)


# --- Files ---


@pytest.fixture(scope="module")
def walk(rig):
    """Landmarks of `walk`, as MediaPipe lists them, without a place."""
    *_, truth = clip_of(rig, "walk")
    return truth, in_order(truth - truth[:, 7:9].mean(axis=1, keepdims=True), NAMES) @ CAMERA.T


def written(folder, kind, points):
    """A clip's file, as scripts around MediaPipe write it."""
    times = np.arange(len(points)) / RATE_HZ
    known = np.flatnonzero(np.isfinite(points).all(axis=(0, 2)))
    path = folder / f"clip.{kind.partition(' ')[0]}"
    if kind.startswith("csv"):
        sign = ";" if "semicolons" in kind else ","
        titles = [f"{NAMES[k]}_{what}" for k in known for what in ("x", "y", "z", "visibility")]
        lines = [sign.join(["timestamp_ms", *titles])]
        for time, frame in zip(times, points):
            cells = [f"{1000 * time:.3f}", *(f"{value:.5f}" for k in known for value in (*frame[k], 0.99))]
            lines.append(sign.join(cells).replace(".", "," if sign == ";" else "."))
        path.write_text("\ufeff" + "\r\n".join(lines) + "\r\n", encoding="utf-8")
    elif kind.startswith("npz"):
        np.savez(
            path, points=points, names=NAMES, rate_hz=RATE_HZ, axes="-z x -y", confidence=np.ones(points.shape[:2])
        )
    elif kind == "json of MediaPipe":  # its own lists of objects
        keys = ("x", "y", "z", "visibility")
        frames = [[dict(zip(keys, (*point, 1.0))) for point in frame] for frame in np.nan_to_num(points)]
        path.write_text(json.dumps(frames))
    else:
        frames = [
            {"time": time, "points": {NAMES[k]: frame[k].tolist() for k in known}} for time, frame in zip(times, points)
        ]
        path.write_text(json.dumps({"axes": "-z x -y", "frames": frames}))
    return path


@pytest.mark.parametrize("kind", ["csv", "csv with semicolons", "npz", "json", "json of MediaPipe"])
def test_files(rig, tmp_path, walk, kind):
    """Limbs are where they were; the clip has its rate and its length."""
    truth, points = walk
    path = written(tmp_path, kind, points)
    motion = physkin.load_motion(path)
    assert motion.frame_count == len(points) and motion.rate_hz == pytest.approx(RATE_HZ, rel=1e-3)
    assert motion.name == "clip"
    read = motion.positions_for(rig), motion.root.astype(np.float64)
    assert max(medians(rig, read, truth).values()) < 5


def test_gaps_of_a_clip_are_bridged(rig, tmp_path, walk):
    """A third of a second without an arm, and without a frame: in a clip both ends are known."""
    truth, points = walk
    points = points.copy()
    points[8:18, [NAMES.index("left_elbow"), NAMES.index("left_wrist")]] = np.nan
    kept = np.delete(np.arange(len(points)), range(25, 30))
    np.savez(tmp_path / "gap.npz", points=points[kept], times=kept / RATE_HZ)
    motion = physkin.load_motion(tmp_path / "gap.npz")
    assert motion.frame_count == len(points)
    found = angles_between(landmarks_of(rig, motion.positions_for(rig), motion.root.astype(float)), truth)
    assert max(found["forearm"].max(), found["upper arm"].max()) < 15


@pytest.mark.parametrize("nobody", [None, [], {}])
def test_frames_without_anybody(tmp_path, walk, nobody):
    """As trackers write them, until somebody comes: those are lost points."""
    _, points = walk
    frames = [nobody, nobody, *points.tolist()]
    (tmp_path / "a.json").write_text(json.dumps({"rate_hz": 30, "frames": frames}))
    named = [nobody, nobody, *({name: point for name, point in zip(NAMES, frame)} for frame in points.tolist())]
    (tmp_path / "b.json").write_text(json.dumps({"rate_hz": 30, "axes": "-z x -y", "frames": named}))
    listed, by_name = (physkin.load_motion(tmp_path / f"{name}.json") for name in "ab")
    assert listed.frame_count == len(points) + 2
    np.testing.assert_array_equal(by_name.positions, listed.positions)


def test_confidence_is_for_each_point_of_each_frame(tmp_path, walk):
    """One of another shape would be taken for that of other points, where there are as many frames as points."""
    _, points = walk
    np.savez(tmp_path / "a.npz", points=points[: len(NAMES)], confidence=np.ones(len(NAMES)), rate_hz=[30.0])
    with pytest.raises(MotionError, match=r"confidence has shape \(33,\); expected \(33, 33\)"):
        physkin.load_motion(tmp_path / "a.npz")


def test_text_of_spreadsheets(rig, tmp_path, walk):
    """In UTF-16, as Excel writes it, with titles in quotes."""
    truth, points = walk
    path = written(tmp_path, "csv", points)
    plain, (head, *rows) = physkin.load_motion(path), path.read_text("utf-8-sig").splitlines()
    path.write_text("\n".join([",".join(f'"{title}"' for title in head.split(",")), *rows]), encoding="utf-16")
    np.testing.assert_array_equal(physkin.load_motion(path).positions, plain.positions)


@pytest.mark.timeout(20)
def test_a_pipe_is_no_landmarks(tmp_path):
    """It is not waited for."""
    os.mkfifo(tmp_path / "a.npz")
    with pytest.raises(MotionError, match="not a regular file"):
        physkin.load_motion(tmp_path / "a.npz")


def test_mirrored_clips_are_refused(tmp_path, walk):
    """Left and right exchanged, or an axis turned round, would be worn as a body that bends the wrong way."""
    _, points = walk
    np.savez(tmp_path / "mirrored.npz", points=points * [-1, 1, 1])
    with pytest.raises(MotionError, match=r"mirrored\.npz: noses point backwards"):
        physkin.load_motion(tmp_path / "mirrored.npz")
    physkin.load_landmarks(tmp_path / "mirrored.npz", axes="-z -x -y")


@pytest.mark.parametrize("axes", list(itertools.permutations(range(3))))
@pytest.mark.parametrize("sign", [1, -1])
def test_the_axis_that_is_up_is_found(rig, tmp_path, walk, axes, sign):
    """Of named points in any right-handed axes: the same joint positions, and as upright."""
    truth, _ = walk
    turn = np.zeros((3, 3))
    turn[range(3), axes] = 1.0
    turn[0] *= sign
    turn[1] *= np.linalg.det(turn)
    expected, read = (tmp_path / f"{name}.npz" for name in ("expected", "read"))
    np.savez(expected, points=truth, names=USED, rate_hz=RATE_HZ)
    np.savez(read, points=truth @ turn.T, names=USED, rate_hz=RATE_HZ)
    expected, read = physkin.load_motion(expected), physkin.load_motion(read)
    np.testing.assert_allclose(read.positions, expected.positions, atol=1e-5)
    np.testing.assert_allclose(read.gravity, expected.gravity, atol=1e-5)


@pytest.mark.parametrize("axes", ["z x y", "x y z"])
def test_points_without_names_in_other_axes(rig, tmp_path, walk, axes):
    """A tracker is guessed of their number, but not its axes where nobody stands in these."""
    truth, points = walk
    plain, read = tmp_path / "plain.npz", tmp_path / "read.npz"
    np.savez(plain, points=points, rate_hz=RATE_HZ)
    ours = points @ CAMERA
    np.savez(read, points=ours if axes == "x y z" else ours[:, :, [1, 2, 0]], rate_hz=RATE_HZ)
    plain, read = physkin.load_motion(plain), physkin.load_motion(read)
    np.testing.assert_allclose(read.positions, plain.positions, atol=1e-4)
    np.testing.assert_allclose(read.gravity, plain.gravity, atol=1e-4)


def test_points_of_a_picture_are_told(tmp_path, walk, caplog):
    """Shares of its width and height, which differ: shapes are wrong, and nothing else says so."""
    _, points = walk
    np.savez(tmp_path / "a.npz", points=points / [3.2, 1.8, 3.2] * 0.9 + [0.5, 0.5, 0], rate_hz=RATE_HZ)
    physkin.load_motion(tmp_path / "a.npz")
    assert "a.npz: x and y from 0 to 1 are those of a picture" in caplog.text
    caplog.clear()
    np.savez(tmp_path / "b.npz", points=points, rate_hz=RATE_HZ)
    physkin.load_motion(tmp_path / "b.npz")
    assert caplog.text == ""


NOTHING = [[0.0, 1.0, 2.0]]


@pytest.mark.parametrize(
    ("name", "content", "said"),
    [
        ("a.csv", "time,nose_x,nose_y\n0,1,2\n1,2,3\n", "'nose' lack columns for y and z"),
        ("b.csv", "what,ever\n1,2\n", "columns 'what', 'ever'; expected nose_x"),
        ("c.csv", "a_x,a_y,a_z\n1,2\n", "row 2 has 2 values, its header 3"),
        ("d.csv", "a_x,a_y,a_z\n1,2,3\n", "no landmark for shoulder.L"),
        ("e.csv", "", "it has columns ''; expected nose_x"),
        ("a.json", "{", "is not JSON"),
        ("b.json", "{}", "has no list of frames"),
        ("c.json", json.dumps([[[0, 1]] * 33]), r"a point is \[0, 1\]; expected x, y, z"),
        ("d.json", json.dumps([NOTHING * 25]), "25 points need names, such as body_25 or kinect_v2"),
        ("e.json", json.dumps([NOTHING * 33, NOTHING]), "different numbers of points"),
        (
            "f.json",
            json.dumps([{"time": 5 * t, "points": NOTHING * 33} for t in range(3)]),
            "its 3 frames are 5 s apart",
        ),
        ("g.json", json.dumps({"rate_hz": -3, "frames": [NOTHING * 33] * 3}), "are not 3 that rise"),
        (
            "h.json",
            json.dumps({"names": "coco", "frames": [NOTHING * 33] * 3}),
            r"expected \(T, 17, 3\), one for each name",
        ),
        ("i.json", json.dumps([[[None] * 3] * 33] * 3), "no frame shows both shoulders"),
        ("j.json", json.dumps([{"time": t, "points": NOTHING * 33} for t in (0, 0.1, 0.2, 9)]), "cut pauses out"),
        ("k.json", json.dumps([{str(1000 * t + k): None for k in range(20)} for t in range(60)]), "1200 landmarks"),
        ("l.json", json.dumps({"frames": [NOTHING * 2000]}), "it has 2000 landmarks, allowed are 1000"),
        ("a.npz", "no archive", "malformed"),
        ("a.txt", "", "expected .csv, .json or .npz"),
    ],
)
def test_refused_files(tmp_path, name, content, said):
    """One sentence that names the file."""
    (tmp_path / name).write_text(content)
    with pytest.raises(MotionError, match=said) as refused:
        physkin.load_landmarks(tmp_path / name)
    assert f"{name}" in str(refused.value) and len(str(refused.value)) <= 300


@pytest.mark.parametrize("rate_hz", [0.0, -30.0, np.inf, np.nan])
def test_refused_rates(tmp_path, walk, rate_hz):
    """None is replaced by the file's without a word."""
    np.savez(tmp_path / "a.npz", points=walk[1], rate_hz=RATE_HZ)
    with pytest.raises(MotionError, match="rate_hz must be positive and finite"):
        physkin.load_motion(tmp_path / "a.npz", source_rate_hz=rate_hz)


def test_refused_archives(tmp_path, monkeypatch):
    np.savez(tmp_path / "other.npz", trans=np.zeros(3))
    with pytest.raises(MotionError, match="it has no array `points`, but 'trans'"):
        physkin.load_landmarks(tmp_path / "other.npz")
    with pytest.raises(MotionError, match="it has 'trans'; a clip has poses.* landmarks are points"):
        physkin.load_motion(tmp_path / "other.npz")
    np.savez_compressed(tmp_path / "large.npz", points=np.zeros((500, 33, 3)))
    monkeypatch.setattr("physkin_core.motion.landmark_files.LARGEST", 300_000)
    with pytest.raises(MotionError, match="it has .* bytes when unpacked, allowed are 300000"):
        physkin.load_motion(tmp_path / "large.npz")


def test_landmarks_are_converted(tmp_path, walk):
    """An .npz with them is no clip of a skeleton for any command."""
    _, points = walk
    np.savez(tmp_path / "a.npz", points=points, rate_hz=RATE_HZ)
    assert cli.main(["convert", str(tmp_path / "a.npz"), str(tmp_path / "bag")]) == 0
    assert physkin.load_motion(tmp_path / "bag").frame_count == len(points)

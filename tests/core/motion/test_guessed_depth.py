"""Landmarks of MediaPipe, which guesses depth from one picture: tilted cameras, forearms that are too short."""

import numpy as np
import pytest
from posed_landmarks import CAMERA, NAMES, angles_between, clip_of, in_order, landmarks_of, medians, read_all

import physkin_core as physkin


@pytest.fixture(scope="module")
def rig():
    return physkin.load_body_model().rig


@pytest.mark.parametrize("pitch", [-25, 0, 25])
def test_tilted_cameras(rig, pitch):
    """Who walks is upright before a camera that looks up or down, as MediaPipe does not say what is upright: within 5
    degrees, as walkers lean by 2. So it is for landmarks without a place alone: others say it."""
    positions, root, truth = clip_of(rig, "walk")
    hips = truth[:, 7:9].mean(axis=1, keepdims=True)
    sine, cosine = np.sin(np.radians(pitch)), np.cos(np.radians(pitch))
    tilted = np.array([[cosine, 0, sine], [0, 1, 0], [-sine, 0, cosine]])
    points = in_order(truth - hips, NAMES) @ tilted.T @ CAMERA.T
    found = medians(rig, read_all(physkin.LandmarkReader(), points), truth)
    assert max(found.values()) < 5, found
    placed = in_order(truth, NAMES) @ tilted.T @ CAMERA.T
    for reader, given in ((physkin.LandmarkReader(axes="-z x -y"), points), (physkin.LandmarkReader(), placed)):
        found = medians(rig, read_all(reader, given), truth @ tilted.T)
        assert max(found.values()) < 5, found


def test_who_does_not_stand_shows_no_tilt(rig):
    """Who sits, upright or leaning, is read as by a camera that is level."""
    positions = np.tile(rig.rest, (60, 1))
    for side in "LR":
        positions[:, rig.joint_indices[f"upperleg01.{side}_y"]] -= np.pi / 2
        positions[:, rig.joint_indices[f"lowerleg01.{side}_y"]] += np.pi / 2
    for lean in (-0.4, 0.0, 0.4):
        root = np.tile([0, 0, 0, 0, np.sin(lean / 2), 0, np.cos(lean / 2)], (60, 1))
        truth = landmarks_of(rig, positions, root)
        points = in_order(truth - truth[:, 7:9].mean(axis=1, keepdims=True), NAMES) @ CAMERA.T
        roots, expected = (read_all(physkin.LandmarkReader(axes=axes), points)[1] for axes in (None, "-z x -y"))
        np.testing.assert_allclose(roots, expected, atol=1e-9)


def test_forearms_that_lack_depth(rig):
    """MediaPipe sees too little of it: forearms of which it sees half are 11 degrees off in the median. They show their
    length when they hang."""
    positions = np.tile(rig.rest, (120, 1))
    bent = np.arange(120) % 30 < 10
    for side, way in (("L", -1), ("R", 1)):
        positions[bent, rig.joint_indices[f"lowerarm01.{side}_z"]] += way * 1.0
    root = np.tile([0.0, 0, 0.914, 0, 0, 0, 1], (120, 1))
    truth = landmarks_of(rig, positions, root)
    points = truth - truth[:, 7:9].mean(axis=1, keepdims=True)
    for elbow, wrist in ((9, 11), (10, 12)):
        points[:, wrist, 0] -= 0.5 * (points[:, wrist, 0] - points[:, elbow, 0])
    read = read_all(physkin.LandmarkReader(), in_order(points, NAMES) @ CAMERA.T)
    seen, mended = (angles_between(each, truth)["forearm"][bent] for each in (points, landmarks_of(rig, *read)))
    assert np.median(seen) > 10 and np.median(mended) < 3

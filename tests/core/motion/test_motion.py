"""Motion clips: the bundled ones look like what they are called, files are checked, resampling does not jump."""

from dataclasses import replace

import numpy as np
import pytest
from safetensors.numpy import load_file, save_file
from scipy.spatial.transform import Rotation

from physkin_core.avatar.body_model import load_body_model
from physkin_core.motion.loading import MOTIONS_DIRECTORY, bundled_motions, load_motion, save_motion
from physkin_core.motion.motion import Motion, MotionError, upright_orientation
from physkin_core.rig.rig import DegreeOfFreedom, Rig

DOWN = np.array([0.0, 0.0, -1.0])


def directions(motion, start, end):
    """(T, 3) unit directions in the world from the head of bone `start` to that of `end`."""
    rig = load_body_model().rig
    transforms = rig.bone_transforms(motion.positions)
    heads = np.einsum("tbij,bj->tbi", transforms[..., :3], rig.heads) + transforms[..., 3]
    local = heads[:, rig.bone_index(end)] - heads[:, rig.bone_index(start)]
    turned = np.stack([Rotation.from_quat(q).apply(v) for q, v in zip(motion.root_orientation, local, strict=True)])
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def largest_jump(motion):
    """Largest change of a joint position between two frames, in degrees."""
    return np.degrees(np.abs(np.diff(motion.positions, axis=0)).max())


def spinning(frames=9, *, turn=0.5, closed=False):
    """A clip of two joints whose root walks ahead and turns by `turn` radians over the clip."""
    phase = np.linspace(0.0, 1.0, frames)
    joint = np.sin(2 * np.pi * phase) if closed else phase
    half = turn * phase / 2
    orientation = np.stack([0 * phase, 0 * phase, np.sin(half), np.cos(half)], axis=1)
    place = np.stack([phase, 0 * phase, 1 + 0 * phase], axis=1)
    return Motion(("a", "b"), np.stack([joint, -joint], axis=1), orientation, place, 8.0, "spinning")


@pytest.mark.parametrize("name", bundled_motions())
def test_bundled_clip_fits_the_default_rig(name):
    """Names and limits are the default rig's, frames come at 60 Hz without a jump, and the file is small."""
    rig, motion = load_body_model().rig, load_motion(name)
    assert motion.name == name
    assert motion.rate_hz == 60.0
    assert motion.joint_names == rig.joint_names
    tolerance = 1e-5
    assert (motion.positions >= rig.lower - tolerance).all()
    assert (motion.positions <= rig.upper + tolerance).all()
    assert largest_jump(motion) < 25.0
    assert largest_jump(motion.looped(6.0)) < 25.0
    assert (MOTIONS_DIRECTORY / f"{name}.safetensors").stat().st_size < 150_000


def test_walk_walks():
    """Head up, arms hanging, legs under the body, knees and elbows bending the human way, feet on the floor."""
    rig, walk = load_body_model().rig, load_motion("walk")
    assert (directions(walk, "spine05", "head")[:, 2] > 0.9).all()
    for side in "LR":
        assert (directions(walk, f"upperarm01.{side}", f"lowerarm01.{side}")[:, 2] < -0.6).all()
        assert (directions(walk, f"lowerarm01.{side}", f"wrist.{side}")[:, 2] < 0).all()
        thigh = directions(walk, f"upperleg01.{side}", f"lowerleg01.{side}")
        assert (thigh[:, 2] < -0.7).all()
        assert np.ptp(thigh[:, 0]) > 0.5, "legs must swing"
        knee = walk.positions[:, rig.joint_names.index(f"lowerleg01.{side}_y")]
        assert knee.max() > np.radians(40)
        assert knee.min() > np.radians(-10)
    assert walk.root_position[-1, 0] > 1.0, "a walk must get on, along X"
    assert np.abs(walk.root_position[:, 1]).max() < 0.2
    assert walk.is_cycle
    np.testing.assert_allclose(walk.gravity, np.broadcast_to(DOWN, (walk.frame_count, 3)), atol=0.25)


def test_gravity_is_the_world_s_down_in_the_root_frame():
    """Against the rotation matrix, for random orientations."""
    quaternions = np.random.default_rng(0).normal(size=(20, 4))
    quaternions /= np.linalg.norm(quaternions, axis=1, keepdims=True)
    motion = Motion(("a",), np.zeros((20, 1)), quaternions, np.zeros((20, 3)), 60.0)
    expected = [Rotation.from_quat(q).inv().apply(DOWN) for q in quaternions]
    np.testing.assert_allclose(motion.gravity, expected, atol=1e-6)
    assert motion.gravity.dtype == np.float32


def test_file_round_trip(tmp_path):
    """What is saved is loaded, bit for bit."""
    motion = spinning()
    save_motion(motion, tmp_path / "clip.safetensors", notes={"licence": "none"})
    again = load_motion(tmp_path / "clip.safetensors")
    for field in ("joint_names", "rate_hz", "name"):
        assert getattr(again, field) == getattr(motion, field)
    for field in ("positions", "root_orientation", "root_position"):
        np.testing.assert_array_equal(getattr(again, field), getattr(motion, field))


@pytest.mark.parametrize("rate_hz", [3.0, 8.0, 60.0])
def test_resampling_keeps_the_ends_and_the_curve(rate_hz):
    """A smooth curve is met between the old frames, first and last frame stay, quaternion signs do not matter."""
    motion = spinning(33, closed=True)
    flipped = motion.root_orientation.copy()
    flipped[::2] *= -1
    resampled = Motion(motion.joint_names, motion.positions, flipped, motion.root_position, 8.0).resampled(rate_hz)
    assert resampled.frame_count == 1 + round(4.0 * rate_hz)
    phase = np.linspace(0.0, 1.0, resampled.frame_count)
    np.testing.assert_allclose(resampled.positions[:, 0], np.sin(2 * np.pi * phase), atol=2e-3)
    np.testing.assert_allclose(resampled.root_position[:, 0], phase, atol=1e-6)
    turned = np.abs(np.sum(resampled.root_orientation[-1] * motion.root_orientation[-1]))
    assert turned == pytest.approx(1.0, abs=1e-6)
    np.testing.assert_allclose(np.linalg.norm(resampled.gravity, axis=1), 1.0, atol=1e-6)


@pytest.mark.parametrize("seconds", [0.01, 0.5, 1.0, 7.3])
def test_looping_gives_exactly_the_frames_asked_for(seconds):
    """ceil(seconds * rate), for a cycle, a clip that is none, and a single frame."""
    for motion in (spinning(closed=True), spinning(), spinning(1)):
        assert motion.looped(seconds).frame_count == int(np.ceil(seconds * 8.0))


def test_a_cycle_carries_on_where_it_ended():
    """Round after round the root goes on turning and walking: every step looks the same from the root."""
    motion = spinning(closed=True)
    assert motion.is_cycle
    looped = motion.looped(5.0)
    np.testing.assert_allclose(looped.positions[8:16], looped.positions[:8], atol=1e-6)
    heading = np.unwrap(2 * np.arctan2(looped.root_orientation[:, 2], looped.root_orientation[:, 3]), period=2 * np.pi)
    np.testing.assert_allclose(np.diff(heading), 0.5 / 8, atol=1e-5)
    steps = np.diff(looped.root_position, axis=0)
    np.testing.assert_allclose(np.linalg.norm(steps, axis=1), 1 / 8, atol=1e-5)
    np.testing.assert_allclose(looped.root_position[:9], motion.root_position, atol=1e-6)
    second_round = looped.root_position[16] - looped.root_position[8]
    np.testing.assert_allclose(second_round, [np.cos(0.5), np.sin(0.5), 0.0], atol=1e-5)


def test_a_clip_that_is_no_cycle_goes_back_and_forth():
    """No frame is far from the one before."""
    motion = spinning()
    assert not motion.is_cycle
    looped = motion.looped(5.0)
    assert np.abs(np.diff(looped.positions, axis=0)).max() == pytest.approx(1 / 8)
    np.testing.assert_array_equal(looped.positions[16], motion.positions[0])


def test_unknown_name_lists_the_bundled_ones():
    """A typing mistake is answered with what there is."""
    with pytest.raises(MotionError, match=r"'wlak'.*walk"):
        load_motion("wlak")


@pytest.mark.parametrize("content", [None, b"", b"\x08\x00\x00\x00\x00\x00\x00\x00not json", "truncated"])
def test_unreadable_file(tmp_path, content):
    """Missing, empty, foreign and truncated files."""
    path = tmp_path / "clip.safetensors"
    if content == "truncated":
        content = (MOTIONS_DIRECTORY / "walk.safetensors").read_bytes()[:-100]
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(MotionError, match="clip.safetensors: (no such file|it cannot be read as safetensors)"):
        load_motion(path)


@pytest.mark.parametrize("missing", ["positions", "root_orientation", "root_position", "joint_names", "rate_hz"])
def test_missing_parts(tmp_path, missing):
    """The error names what the file lacks; names that are no list and a rate that is no number are refused, too."""
    tensors = {key: value for key, value in load_file(MOTIONS_DIRECTORY / "walk.safetensors").items() if key != missing}
    metadata = {key: value for key, value in {"joint_names": "[]", "rate_hz": "60"}.items() if key != missing}
    save_file(tensors, tmp_path / "clip.safetensors", metadata=metadata)
    with pytest.raises(MotionError, match=f"lacks.*{missing}"):
        load_motion(tmp_path / "clip.safetensors")
    for malformed in ({"joint_names": "["}, {"rate_hz": "fast"}):
        save_file(tensors, tmp_path / "clip.safetensors", metadata={"joint_names": "[]", "rate_hz": "60", **malformed})
        with pytest.raises(MotionError, match="malformed|lacks"):
            load_motion(tmp_path / "clip.safetensors")


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("joint_names", ("a", "a"), "unique"),
        ("joint_names", ("a",), r"\(9, 2\).*expected \(T, 1\)"),
        ("positions", np.zeros((0, 2)), "T > 0"),
        ("positions", np.full((9, 2), np.nan), "positions.*not finite"),
        ("root_position", np.full((9, 3), np.inf), "root_position.*not finite"),
        ("root_position", np.zeros((8, 3)), r"\(8, 3\).*expected \(9, 3\)"),
        ("root_orientation", np.zeros((9, 3)), r"expected \(9, 4\)"),
        ("root_orientation", np.zeros((9, 4)), "unit quaternions"),
        ("rate_hz", 0.0, "rate_hz.*0.0"),
        ("rate_hz", float("nan"), "rate_hz.*nan"),
        ("rate_hz", 1 / 3600, "rate_hz must be from 0.001 to 100000"),
        ("rate_hz", 1e6, "rate_hz must be from 0.001 to 100000"),
    ],
)
def test_bad_values(field, value, message):
    """Each is refused with the field and the value."""
    motion = spinning()
    fields = {name: getattr(motion, name) for name in motion.__dataclass_fields__} | {field: value}
    with pytest.raises(MotionError, match=message):
        Motion(**fields)


def test_no_rate_makes_frames_without_end():
    slow = replace(spinning(), rate_hz=0.002)
    with pytest.raises(MotionError, match="frames at 1000 Hz, at most 500000 are made; choose a lower rate"):
        slow.resampled(1000.0)


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_bad_rate_or_length(value):
    """Neither a rate nor a length may be zero, negative or endless."""
    with pytest.raises(MotionError, match="rate_hz"):
        spinning().resampled(value)
    with pytest.raises(MotionError, match="seconds"):
        spinning().looped(value)


def test_positions_for_a_rig_go_by_name():
    """Another order, a joint that the clip lacks and one that the rig lacks; nothing in common is an error."""
    motion = spinning()
    dofs = tuple(DegreeOfFreedom(name, "root", (1, 0, 0), -1, 1, rest) for name, rest in (("c", 0.3), ("b", 0.1)))
    rig = Rig(("root",), np.array([-1]), np.zeros((1, 3)), np.ones((1, 3)), dofs)
    positions = motion.positions_for(rig)
    assert positions.shape == (9, 2) and positions.dtype == np.float32
    np.testing.assert_array_equal(positions[:, 0], np.float32(0.3))
    np.testing.assert_array_equal(positions[:, 1], motion.positions[:, 1])
    with pytest.raises(MotionError, match="motion 'spinning' has no joint of the rig: it moves a, b"):
        motion.positions_for(load_body_model().rig)


@pytest.mark.parametrize("gravity", [[0, 0, -1], [0, 0, 1], [1, 0, 0], [0.48, -0.6, 0.64]])
def test_upright_is_the_smallest_turn(gravity):
    turn = Rotation.from_quat(upright_orientation(np.array([gravity], dtype=float)))[0].as_matrix()
    np.testing.assert_allclose(turn @ gravity, [0, 0, -1], atol=1e-12)
    assert np.trace(turn) == pytest.approx(1 - 2 * gravity[2]), "the smallest rotation"

"""Motion capture files: poses made up in BVH and in ASF/AMC come out on the rig as the same poses."""

from __future__ import annotations

import re
import time
from dataclasses import replace

import numpy as np
import pytest
from bvh_clips import JOINTS, POSE, write_bvh
from scipy.spatial.transform import Rotation

from physkin_core import MotionError, load_body_model, load_motion
from physkin_core.motion.clip_files import load_clip as load_mocap
from physkin_core.progress import progress_line

UPPER_ARM, UPPER_LEG = 30 / 55, 0.5  # of a limb's length
ASF_NAMES = {"Hips": "root", "Spine1": "thorax", "Head": "head"}
for _side in ("Left", "Right"):
    for _name, _bone in (("UpLeg", "femur"), ("Leg", "tibia"), ("Foot", "foot")):
        ASF_NAMES[f"{_side}{_name}"] = _side[0].lower() + _bone
    for _name, _bone in (("Arm", "humerus"), ("ForeArm", "radius"), ("Hand", "wrist")):
        ASF_NAMES[f"{_side}{_name}"] = _side[0].lower() + _bone


def write_along_bones(path, frames):
    """The same with axes of its own for each joint, in which nobody stands without rotation, below a joint more."""
    random = np.random.default_rng(3)
    axes = {name: Rotation.random(random_state=random) for name, *_ in JOINTS} | {None: Rotation.identity()}
    joints = [("Place", None, (0, 0, 0))]
    joints += [(name, parent or "Place", tuple(axes[parent].inv().apply(offset))) for name, parent, offset in JOINTS]
    turned = []
    for frame in frames:
        values = {"position": frame.get("position", (0, 95, 0))}
        for name, parent, _ in JOINTS:
            turn = (
                axes[parent].inv() * Rotation.from_euler("ZXY", frame.get(name, (0, 0, 0)), degrees=True) * axes[name]
            )
            values[name] = tuple(turn.as_euler("ZXY", degrees=True))
        turned.append(values)
    return write_bvh(path, turned, joints=joints)


def write_amc(folder, frames):
    """The same with bones that have axes of their own; turns about one axis only. Returns the .amc."""
    end = {name: (0.0, 0.0, 1.0) for name, *_ in JOINTS}
    lines = [":units", "length 0.45", ":root", "order TX TY TZ RX RY RZ", "axis XYZ", ":bonedata"]
    hierarchy = [":hierarchy", "begin"]
    links = 0
    for name, parent, offset in JOINTS:
        if parent is None:
            continue
        # a bone of fixed direction carries each joint's offset: ASF places a bone at its parent's end
        links += 1
        length = float(np.linalg.norm(offset))
        direction = np.array(offset) / length
        fixed = f"link{links}"
        lines += ["begin", f"name {fixed}", "direction {} {} {}".format(*direction), f"length {length}"]
        lines += ["axis 0 0 0 XYZ", "end", "begin", f"name {ASF_NAMES[name]}"]
        lines += ["direction {} {} {}".format(*end[name]), "length 0", "axis 30 40 50 XYZ", "dof rx ry rz", "end"]
        hierarchy += [f"{ASF_NAMES[parent]} {fixed}", f"{fixed} {ASF_NAMES[name]}"]
    (folder / "07.asf").write_text("\n".join([*lines, *hierarchy, "end"]) + "\n")
    axis = Rotation.from_euler("xyz", [30, 40, 50], degrees=True)
    text = [":FULLY-SPECIFIED", ":DEGREES"]
    for index, frame in enumerate(frames, start=1):
        turned = {n: Rotation.from_euler("ZXY", frame.get(n, (0, 0, 0)), degrees=True) for n, *_ in JOINTS}
        root = turned["Hips"].as_euler("xyz", degrees=True)
        text += [str(index), "root 0 95 0 {} {} {}".format(*root)]
        for name, parent, _ in JOINTS:
            if parent is not None:
                angles = (axis.inv() * turned[name] * axis).as_euler("xyz", degrees=True)
                text.append("{} {} {} {}".format(ASF_NAMES[name], *angles))
    path = folder / "07_01.amc"
    path.write_text("\n".join(text) + "\n")
    return path


@pytest.fixture(scope="module")
def rig():
    return load_body_model().rig


def limb(rig, motion, start, end):
    """(T, 3) unit direction between two bones' heads, root frame."""
    transforms = rig.bone_transforms(motion.positions)
    heads = np.einsum("tbij,bj->tbi", transforms[..., :3], rig.heads) + transforms[..., 3]
    direction = heads[:, rig.bone_index(end)] - heads[:, rig.bone_index(start)]
    return direction / np.linalg.norm(direction, axis=1, keepdims=True)


def end_of_limb(rig, motion, *bones):
    """(T, 3) where a limb ends, from where it begins, as a share of its length, root frame."""
    heads = {bone: rig.heads[rig.bone_index(bone)] for bone in bones}
    upper, lower = (np.linalg.norm(heads[b] - heads[a]) for a, b in zip(bones, bones[1:]))
    return (upper * limb(rig, motion, *bones[:2]) + lower * limb(rig, motion, *bones[1:])) / (upper + lower)


def angle(directions, expected):
    """Largest angle [degrees]."""
    return np.degrees(np.arccos(np.clip((directions * np.array(expected, dtype=float)).sum(axis=-1), -1, 1))).max()


FIELDS = ("positions", "root_orientation", "root_position")


@pytest.mark.parametrize("kind", ["bvh", "along bones", "amc"])
def test_limbs_point_where_the_files_do(kind, rig, tmp_path):
    """Arms and legs, whatever the file's axes and wherever its joints are without rotation. They end where the file's
    do: segments whose lengths have another ratio, by a tenth, point elsewhere by some degrees where they bend."""
    if kind == "amc":
        motion, report = load_mocap(write_amc(tmp_path, [POSE] * 3), rig, source_rate_hz=60)
    elif kind == "along bones":
        motion, report = load_mocap(write_along_bones(tmp_path / "a.bvh", [POSE] * 3 + [{}]), rig)
        motion = replace(motion, **{field: getattr(motion, field)[:3] for field in FIELDS})
    else:
        motion, report = load_mocap(write_bvh(tmp_path / "a.bvh", [POSE] * 3), rig)
    assert motion.frame_count == 3 and motion.rate_hz == 60 and motion.joint_names == rig.joint_names
    s, c = np.sin(np.radians(80)), np.cos(np.radians(80))
    expected = {
        ("upperarm01.L", "lowerarm01.L"): (0, c, -s),
        ("lowerarm01.L", "wrist.L"): (1, 0, 0),
        ("upperarm01.R", "lowerarm01.R"): (0, -c, -s),
        ("lowerarm01.R", "wrist.R"): (0, -c, -s),
        ("upperleg01.L", "lowerleg01.L"): (0, 0, -1),
        ("upperleg01.R", "lowerleg01.R"): (np.sin(np.radians(60)), 0, -0.5),
        ("lowerleg01.R", "foot.R"): (0, 0, -1),
    }
    for ends, direction in expected.items():
        assert angle(limb(rig, motion, *ends), direction) < 10, ends
    assert max(report[bone] for bone in report if "foot" not in bone) < 5
    for bones in (("upperarm01.L", "lowerarm01.L", "wrist.L"), ("upperleg01.R", "lowerleg01.R", "foot.R")):
        upper, lower = (np.array(expected[pair]) for pair in zip(bones, bones[1:]))
        share = UPPER_ARM if "arm" in bones[0] else UPPER_LEG
        end = share * upper + (1 - share) * lower
        reached = end_of_limb(rig, motion, *bones) - end
        if "leg" in bones[0]:  # feet are as far apart as the file's, though hips are not
            reached[:, 1] = 0
        assert np.linalg.norm(reached[0]) < 0.01, bones


def test_root_faces_x_stands_and_walks(rig, tmp_path):
    """Whatever it looked along at first; its way is scaled by the legs; leaning tilts gravity."""
    frames = [
        {**POSE, "Hips": (0, 0, 90), "position": (300, 95, 7)},
        {**POSE, "Hips": (0, 0, 90), "position": (390, 95, 7)},
        {**POSE, "Hips": (0, 30, 90), "position": (390, 95, 7)},
    ]
    motion, _ = load_mocap(write_bvh(tmp_path / "a.bvh", frames), rig)
    way = motion.root_position[1] - motion.root_position[0]
    hip, ankle = rig.heads[rig.bone_index("upperleg01.L")], rig.heads[rig.bone_index("foot.L")]
    assert way[0] == pytest.approx(np.linalg.norm(hip - ankle), rel=0.02)  # 90 units, the legs' length
    assert abs(way[1]) < 1e-3 and 0.5 < motion.root_position[0, 2] < 1.2
    assert angle(motion.gravity[:1], (0, 0, -1)) < 0.1
    turned = np.degrees(np.arccos(-motion.gravity[2, 2]))
    assert turned == pytest.approx(30, abs=0.5)


TOES = [*JOINTS, ("LeftToeBase", "LeftFoot", (0, -6, 14)), ("RightToeBase", "RightFoot", (0, -6, 14))]


@pytest.mark.parametrize("degrees", [30, 45, 200])
def test_any_heading_at_rest(degrees, rig, tmp_path):
    """As of a scene in which the figure was turned; a skeleton a little askew still looks along an axis."""
    frames = [{**POSE, "Hips": (0, 2 * k, 5 * k), "position": (9 * k, 95, 4 * k)} for k in range(5)]
    plain = load_mocap(write_bvh(tmp_path / "a.bvh", frames, joints=TOES), rig)[0]
    read = load_mocap(write_turned(tmp_path / "b.bvh", frames, Rotation.from_euler("y", degrees, degrees=True)), rig)[0]
    for field in FIELDS[:1] + FIELDS[2:]:
        np.testing.assert_allclose(getattr(read, field), getattr(plain, field), atol=2e-3)


def write_turned(path, frames, turn, mirror=(1, 1, 1)):
    """The same clip in another frame, rest and all."""
    frame = turn.as_matrix() @ np.diag(mirror)
    joints = [(name, parent, tuple(frame @ offset)) for name, parent, offset in TOES]
    moved = []
    for each in frames:
        values = {"position": tuple(frame @ each.get("position", (0, 95, 0)))}
        for name, *_ in JOINTS:
            rotation = frame @ Rotation.from_euler("ZXY", each.get(name, (0, 0, 0)), degrees=True).as_matrix() @ frame.T
            values[name] = tuple(Rotation.from_matrix(rotation).as_euler("ZXY", degrees=True))
        moved.append(values)
    return write_bvh(path, moved, joints=joints)


def test_mirrored_clips_walk_forwards(rig, tmp_path, caplog):
    """Of left-handed files, and armatures of negative scale: toes tell; said, with the file."""
    frames = [{**POSE, "Hips": (0, 2 * k, 5 * k), "position": (9 * k, 95, 4 * k)} for k in range(5)]
    plain = load_mocap(write_bvh(tmp_path / "a.bvh", frames, joints=TOES), rig)[0]
    assert "mirrored" not in caplog.text
    read = load_mocap(write_turned(tmp_path / "b.bvh", frames, Rotation.identity(), (-1, 1, 1)), rig)[0]
    for field in FIELDS:
        np.testing.assert_allclose(getattr(read, field), getattr(plain, field), atol=2e-3)
    assert f"{tmp_path / 'b.bvh'}: it is mirrored, as toes point backwards" in caplog.text


def test_fast_clips_are_thinned(rig, tmp_path):
    """120 Hz becomes 60."""
    motion, _ = load_mocap(write_bvh(tmp_path / "a.bvh", [POSE] * 9, rate=120), rig)
    assert motion.frame_count == 5 and motion.rate_hz == 60


def test_long_clips_are_refused(rig, tmp_path):
    """Before anything is made of their frames."""
    path = write_bvh(tmp_path / "a.bvh", [POSE] * 900, rate=0.1)
    with pytest.raises(MotionError, match="a.bvh: it lasts 9e.03 s, allowed are 8333 s"):
        load_mocap(path, rig)


@pytest.mark.parametrize(
    ("old", "new", "reason"),
    [
        (
            "\nend\n",
            "\nlfemur link3\nend\n",
            "hangs 'link3' on 'lfemur'; allowed are bones of :bonedata, each once, and no",
        ),
        ("\nend\n", "\nlfemur root\nend\n", "hangs 'root' on 'lfemur'"),
        ("\nend\n", "\nlfemur nothing\nend\n", "hangs 'nothing' on 'lfemur'"),
        (
            "begin\nroot link1",
            "begin\nthorax link2\nroot link1",
            "hangs bones on 'thorax', which no line before hangs on",
        ),
        ("direction", "way", "skeleton's bone 'rwrist' lacks direction"),
        ("name", "nombre", "bone '.' lacks name"),
        ("XYZ", "XYZ" + " a" * (1 << 21), "07.asf: '07.asf' has [0-9]+ bytes, allowed are 4194304"),
    ],
    ids=["circle", "root", "nothing", "order", "direction", "name", "size"],
)
def test_broken_skeletons_are_refused(old, new, reason, rig, tmp_path):
    """A hierarchy in a circle had no end, a file larger than any skeleton took four times its size."""
    path = write_amc(tmp_path, [POSE])
    before, found, after = (tmp_path / "07.asf").read_text().rpartition(old)
    (tmp_path / "07.asf").write_text(before + found.replace(old, new) + after)
    with pytest.raises(MotionError, match=reason):
        load_mocap(path, rig)


def test_skeletons_and_poses_as_tools_write_them(rig, tmp_path):
    """Tabs, doubled line ends, decimal commas and a mark of the byte order in ASF and AMC; a half line is named."""
    path = write_amc(tmp_path, [POSE] * 2)
    plain, half = load_mocap(path, rig)[0], path.read_text().rstrip().rpartition(" ")[0]
    for file in (path, tmp_path / "07.asf"):
        text = file.read_text().replace(" ", "\t").replace(".", ",").replace("\n", "\r\r\n")
        file.write_bytes(text.encode("utf-16"))
    np.testing.assert_array_equal(load_mocap(path, rig)[0].positions, plain.positions)
    path.write_text(half)
    with pytest.raises(MotionError, match="line 34 has 2 values; allowed are 3 finite numbers"):
        load_mocap(path, rig)


def test_amc_in_radians(rig, tmp_path):
    """Where the skeleton's units say so, as much is turned."""
    path = write_amc(tmp_path, [POSE] * 2)
    plain, asf = load_mocap(path, rig)[0], tmp_path / "07.asf"
    number = r"-?[0-9.]+(?:e-?[0-9]+)?"

    def in_radians(values):
        return " ".join(repr(float(np.radians(float(value)))) for value in values.split())

    axes = re.sub(rf"(?<=axis )((?:{number} ){{3}})", lambda found: in_radians(found[1]) + " ", asf.read_text())
    asf.write_text(":units\n  mass 1.0\n  angle rad\n" + axes)
    rows = []
    for row in path.read_text().splitlines():
        name, *values = row.split()
        kept = 3 if name == "root" else 0
        rows.append(" ".join([name, *values[:kept], in_radians(" ".join(values[kept:]))]))
    path.write_text("\n".join(rows) + "\n")
    np.testing.assert_allclose(load_mocap(path, rig)[0].positions, plain.positions, atol=1e-4)


def test_amc_needs_its_skeleton(rig, tmp_path):
    """And a rate that makes sense."""
    path = write_amc(tmp_path, [POSE])
    (tmp_path / "07.asf").rename(tmp_path / "other.asf")
    with pytest.raises(MotionError, match="07.asf"):
        load_mocap(path, rig)
    with pytest.raises(MotionError, match="source_rate_hz"):
        load_mocap(path, rig, skeleton=tmp_path / "other.asf", source_rate_hz=0.0)


def test_straight_arm_turns_about_itself(rig, tmp_path):
    """Its elbow's axis is known from the frames in which it bends, so that the sleeve twists with the arm."""
    turned = []
    for twist in (0, 60):
        frames = [POSE] * 6
        for share in (0.25, 0.5, 0.75, *[1.0] * 12):
            frames += [{**POSE, "LeftArm": (-80, share * twist, 0), "LeftForeArm": (0, 0, (share - 1) * 90)}]
        motion, _ = load_mocap(write_bvh(tmp_path / "a.bvh", frames), rig)
        turned.append(rig.bone_transforms(motion.positions[17])[rig.bone_index("upperarm02.L"), :, :3])
    along = [0, np.cos(np.radians(80)), -np.sin(np.radians(80))]
    twisted = np.degrees(Rotation.from_matrix(turned[1] @ turned[0].T).as_rotvec()) @ along
    assert twisted == pytest.approx(60, abs=15)


def sided(name, form, **parts):
    """A limb's joint with its side where `form` has it, in words of `parts`; a joint of the trunk as it is."""
    side = "Left" if name.startswith("Left") else "Right" if name.startswith("Right") else ""
    part = parts.get(name.removeprefix(side), name.removeprefix(side))
    return form.format(s=side[0].lower(), S=side[0], part=part) if side else part


NAMINGS = {
    "CMU for DAZ": lambda name: sided(name, "{s}{part}", UpLeg="Thigh", Leg="Shin", Arm="Shldr", Hips="hip"),
    "Mixamo": lambda name: f"mixamorig:{name}",
    "3ds Max biped": lambda name: sided(name, "Bip001 {S} {part}", UpLeg="Thigh", Leg="Calf", Arm="UpperArm"),
}


@pytest.mark.parametrize("naming", NAMINGS)
def test_usual_names_are_known(naming, rig, tmp_path):
    """`load_motion` reads the same motion whatever the joints are called; names may have spaces."""
    frames = [POSE, {**POSE, "LeftForeArm": (0, 0, -60)}]
    plain, _ = load_mocap(write_bvh(tmp_path / "plain.bvh", frames), rig)
    named = load_motion(write_bvh(tmp_path / "named.bvh", frames, renamed=NAMINGS[naming]))
    np.testing.assert_array_equal(named.positions, plain.positions)
    assert np.abs(named.positions[0] - rig.rest).max() > 0.3


def test_a_joint_that_no_name_tells_is_mentioned(rig, tmp_path, caplog):
    """An elbow by its place; left and right by names."""
    load_mocap(write_bvh(tmp_path / "a.bvh", [POSE] * 2, renamed=lambda name: name.replace("LeftForeArm", "J7")), rig)
    assert "a.bvh: by their place in the skeleton, not by name, these joints were taken: 'J7' for" in caplog.text


def test_limbs_must_hang_together(rig, tmp_path):
    """A forearm that its upper arm does not carry is no forearm."""
    joints = [(name, "Spine1" if name == "LeftForeArm" else parent, offset) for name, parent, offset in JOINTS]
    with pytest.raises(
        MotionError,
        match="not recognised: 'LeftArm', 'LeftForeArm', 'LeftHand' and 1 more.* limb below each other",
    ):
        load_mocap(write_bvh(tmp_path / "a.bvh", [POSE] * 2, joints=joints), rig)


@pytest.mark.parametrize(("blended", "limbs"), [(1, "left arm, right arm, right leg"), (3, "left arm")])
def test_calibration_pose_is_left_out(blended, limbs, rig, tmp_path, caplog):
    """Arms stretched out in the first frame, or blended into the motion over a few; what is quick and no jump stays."""
    moving = [{**POSE, "LeftArm": (-80 + 0.5 * k, 0, 0)} for k in range(30)]
    ahead = [{name: tuple(k / blended * np.array(turn)) for name, turn in POSE.items()} for k in range(blended)]
    motion, _ = load_mocap(write_bvh(tmp_path / "a.bvh", [*ahead, *moving], rate=60), rig)
    clean, _ = load_mocap(write_bvh(tmp_path / "clean.bvh", moving, rate=60), rig)
    np.testing.assert_array_equal(motion.positions, clean.positions)
    assert [record.message for record in caplog.records] == [
        f"{tmp_path / 'a.bvh'}: its first {blended} frames are left out: a calibration pose ({limbs})"
    ]


def test_reading_says_how_far_it_is(rig, tmp_path, monkeypatch, capsys):
    """To whom asks; a command's line appears on a terminal only, after a while, and is gone in the end."""
    path, shares = write_bvh(tmp_path / "a.bvh", [POSE] * 3), []
    load_motion(path, watch=shares.append)
    assert shares == sorted(shares) and shares[-1] == 1
    monkeypatch.setattr("physkin_core.progress.PATIENCE", -1.0)
    load_motion(path, watch=progress_line("reading a.bvh"))
    assert capsys.readouterr().err == ""
    monkeypatch.setattr("sys.stderr.isatty", lambda: True, raising=False)
    load_motion(path, watch=progress_line("reading a.bvh"))
    said = capsys.readouterr().err.split("\r\x1b[K")
    assert any(line.startswith("reading a.bvh: 40%, 0:") for line in said) and said[-1] == ""


@pytest.mark.slow
def test_reading_is_faster_than_watching(rig, tmp_path):
    """At least ten times real time on one core; some fifteen where nothing else runs."""
    random = np.random.default_rng(0)
    waves = random.normal(size=(len(JOINTS), 3)) * 20
    frames = [
        {name: tuple(wave * np.sin(k / 20)) for (name, *_), wave in zip(JOINTS, waves, strict=True)}
        for k in range(1200)
    ]
    path = write_bvh(tmp_path / "a.bvh", frames)
    start = time.process_time()
    motion, _ = load_mocap(path, rig)
    assert time.process_time() - start < motion.frame_count / motion.rate_hz / 10

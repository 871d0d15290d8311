"""Motion capture files: poses made up in BVH and in ASF/AMC come out on the rig as the same poses."""

from __future__ import annotations

import re

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from physkin_core import MotionError, load_body_model, load_motion
from physkin_core.motion.mocap import load_mocap

# name, parent, offset from the parent (Y up, looks along Z, left is X), arms stretched out sideways
JOINTS = [
    ("Hips", None, (0, 0, 0)),
    ("Spine1", "Hips", (0, 20, 0)),
    ("Head", "Spine1", (0, 30, 0)),
]
for _side, _x in (("Left", 1), ("Right", -1)):
    JOINTS += [
        (f"{_side}UpLeg", "Hips", (10 * _x, -5, 0)),
        (f"{_side}Leg", f"{_side}UpLeg", (0, -45, 0)),
        (f"{_side}Foot", f"{_side}Leg", (0, -45, 0)),
        (f"{_side}Arm", "Spine1", (20 * _x, 25, 0)),
        (f"{_side}ForeArm", f"{_side}Arm", (30 * _x, 0, 0)),
        (f"{_side}Hand", f"{_side}ForeArm", (25 * _x, 0, 0)),
    ]
ASF_NAMES = {"Hips": "root", "Spine1": "thorax", "Head": "head"}
for _side in ("Left", "Right"):
    for _name, _bone in (("UpLeg", "femur"), ("Leg", "tibia"), ("Foot", "foot")):
        ASF_NAMES[f"{_side}{_name}"] = _side[0].lower() + _bone
    for _name, _bone in (("Arm", "humerus"), ("ForeArm", "radius"), ("Hand", "wrist")):
        ASF_NAMES[f"{_side}{_name}"] = _side[0].lower() + _bone


def write_bvh(path, frames, *, rate=60, prefix=""):
    """frames: joint -> degrees about Z, X and Y (intrinsic), others at rest; `position` of the root."""
    children = {name: [child for child, parent, _ in JOINTS if parent == name] for name, *_ in JOINTS}
    offset = {name: offset for name, _, offset in JOINTS}
    order, lines = [], ["HIERARCHY"]

    def joint(name, keyword):
        order.append(name)
        kept = "Xposition Yposition Zposition " if keyword == "ROOT" else ""
        channels = f"CHANNELS {6 if kept else 3} {kept}Zrotation Xrotation Yrotation"
        lines.extend([f"{keyword} {prefix}{name}", "{", "OFFSET {} {} {}".format(*offset[name]), channels])
        for child in children[name]:
            joint(child, "JOINT")
        if not children[name]:
            lines.extend(["End Site", "{", "OFFSET 0 5 0", "}"])
        lines.append("}")

    joint("Hips", "ROOT")
    lines += ["MOTION", f"Frames: {len(frames)}", f"Frame Time: {1 / rate}"]
    for frame in frames:
        values = [*frame.get("position", (0, 95, 0))]
        for name in order:
            values += frame.get(name, (0, 0, 0))
        lines.append(" ".join(map(str, values)))
    path.write_text("\n".join(lines) + "\n")
    return path


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


def angle(directions, expected):
    """Largest angle [degrees]."""
    return np.degrees(np.arccos(np.clip((directions * np.array(expected, dtype=float)).sum(axis=-1), -1, 1))).max()


# Left arm hangs and its elbow bends forward by a right angle; the right one hangs; the right knee is pulled up.
POSE = {
    "LeftArm": (-80, 0, 0),
    "LeftForeArm": (0, 0, -90),
    "RightArm": (80, 0, 0),
    "RightUpLeg": (0, -60, 0),
    "RightLeg": (0, 60, 0),
}


@pytest.mark.parametrize("kind", ["bvh", "mixamo", "amc"])
def test_limbs_point_where_the_files_do(kind, rig, tmp_path):
    """Arms and legs, whatever the file's axes."""
    if kind == "amc":
        motion, report = load_mocap(write_amc(tmp_path, [POSE] * 3), rig, source_rate_hz=60)
    else:
        prefix = "mixamorig:" if kind == "mixamo" else ""
        motion, report = load_mocap(write_bvh(tmp_path / "a.bvh", [POSE] * 3, prefix=prefix), rig)
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
        assert angle(limb(rig, motion, *ends), direction) < 5, ends
    assert max(report[bone] for bone in report if "foot" not in bone) < 5


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


def test_fast_clips_are_thinned(rig, tmp_path):
    """120 Hz becomes 60."""
    motion, _ = load_mocap(write_bvh(tmp_path / "a.bvh", [POSE] * 9, rate=120), rig)
    assert motion.frame_count == 5 and motion.rate_hz == 60


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda text: text.replace("LeftForeArm", "Tail"), "no joint called forearm, .* radius, elbow with left or l .* for elbow.L; it has Hips"),
        (lambda text: text.replace("Frames: 2", "Frames: 3"), "frames of shape"),
        (lambda text: text.replace("Frame Time", "Time"), "malformed"),
        (lambda text: text.rstrip()[:-4], "malformed|frames of shape"),
        (lambda text: text.replace(" 95 ", " nan "), "finite"),
        (lambda text: "", "malformed"),
        (lambda text: text.partition("MOTION")[0], "malformed"),
    ],
)
def test_broken_files_are_refused(change, reason, rig, tmp_path):
    """The file is named, and what is wrong with it."""
    path = write_bvh(tmp_path / "a.bvh", [POSE] * 2)
    path.write_text(change(path.read_text()))
    with pytest.raises(MotionError, match=f"a.bvh.*({reason})"):
        load_mocap(path, rig)


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
        frames = [POSE] * 6 + [{**POSE, "LeftArm": (-80, twist, 0), "LeftForeArm": (0, 0, 0)}] * 12
        motion, _ = load_mocap(write_bvh(tmp_path / "a.bvh", frames), rig)
        turned.append(rig.bone_transforms(motion.positions[14])[rig.bone_index("upperarm02.L"), :, :3])
    along = [0, np.cos(np.radians(80)), -np.sin(np.radians(80))]
    twisted = np.degrees(Rotation.from_matrix(turned[1] @ turned[0].T).as_rotvec()) @ along
    assert twisted == pytest.approx(60, abs=15)


def test_daz_names_and_load_motion(tmp_path):
    """The release of the CMU database named like DAZ figures; `load_motion` takes what mocap has by its suffix."""
    path = write_bvh(tmp_path / "wave.bvh", [{"LeftForeArm": (40, 0, 0)}] * 4)
    daz = {"Hips": "hip", "Spine1": "chest", "Head": "head"}
    limbs = {"UpLeg": "Thigh", "Leg": "Shin", "Foot": "Foot", "ForeArm": "ForeArm", "Arm": "Shldr", "Hand": "Hand"}
    for side in ("Left", "Right"):
        daz |= {f"{side}{ours}": side[0].lower() + name for ours, name in limbs.items()}
    text = re.sub(r"(ROOT|JOINT) (\w+)", lambda found: f"{found[1]} {daz[found[2]]}", path.read_text())
    (tmp_path / "daz.bvh").write_text(text)
    one, other = load_motion(path), load_motion(tmp_path / "daz.bvh")
    np.testing.assert_allclose(one.positions, other.positions, atol=1e-6)
    assert np.abs(one.positions[0] - load_body_model().rig.rest).max() > 0.3

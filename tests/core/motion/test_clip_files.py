"""Clips inside glTF, VRMA and SMPL files: the same poses as those of a BVH; bones files, rates, and what is refused."""

from __future__ import annotations

import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest
from core.motion.test_mocap import JOINTS, POSE, write_bvh
from core.rig.test_human_skeleton import NAMINGS, _called, _usual_skeleton
from motion_files import smpl_arrays, write_gltf_clips
from scipy.spatial.transform import Rotation

from physkin_core import MotionError, cli, load_body_model, load_motion
from physkin_core.motion.clip_files import CLIP_SUFFIXES, load_clip
from physkin_core.motion.clip_retargeting import PARTS, find_joints
from physkin_core.motion.pace import doubtful_pace
from physkin_core.motion.source_clip import SourceClip
from physkin_ros.replay.bags import BagWriter, write_motion
from physkin_ros.replay.convert import main as convert

RIG = load_body_model().rig
FRAMES = [
    {**POSE, "LeftForeArm": (0, 0, -90 + 5 * k), "Hips": (0, 2 * k, 90 + k), "position": (9 * k, 95, 7)}
    for k in range(9)
]
HUMANOID = {"Hips": "hips", "Spine1": "chest", "Head": "head"}
for _side in ("Left", "Right"):
    for _part, _bone in (("UpLeg", "UpperLeg"), ("Leg", "LowerLeg"), ("Foot", "Foot")):
        HUMANOID[_side + _part] = _side.lower() + _bone
    for _part, _bone in (("Arm", "UpperArm"), ("ForeArm", "LowerArm"), ("Hand", "Hand")):
        HUMANOID[_side + _part] = _side.lower() + _bone


@pytest.fixture(scope="module")
def expected(tmp_path_factory):
    """Of the BVH."""
    return load_clip(write_bvh(tmp_path_factory.mktemp("bvh") / "a.bvh", FRAMES), RIG)[0]


def assert_same(motion, expected, *, angle=0.01):
    """Within single precision of keys, which the solver's least squares spread."""
    assert motion.rate_hz == expected.rate_hz
    np.testing.assert_allclose(motion.positions, expected.positions, atol=angle)
    np.testing.assert_allclose(motion.root_position, expected.root_position, atol=0.002)
    np.testing.assert_allclose(motion.gravity, expected.gravity, atol=angle)


@pytest.mark.parametrize("how", ["LINEAR", "STEP", "CUBICSPLINE"])
def test_gltf_clips_have_the_poses_of_their_keys(how, expected, tmp_path):
    """However they are interpolated between these."""
    assert_same(load_motion(write_gltf_clips(tmp_path / "a.glb", JOINTS, {"Walk": FRAMES}, how=how)), expected)


@pytest.mark.parametrize(("turn", "scale"), [(-90, 0.01), (0, 1.0)])
def test_rest_is_the_bind_pose(turn, scale, expected, tmp_path):
    """Whatever pose the nodes were left in, and in whichever axes and units the armature is."""
    armature = Rotation.from_euler("x", turn, degrees=True), scale
    path = write_gltf_clips(tmp_path / "a.glb", JOINTS, {"Walk": FRAMES}, armature=armature)
    assert_same(load_motion(path), expected)


def test_few_keys_are_turned_evenly_between(tmp_path):
    """A right angle over a second, of which half is done after half a second, about the joint's axis."""
    ends = [POSE, {**POSE, "LeftForeArm": (0, 0, 0)}]
    sparse = load_motion(write_gltf_clips(tmp_path / "a.glb", JOINTS, {"Bend": ends}, rate=1))
    frames = [{**POSE, "LeftForeArm": (0, 0, -90 + 90 * k / 24)} for k in range(25)]
    dense = load_motion(write_bvh(tmp_path / "a.bvh", frames, rate=24))
    np.testing.assert_allclose(sparse.positions, dense.positions, atol=0.01)


def test_a_pose_is_a_clip_of_one_frame(tmp_path, expected):
    """Of a single key for each joint, as posing tools write it."""
    motion = load_motion(write_gltf_clips(tmp_path / "a.glb", JOINTS, {"Stand": FRAMES[:1]}))
    assert motion.frame_count == 1
    np.testing.assert_allclose(motion.positions[0], expected.positions[0], atol=0.02)


def test_info_tells_of_clips_that_cannot_be_worn(tmp_path, capsys):
    """A clip of a face stands among the others, and none is taken for one of that name."""

    def change(document):
        for channel in document["animations"][1]["channels"]:
            channel["target"] = {"node": 0, "path": "weights"}

    path = write_gltf_clips(tmp_path / "a.glb", JOINTS, {"3": FRAMES, "Smile": FRAMES, "1": FRAMES[:2]}, change=change)
    assert cli.main(["info", f"{path}#3"]) == 0
    first, second, third = capsys.readouterr().out.splitlines()[:3]
    assert f"3: {(len(FRAMES) - 1) / 60 + 1 / 60:.2f} s" in first and "1: 0.03 s" in third
    assert "Smile: animations[1] moves no node" in second


def test_a_rate_in_a_list(tmp_path):
    """Some scripts save it so."""
    np.savez(tmp_path / "a.npz", **smpl_arrays(FRAMES) | {"mocap_framerate": [60.0]})
    assert load_motion(tmp_path / "a.npz").frame_count == len(FRAMES)


def test_a_clip_is_chosen_by_name_or_number(tmp_path, caplog, expected):
    """The first one otherwise, with a word about the others."""
    path = write_gltf_clips(tmp_path / "me.glb", JOINTS, {"Stand": [{}] * 3, "Walk": FRAMES})
    for chosen in (f"{path}#Walk", f"{path}#2"):
        motion = load_motion(chosen)
        assert_same(motion, expected)
        assert motion.name == chosen.partition("#")[2]
    assert caplog.text == ""
    assert load_motion(path).frame_count == 3
    assert "of 2 clips 'Stand' is taken: 'Stand', 'Walk'" in caplog.text
    for other in ("Run", "0", "3"):
        with pytest.raises(MotionError, match=f"it has no clip '{other}'; allowed are 'Stand', 'Walk', or 1 to 2"):
            load_motion(f"{path}#{other}")


def test_a_take_of_one_key_is_passed_over(tmp_path, expected):
    """A T-pose, or the empty `Take 001` of many files, before the motion."""
    path = write_gltf_clips(tmp_path / "me.glb", JOINTS, {"Take 001": [{}], "mixamo.com": FRAMES})
    assert_same(load_motion(path), expected)


def test_clip_names_may_have_any_sign(tmp_path, expected):
    """As do those of files."""
    path = write_gltf_clips(tmp_path / "me#1.glb", JOINTS, {"Stand": [{}] * 3, "Armature|take#2": FRAMES})
    assert_same(load_motion(f"{path}#Armature|take#2"), expected)


ARMATURE = Rotation.identity(), 1.0


def add_camera(document):
    """A clip of a camera, which comes first."""
    document["nodes"].append({"name": "Camera"})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    moved = {"sampler": 0, "target": {"node": len(document["nodes"]) - 1, "path": "translation"}}
    samplers = document["animations"][0]["samplers"][:1]
    document["animations"].insert(0, {"name": "Camera", "channels": [moved], "samplers": samplers})


def test_a_clip_of_a_camera_is_none_of_the_figure(tmp_path, caplog, expected):
    """The first that moves several nodes is taken instead. Chosen, it is refused: the figure would stand still."""
    path = write_gltf_clips(tmp_path / "a.glb", JOINTS, {"Walk": FRAMES}, armature=ARMATURE, change=add_camera)
    assert_same(load_motion(path), expected)
    assert "of 2 clips 'Walk' is taken: 'Camera', 'Walk'" in caplog.text
    with pytest.raises(MotionError, match=r"animations\[0\] moves no node of a figure; choose another clip"):
        load_motion(f"{path}#Camera")


@pytest.mark.parametrize("moves", [0, 1])
def test_of_two_figures_the_one_that_moves_is_read(moves, tmp_path, expected):
    """Both have the same names, and hang on armatures of their own."""

    def add_figure(document):
        count = len(document["nodes"])
        for node in list(document["nodes"]):
            more = {"children": [child + count for child in node["children"]]} if "children" in node else {}
            document["nodes"].append(node | more)
        document["scenes"][0]["nodes"].append(2 * count - 1)
        skin = document["skins"][0]
        document["skins"].append(skin | {"joints": [joint + count for joint in skin["joints"]]})
        for channel in document["animations"][0]["channels"]:
            channel["target"]["node"] += moves * count

    path = write_gltf_clips(tmp_path / "a.glb", JOINTS, {"Walk": FRAMES}, armature=ARMATURE, change=add_figure)
    assert_same(load_motion(path), expected)


def test_vrma_says_which_bone_is_which(tmp_path, expected):
    """Names of nodes mean nothing then."""

    def change(document):
        bones = {HUMANOID[name]: {"node": k} for k, (name, *_) in enumerate(JOINTS)}
        extension = {"specVersion": "1.0", "humanoid": {"humanBones": bones}}
        document |= {"extensionsUsed": ["VRMC_vrm_animation"], "extensions": {"VRMC_vrm_animation": extension}}

    path = tmp_path / "a.vrma"
    write_gltf_clips(path, JOINTS, {"": FRAMES}, renamed=lambda name: f"J{hash(name) % 97}", change=change)
    assert_same(load_motion(path), expected)


def accessor(document, number, **changes):
    document["accessors"][number] |= changes


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda document: document.pop("animations"), "no animation clip"),
        (lambda document: document["animations"][0].update(channels=[]), "moves no node"),
        (
            lambda document: document["animations"][0]["samplers"][1].update(interpolation="CUBIC"),
            "interpolated by 'CUBIC'",
        ),
        (lambda document: document["animations"][0]["channels"][1].update(sampler=99), r"names samplers\[99\]"),
        (lambda document: document["animations"][0]["channels"][1]["target"].update(node=99), r"names nodes\[99\]"),
        (lambda document: accessor(document, 2, count=8), "needs rising times and .9, 1, 4. finite values"),
        (lambda document: document["animations"][0]["samplers"][1].update(input=2), "needs rising times"),
        (lambda document: accessor(document, 2, count=1 << 40), "has more than 16777216 keys"),
    ],
)
def test_broken_gltf_clips_are_refused(change, reason, tmp_path):
    """With what is wrong, and before memory is taken for it."""
    path = write_gltf_clips(tmp_path / "a.glb", JOINTS, {"Walk": FRAMES}, change=change)
    with pytest.raises(MotionError, match=f"a.glb: .*{reason}"):
        load_motion(path)


def test_long_gltf_clips_are_refused(tmp_path):
    """Two keys, a year apart."""
    path = write_gltf_clips(tmp_path / "a.glb", JOINTS, {"Walk": FRAMES[:2]}, rate=1 / 3e7)
    with pytest.raises(MotionError, match="a.glb: it lasts 3e.07 s, allowed are 8333 s"):
        load_motion(path)


def matrices(poses):
    return Rotation.from_rotvec(poses.reshape(-1, 3)).as_matrix().reshape(len(poses), -1, 3, 3)


@pytest.mark.parametrize(
    "change",
    [
        lambda arrays: arrays,
        lambda arrays: arrays | {"poses": arrays["poses"][:, :72]},
        lambda arrays: arrays | {"poses": arrays["poses"].reshape(len(FRAMES), -1, 3)},
        lambda arrays: {
            "global_orient": matrices(arrays["poses"])[:, :1],
            "body_pose": matrices(arrays["poses"])[:, 1:24],
            "transl": arrays["trans"],
            "fps": 60,
        },
        lambda arrays: {
            "root_orient": arrays["poses"][:, :3],
            "pose_body": arrays["poses"][:, 3:66],
            "trans": arrays["trans"],
            "mocap_frame_rate": np.array(60),
        },
    ],
    ids=["SMPL-H", "SMPL", "by joint", "matrices", "SMPL-X"],
)
def test_smpl_clips_need_no_body(change, expected, tmp_path, caplog):
    """Limbs and trunk turn as those of the BVH, but for 4 degrees that the shins of SMPL's rest slant by and as many
    for limbs whose segments have another ratio; how far the root goes depends on the length of legs."""
    path = tmp_path / "a.npz"
    np.savez(path, **change(smpl_arrays(FRAMES, rate=60.0)))
    motion = load_motion(path)
    np.testing.assert_allclose(motion.positions, expected.positions, atol=0.14)
    np.testing.assert_allclose(motion.gravity, expected.gravity, atol=0.01)
    assert caplog.text == ""


def test_smpl_clips_that_stand_along_y(expected, tmp_path, caplog):
    """As those that were made with SMPL itself, not in AMASS; the assumption is told, as is that of the rate."""
    arrays = smpl_arrays(FRAMES, up="Y")
    del arrays["mocap_framerate"]
    np.savez(tmp_path / "a.npz", **arrays)
    motion = load_motion(tmp_path / "a.npz")
    assert "a.npz: up is taken to be Y" in caplog.text and "states no rate: 30 Hz is assumed" in caplog.text
    assert motion.frame_count == 17
    motion = load_motion(tmp_path / "a.npz", source_rate_hz=60)
    np.testing.assert_allclose(motion.gravity, expected.gravity, atol=0.01)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (
            lambda arrays: arrays.pop("poses"),
            "it has 'trans', 'mocap_framerate', 'gender', 'betas'; a clip has poses, or",
        ),
        (lambda arrays: arrays.update(poses=np.array([{}], dtype=object)), "a clip has poses, or"),
        (lambda arrays: arrays.update(poses=np.array([["a"] * 66])), "a clip has poses, or .*, of numbers"),
        (
            lambda arrays: arrays.update(poses=np.zeros((9, 60))),
            "its rotations are .9, 60.; allowed are 66 angles or more",
        ),
        (lambda arrays: arrays.update(poses=np.zeros((0, 156))), "some, and finite"),
        (lambda arrays: arrays.update(poses=np.zeros((9, 24, 4))), "9, 24, 4. are not axes and angles in radians"),
        (lambda arrays: arrays.update(poses=np.degrees(arrays["poses"])), "not axes and angles in radians; convert"),
        (lambda arrays: arrays.update(trans=np.zeros((8, 3))), "must be as many"),
        (lambda arrays: arrays["poses"].fill(np.nan), "finite"),
    ],
)
def test_broken_smpl_clips_are_refused(change, reason, tmp_path):
    """What is no clip."""
    arrays = smpl_arrays(FRAMES)
    change(arrays)
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(MotionError, match=f"a.npz: {reason}|a.npz: .*{reason}"):
        load_motion(tmp_path / "a.npz")


def test_npz_that_promises_more_than_it_has(tmp_path):
    """A shape of terabytes in a file of bytes."""
    np.save(tmp_path / "poses.npy", np.zeros((1, 156)))
    content = (tmp_path / "poses.npy").read_bytes().replace(b"(1, 156), }", b"(99999999, 99999), }")[: 200 + 8 * 156]
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("poses.npy", content)
    with pytest.raises(MotionError, match="a.npz"):
        load_motion(tmp_path / "a.npz")


# --- Names by hand ---


def odd(name):
    """No name tells the left upper arm; another joint has its name."""
    return {"LeftArm": "Lump", "Head": "LeftArm"}.get(name, name)


def test_bones_file_wins(tmp_path, expected):
    """Chosen, or beside the file; what is empty is recognised."""
    path = write_bvh(tmp_path / "a.bvh", FRAMES, renamed=odd)
    file = tmp_path / "names.json"
    file.write_text(json.dumps({"upperarm01.L": "Lump", "head": "LeftArm", "wrist.L": ""}))
    assert_same(load_motion(path, bones=file), expected)
    file.rename(tmp_path / "a.bones.json")
    assert_same(load_motion(path), expected)


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        ('{"upperarm01.L": "LeftArn"}', "a.bvh has no 'LeftArn'; did you mean 'LeftArm'"),
        ('{"upperarm1.L": "LeftArm"}', "the rig has no 'upperarm1.L'; did you mean 'upperarm01.L'"),
        ('{"upperarm01.L": "Spine1", "head": "Spine1"}', "two bones cannot both be 'Spine1'"),
        ("[]", "it must be a JSON object"),
        ('{"head": 3}', "it must be a JSON object"),
        ("{", "it is not JSON"),
    ],
)
def test_wrong_bones_files_are_refused(content, reason, tmp_path):
    """By name, with the names that are near."""
    path, file = write_bvh(tmp_path / "a.bvh", FRAMES), tmp_path / "b.json"
    file.write_text(content)
    with pytest.raises(MotionError, match=f"a.bvh: bones file .*b.json.*{reason}"):
        load_motion(path, bones=file)


def test_refusals_begin_a_bones_file(tmp_path):
    """`physkin info` has all of it."""
    path = write_bvh(tmp_path / "a.bvh", FRAMES, renamed=lambda name: name.replace("LeftHand", "Neck"))
    with pytest.raises(MotionError, match='--bones: {"upperarm01.L": "'):
        load_motion(path)


@pytest.mark.parametrize("naming", NAMINGS)
def test_every_naming_is_known_in_motion(naming):
    """All names that avatars may have."""
    called, (bones, parents, heads) = _called(naming), _usual_skeleton()
    names = tuple(called.get(bone, f"helper {k}") for k, bone in enumerate(bones))
    still = np.tile([0.0, 0.0, 0.0, 1.0], (1, len(names), 1))
    joints, remarks = find_joints(SourceClip(names, parents, heads, still, heads[None], 60.0))
    assert remarks == ()
    for part, bone in PARTS.items():
        for side in "LR":
            assert names[joints[f"{part}.{side}"]] == called[f"{bone}.{side}"]
    assert names[joints["neck"]] in (called["head"], called.get("neck01"))


TOOLS = {
    "{}_jnt": lambda name: f"{name}_jnt",
    "SK_Hero_{}": lambda name: f"SK_Hero_{name}",
    "upper case": str.upper,
    "lf_, rt_": lambda name: name.replace("Left", "lf_").replace("Right", "rt_"),
    "full width": lambda name: "".join(chr(ord(letter) + 0xFEE0) for letter in name),
    "Japanese": lambda name: translated(name, "センター 上半身 頭 腕 ひじ 手首 足 ひざ 足首", "左右"),
    "Chinese": lambda name: translated(name, "骨盆 脊柱 头 上臂 前臂 手 大腿 小腿 脚", "左右"),
}


def translated(name, words, sides):
    parts = ("Hips", "Spine1", "Head", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")
    side = sides[0] if name.startswith("Left") else sides[1] if name.startswith("Right") else ""
    return side + dict(zip(parts, words.split()))[name.removeprefix("Left").removeprefix("Right")]


@pytest.mark.parametrize("tool", TOOLS)
def test_names_tell_joints_of_a_rest_that_is_not_symmetric(tool, expected, tmp_path, caplog):
    """Place alone does not; what a tool says of every joint, letters' width and case are no part of a name."""
    joints = [
        (name, parent, tuple(Rotation.from_euler("z", 60 * (name[:4] == "Left"), degrees=True).apply(offset)))
        if "Arm" in name or "Hand" in name
        else (name, parent, offset)
        for name, parent, offset in JOINTS
    ]
    plain = load_motion(write_bvh(tmp_path / "a.bvh", FRAMES, joints=joints))
    caplog.clear()
    read = load_motion(write_bvh(tmp_path / "b.bvh", FRAMES, joints=joints, renamed=TOOLS[tool]))
    np.testing.assert_array_equal(read.positions, plain.positions)
    assert caplog.text == ""


def test_a_body_without_a_head_is_read(tmp_path):
    """Its chest tells where up is."""
    frames = [{**frame, "Head": (0, 0, 0)} for frame in FRAMES]
    plain = load_motion(write_bvh(tmp_path / "a.bvh", frames))
    bare = [joint for joint in JOINTS if joint[0] != "Head"]
    read = load_motion(write_bvh(tmp_path / "b.bvh", frames, joints=bare))
    assert_same(read, plain)


# --- Rates ---


def walk(rate):
    """The bundled walk as if it had that rate."""
    motion = load_motion("walk")
    return type(motion)(motion.joint_names, motion.positions, motion.root_orientation, motion.root_position, rate)


def test_source_rate_is_of_every_clip(tmp_path):
    """Not only of an AMC; what has its own times refuses it, whatever is given, as do wrong rates."""
    path = write_bvh(tmp_path / "a.bvh", [POSE] * 31, rate=60)
    assert load_motion(path, source_rate_hz=30).frame_count == 61
    assert convert([str(path), str(tmp_path / "out"), "--source-rate", "30", "--world-frame", ""]) == 0
    assert load_motion(tmp_path / "out").frame_count == 61
    with pytest.raises(MotionError, match="source_rate_hz is for clips of .*walk has its own times"):
        load_motion("walk", source_rate_hz=30)
    with pytest.raises(MotionError, match="bones are for files of others"):
        load_motion("walk", bones=path)
    for wrong in (0.0, -1.0, np.inf, np.nan):
        with pytest.raises(MotionError, match="source_rate_hz must be positive and finite"):
            load_motion(path, source_rate_hz=wrong)


@pytest.mark.parametrize(("rate", "pace"), [(60, ""), (50, ""), (90, ""), (24, "slow"), (240, "fast")])
def test_steps_tell_a_wrong_rate(rate, pace):
    """60 Hz that a file says are 24, or 240; not a slow or a brisk walk."""
    assert (
        (f"too {pace} for a person" in doubtful_pace(walk(rate), RIG)) if pace else doubtful_pace(walk(rate), RIG) == ""
    )


@pytest.mark.parametrize("clip", ["cartwheel", "crawl", "dance", "jump", "kick", "run"])
def test_no_bundled_clip_is_in_doubt(clip):
    """Steps of a dance are not those of a walk."""
    assert doubtful_pace(load_motion(clip), RIG) == ""


def test_suffixes_are_listed_where_a_name_is_unknown():
    """All that can be read."""
    with pytest.raises(MotionError, match="no bundled motion 'x.c3d'") as error:
        load_motion("x.c3d")
    assert all(suffix in str(error.value) for suffix in CLIP_SUFFIXES)


def test_info_lists_clips_and_bones(tmp_path, capsys):
    """Seconds and rates, and a bones file to be completed."""
    path = write_gltf_clips(tmp_path / "me.glb", JOINTS, {"Stand": [{}] * 31, "Walk": FRAMES}, rate=30)
    assert cli.main(["info", str(path)]) == 0
    said = capsys.readouterr().out
    assert "Stand: 1.03 s at 30 Hz, 15 joints" in said and "Walk: 0.30 s at 30 Hz" in said
    assert '"upperarm01.L": "LeftArm"' in said


def test_one_bones_file_names_joints_of_bags(tmp_path):
    """Joints of the rig, whatever a robot calls them."""
    walk_of_robot = load_motion("walk")
    names = tuple({"lowerarm01.L_z": "left_elbow"}.get(name, name) for name in walk_of_robot.joint_names)
    with BagWriter(tmp_path / "bag") as writer:
        write_motion(writer, replace(walk_of_robot, joint_names=names), frame_id="base_link", world_frame="world")
    file = tmp_path / "b.json"
    file.write_text('{"lowerarm01.L_z": "left_elbow"}')
    read = load_motion(tmp_path / "bag", bones=file)
    assert set(read.joint_names) == set(RIG.joint_names)
    file.write_text('{"lowerarm01.L_z": "left_elbo"}')
    with pytest.raises(MotionError, match="b.json: bag has no 'left_elbo'; did you mean 'left_elbow'"):
        load_motion(tmp_path / "bag", bones=file)

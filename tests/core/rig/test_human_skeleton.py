"""Skeletons of the namings that tools use, and of none: each joint is recognised, or refused where that is a guess."""

import json
from pathlib import Path

import numpy as np
import pytest
from gltf_person import BODY, RIG, skeleton_of, t_posed_body, with_ends

from physkin_core.rig.human_skeleton import find_human_skeleton
from physkin_core.rig.vrm_bones import HUMANOID_BONES

LIMB_BONES = ("clavicle", "upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot")
NAMINGS = json.loads(Path(__file__).with_name("namings.json").read_text())
"""By tool: pattern of a limb's joints ({S}: side, {N}: name), names of LIMB_BONES, "-" where there is none, sides,
pattern of the trunk's joints, their names from hips to head, and names of toe, finger and a joint of the upper arm."""


def _usual_skeleton(*, fingers=5, toes=1, twist=True, armature=False, hand_ends=False):
    """Names, parents and heads (j, 3), X left, Y up, Z forward, of a skeleton as animation tools make it, in T-pose."""
    joints = []

    def add(name, parent, *head):
        joints.append((name, parent, head))
        return len(joints) - 1

    above = add("Armature", -1, 0, 0, 0) if armature else -1
    hips = chest = add("root", above, 0, 1.0, 0)
    for bone, height in (("spine04", 1.1), ("spine02", 1.22), ("spine01", 1.34)):
        chest = add(bone, chest, 0, height, -0.01)
    head = add("head", add("neck01", chest, 0, 1.48, 0), 0, 1.56, 0.02)
    add("crown", head, 0, 1.76, 0.03)
    for side, x in (("L", 1), ("R", -1)):
        add("eye", head, 0.03 * x, 1.62, 0.1)
        arm = add(f"upperarm01.{side}", add(f"clavicle.{side}", chest, 0.05 * x, 1.42, 0), 0.17 * x, 1.43, -0.02)
        elbow = add(f"lowerarm01.{side}", arm, 0.45 * x, 1.43, -0.02)
        wrist = add(f"wrist.{side}", elbow, 0.71 * x, 1.43, -0.02)
        for finger in range(fingers):
            joint = wrist
            for k in range(3):
                joint = add(f"finger.{side}", joint, (0.8 + 0.03 * k) * x, 1.43, 0.02 * finger - 0.05)
        if hand_ends:
            add("end", wrist, 0.89 * x, 1.43, -0.02)
        thigh = add(f"upperleg01.{side}", hips, 0.09 * x, 0.94, 0)
        joint = add(f"foot.{side}", add(f"lowerleg01.{side}", thigh, 0.09 * x, 0.5, 0.01), 0.09 * x, 0.1, -0.03)
        for toe in range(toes):
            joint = add(f"toe.{side}", joint, 0.1 * x, 0.02, 0.09 + 0.07 * toe)
        if twist:
            add(f"twist.{side}", arm, 0.3 * x, 1.43, -0.02)
            for parent, *place in ((elbow, 0.6, 1.43, -0.02), (thigh, 0.09, 0.7, 0)):
                add("divides", parent, place[0] * x, *place[1:])
    names, parents, heads = zip(*joints)
    return names, np.array(parents), np.array(heads, dtype=np.float64)


def _called(naming):
    """Name by bone of the usual skeleton."""
    of = NAMINGS[naming]
    parts = dict(zip((*LIMB_BONES, "toe", "finger", "twist"), of["limb names"] + of["others"], strict=True))
    called = {}
    for side, its in zip("LR", of["sides"]):
        called |= {f"{part}.{side}": (of["limbs"], name, its) for part, name in parts.items()}
    middle = ("root", "spine04", "spine02", "spine01", "neck01", "head")
    called |= {bone: (of["trunk"], name, "") for bone, name in zip(middle, of["trunk names"], strict=True)}
    return {bone: form.format(N=name, S=side) for bone, (form, name, side) in called.items() if name != "-"}


@pytest.mark.parametrize("naming", NAMINGS)
def test_namings(naming):
    """In any pose: turned at random about each joint, the names and lengths are the same. Joints without a name in a
    naming are helpers, none of which is taken for a bone of a limb."""
    called, (bones, parents, heads) = _called(naming), _usual_skeleton()
    names = [called.get(bone, f"helper {k}") for k, bone in enumerate(bones)]
    wanted = {bone: name for bone, name in called.items() if bone in RIG.bone_names and not bone.startswith("spine")}
    rng = np.random.default_rng(0)
    posed = heads.copy()
    for joint, parent in enumerate(parents):
        offset = rng.normal(size=3)
        if parent >= 0:
            length = np.linalg.norm(heads[joint] - heads[parent])
            posed[joint] = posed[parent] + length * offset / np.linalg.norm(offset)
    for places in (heads, posed):
        found = find_human_skeleton(names, parents, places, RIG)
        assert {bone: names[found.joints[bone]] for bone in wanted} == wanted
        assert found.missing == () and found.remarks(names) == ()
    spine = [found.joints[bone] for bone in ("spine04", "spine02", "spine01") if bone in found.joints]
    assert spine == sorted(spine)


def _by_shape(heads, parents):
    """What is found of a skeleton whose joints have no names."""
    return find_human_skeleton([f"Bone.{k:03d}" for k in range(len(heads))], parents, heads, RIG)


@pytest.mark.parametrize("whole_rig", [False, True])
@pytest.mark.parametrize("ends", [False, True])
@pytest.mark.parametrize("t_pose", [False, True])
def test_nameless_joints_of_several_people(t_pose, ends, whole_rig):
    """Limbs in A- and T-pose, with and without fingers, toes and joints that divide limbs."""
    for coefficients in BODY.held_out_bodies[:4]:
        heads = t_posed_body(BODY, coefficients)[1] if t_pose else BODY.bones(coefficients)[0].astype(np.float64)
        bones, parents, heads = skeleton_of(RIG.bone_names if whole_rig else HUMANOID_BONES.values(), heads)
        if ends:
            parents, heads = with_ends(bones, parents, heads)
        found = _by_shape(heads, parents).joints
        for bone in [f"{bone}.{side}" for bone in LIMB_BONES[1:] for side in "LR"]:
            assert bones[found[bone]] == RIG.bone_index(bone), bone
        assert RIG.bone_names[bones[found["neck01"]]].startswith("neck")


@pytest.mark.parametrize("axes", [[0, 1, 2], [2, 0, 1]])
@pytest.mark.parametrize("toes", [0, 1, 2])
@pytest.mark.parametrize("fingers", [0, 5])
def test_nameless_joints_of_usual_skeletons(axes, toes, fingers):
    """With and without fingers, toes, twist joints, ends of hands and a node above the hips; Y up and Z up."""
    for more in ((), ("twist",), ("armature",), ("hand_ends",), ("twist", "hand_ends")):
        options = {name: name in more for name in ("twist", "armature", "hand_ends")}
        names, parents, heads = _usual_skeleton(fingers=fingers, toes=toes, **options)
        found = _by_shape(heads[:, axes], parents).joints
        expected = {name: name for name in names if name in RIG.bone_names and not name.startswith("spine")}
        assert {bone: names[found[bone]] for bone in expected} == expected


def test_left_is_where_toes_or_knees_and_elbows_say():
    """Of a skeleton that looks backwards, which no name tells; a doubt, if limbs are straight and have no toes."""
    bones, parents, heads = skeleton_of(HUMANOID_BONES.values(), BODY.bones(BODY.held_out_bodies[0])[0].astype(float))
    for joints, places in ((parents, heads), with_ends(bones, parents, heads)):
        found = _by_shape(places * [-1.0, -1.0, 1.0], joints)
        assert bones[found.joints["wrist.L"]] == RIG.bone_index("wrist.L") and found.doubt == ""
    straight = t_posed_body(BODY, BODY.held_out_bodies[0])[1][bones]
    assert "left and right are a guess" in _by_shape(straight, parents).remarks([""] * len(bones))[1]


def test_sides_that_names_tell_of_arms_only():
    """Legs whose names say no side are the arms' way round; where none do, toes tell."""
    bones, parents, heads = _usual_skeleton(fingers=0, twist=False)
    parts = {
        "upperleg01": "Thigh",
        "lowerleg01": "Shin",
        "foot": "Foot",
        "upperarm01": "UpperArm",
        "lowerarm01": "Elbow",
    }
    for sided in (("upperarm01", "lowerarm01", "wrist"), ()):
        names = [parts.get(bone[:-2], "") + (f" {bone[-1]}" if bone[:-2] in sided else "") for bone in bones]
        found = find_human_skeleton(names, parents, heads[:, [2, 0, 1]] * [-1, -1, 1], RIG)
        assert {bone: bones[joint] for bone, joint in found.joints.items() if bone[:-2] in parts} == {
            bone: bone for bone in bones if bone[:-2] in parts
        }


def test_what_is_no_person():
    """A chain, a star, a single place, a lopsided and a crooked body are not guessed at."""
    heads = np.arange(30.0).reshape(-1, 3)
    for parents, places in (
        (np.arange(-1, 9), heads),
        (np.array([-1] + [0] * 9), heads),
        (np.arange(-1, 9), 0 * heads),
    ):
        assert _by_shape(places, parents).joints == {}
    rest = BODY.bones(BODY.held_out_bodies[0])[0].astype(np.float64)
    bones, parents, lopsided = skeleton_of(HUMANOID_BONES.values(), rest)
    for bone in ("wrist.L", "foot.L"):
        lopsided[bones.index(RIG.bone_index(bone))] += [0.5, 0, 0.4]
    assert _by_shape(lopsided, parents).joints == {}
    crooked = rest + np.array([0, 0, 1.0]) * (np.arange(RIG.bone_count) % 3)[:, None]
    assert len(_by_shape(crooked, RIG.parents).missing) == 12


def test_names_that_contradict_the_hierarchy_are_refused():
    """A forearm that no upper arm carries; an elbow that is called a head; a shin that is taken for no foot."""
    bones, parents, heads = _usual_skeleton(fingers=0, twist=False)
    astray = parents.copy()
    astray[bones.index("lowerarm01.L")] = bones.index("spine01")
    called = _called("Mixamo")
    names = [called.get(bone, bone) for bone in bones]
    refused = find_human_skeleton(names, astray, heads, RIG)
    assert refused.missing == ("upperarm01.L", "lowerarm01.L", "wrist.L")
    assert "'mixamorig:LeftArm', 'mixamorig:LeftForeArm' and 10 more" in refused.refusal(names, RIG)
    for bone, missing in (("lowerarm01.L", ("upperarm01.L", "lowerarm01.L", "wrist.L")), ("foot.L", ("foot.L",))):
        named = list(names)
        named[bones.index(bone)] = "mixamorig:LeftHead"
        assert find_human_skeleton(named, parents, heads, RIG).missing == missing


def test_limbs_whose_joints_are_counted():
    """Names that tell limb and side alone, in a pose without symmetry: lengths and order tell the rest. A hand that is
    called the other leg's is none."""
    bones, parents, heads = _usual_skeleton(twist=False, fingers=0)
    limb = {"arm": ("upperarm01", "lowerarm01", "wrist"), "leg": ("upperleg01", "lowerleg01", "foot")}
    called = {
        f"{bone}.{s}": f"{kind}_joint_{s}__{k}_"
        for kind, own in limb.items()
        for k, bone in enumerate(own)
        for s in "LR"
    }
    heads[bones.index("foot.L")] += [0, 0.2, -0.35]
    names = [called.get(bone, f"j{k}") for k, bone in enumerate(bones)]
    found = find_human_skeleton(names, parents, heads, RIG)
    assert {bone: names[found.joints[bone]] for bone in called} == called
    assert "'arm_joint_L__0_' for upperarm01.L, " in found.remarks(names)[0]
    names[bones.index("wrist.L")] = "leg_joint_R_9"
    assert "wrist.L" in find_human_skeleton(names, parents, heads, RIG).missing


def test_many_joints_take_bounded_time():
    """A thousand in a chain, and of random parents, each named for a limb: no skeleton, and no hour."""
    rng = np.random.default_rng(0)
    scattered = np.array([-1, *(int(rng.integers(0, k)) for k in range(1, 1000))])
    for parents, name in ((np.arange(-1, 999), ""), (scattered, "arm L ")):
        names = [f"{name}{k}" for k in range(1000)]
        assert find_human_skeleton(names, parents, rng.normal(size=(1000, 3)), RIG).missing

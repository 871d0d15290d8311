"""Skeletons of the namings that tools use, and of none: every bone is found, and the person is the same."""

import numpy as np
import pytest
from gltf_person import BODY, PERSON, RIG, distances, load_document, person_document

from physkin_core.avatar.avatar import AvatarError
from physkin_core.rig.human_skeleton import find_human_skeleton
from physkin_core.rig.vrm_bones import HUMANOID_BONES
from physkin_prepare.avatar import t_posed_body

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, which `Avatar.warnings` keeps
LIMB_BONES = ("clavicle", "upperarm01", "lowerarm01", "wrist", "upperleg01", "lowerleg01", "foot")


def _sided(pattern, names, left, right):
    """Limb joints by rig bone: `pattern` with the name of each of LIMB_BONES, and each side."""
    sides = (("L", left), ("R", right))
    return {f"{bone}.{s}": pattern.format(name, side) for s, side in sides for bone, name in zip(LIMB_BONES, names)}


TRUNK = {"root": "Hips", "spine04": "Spine", "spine02": "Spine1", "spine01": "Spine2", "neck01": "Neck", "head": "Head"}
MIXAMO = ("Shoulder", "Arm", "ForeArm", "Hand", "UpLeg", "Leg", "Foot")
CMU_TRUNK = TRUNK | {"spine04": "LowerBack", "spine02": "Spine", "spine01": "Spine1"}
UNREAL = ("clavicle", "upperarm", "lowerarm", "hand", "thigh", "calf", "foot")
UNREAL_TRUNK = {"root": "pelvis", "spine04": "spine_01", "spine02": "spine_02", "spine01": "spine_03"}
RIGIFY = ("shoulder", "upper_arm", "forearm", "hand", "thigh", "shin", "foot")
RIGIFY_TRUNK = {"root": "spine", "spine04": "spine.001", "spine02": "spine.002", "spine01": "spine.003"}
BIPED = ("Clavicle", "UpperArm", "Forearm", "Hand", "Thigh", "Calf", "Foot")
SMPL = ("Collar", "Shoulder", "Elbow", "Wrist", "Hip", "Knee", "Ankle")
SMPL_TRUNK = {"root": "Pelvis", "spine04": "Spine1", "spine02": "Spine2", "spine01": "Spine3"}
VRM = ("Shoulder", "UpperArm", "LowerArm", "Hand", "UpperLeg", "LowerLeg", "Foot")
SOMA = ("Shoulder", "Arm", "ForeArm", "Hand", "Leg", "Shin", "Foot")
SOMA_TRUNK = {"root": "Hips", "spine04": "Spine1", "spine02": "Spine2", "spine01": "Chest", "neck01": "Neck1"}
PART_FIRST = ("shoulder", "arm_upper", "arm_lower", "arm_hand", "leg_upper", "leg_lower", "leg_foot")
DAZ = ("Collar", "ShldrBend", "ForearmBend", "Hand", "ThighBend", "Shin", "Foot")


def _prefixed(prefix, names):
    return {bone: prefix + name for bone, name in names.items()}


NAMINGS = {
    "mixamo": _prefixed("mixamorig:", TRUNK | _sided("{1}{0}", MIXAMO, "Left", "Right")),
    "mixamo numbered": _prefixed("mixamorig7:", TRUNK | _sided("{1}{0}", MIXAMO, "Left", "Right")),
    "mixamo sanitised": _prefixed("mixamorig", TRUNK | _sided("{1}{0}", MIXAMO, "Left", "Right")),
    "Ready Player Me": TRUNK | _sided("{1}{0}", MIXAMO, "Left", "Right"),
    "CMU": CMU_TRUNK | _sided("{1}{0}", MIXAMO, "Left", "Right"),
    "Unreal": UNREAL_TRUNK | _sided("{}_{}", UNREAL, "l", "r"),
    "Unreal, numbered by an exporter": {
        bone: f"{name}_{k:02d}" for k, (bone, name) in enumerate(_sided("{}_{}", UNREAL, "l", "r").items())
    },
    "Rigify": _prefixed("DEF-", RIGIFY_TRUNK | _sided("{}.{}", RIGIFY, "L", "R")),
    "Rigify sanitised": _prefixed("DEF-", RIGIFY_TRUNK | _sided("{}{}", RIGIFY, "L", "R")),
    "Blender": _sided("{}.{}", VRM, "L", "R"),
    "the limb first": _sided("{}.{}", PART_FIRST, "l", "r"),
    "Blender words": _sided("{1} {0}", RIGIFY, "left", "right"),
    "3ds Max Biped": _prefixed("Bip01 ", {"root": "Pelvis", "spine04": "Spine"} | _sided("{1} {0}", BIPED, "L", "R")),
    "Character Creator": _prefixed("CC_Base_", _sided("{1}_{0}", BIPED, "L", "R")),
    "DAZ": _sided("{1}{0}", DAZ, "l", "r"),
    "SOMA": SOMA_TRUNK | _sided("{1}{0}", SOMA, "Left", "Right"),
    "SMPL": SMPL_TRUNK | _sided("{1}_{0}", SMPL, "L", "R"),
    "SMPL in FBX": _prefixed("m_avg_", SMPL_TRUNK | _sided("{1}_{0}", SMPL, "L", "R")),
    "SMPL-X": _sided("{1}_{0}", [name.lower() for name in SMPL], "left", "right"),
    "VRM names": _sided("{1}{0}", VRM, "left", "right"),
    "VRoid": _prefixed("J_Bip_", {"root": "C_Hips", "spine04": "C_Spine"} | _sided("{1}_{0}", VRM, "L", "R")),
}


@pytest.mark.parametrize("names", NAMINGS.values(), ids=NAMINGS)
def test_namings(tmp_path, names):
    """The rig's other joints are helpers that no naming knows."""
    joint_names = [names.get(bone, f"helper {k}") for k, bone in enumerate(RIG.bone_names)]
    avatar = load_document(tmp_path, person_document(joint_names=joint_names))
    assert distances(avatar.vertices, PERSON.vertices).mean() < 3
    heads = distances(avatar.bone_heads, PERSON.bone_heads)
    assert heads.max() < 20 and max(heads[RIG.bone_index(bone)] for bone in names if bone != "root") < 4
    assert avatar.warnings == ()


def _by_shape(heads, parents):
    """Joint by rig bone of a skeleton whose joints have no names."""
    return find_human_skeleton([f"Bone.{k:03d}" for k in range(len(heads))], parents, heads, RIG).joints


def _vrm_skeleton(heads):
    """Joints of the bones that a VRM has: as `_skeleton_of`."""
    return _skeleton_of(HUMANOID_BONES.values(), heads)


def _skeleton_of(bones, heads):
    """Joints of some bones: index in the rig, parents, heads (j, 3)."""
    bones = sorted({RIG.bone_index(bone) for bone in bones})
    parents = []
    for bone in bones:
        above = RIG.parents[bone]
        while above >= 0 and above not in bones:
            above = RIG.parents[above]
        parents.append(bones.index(above) if above >= 0 else -1)
    return bones, np.array(parents), heads[bones]


def _with_ends(bones, parents, heads):
    """Toes, and five fingers a hand, as joints of their own."""
    for side, way in (("L", 1.0), ("R", -1.0)):
        foot, wrist = (bones.index(RIG.bone_index(f"{bone}.{side}")) for bone in ("foot", "wrist"))
        more = [heads[foot] + [0.14, 0, -0.05]] + [heads[wrist] + [0.02 * k - 0.04, way * 0.09, 0] for k in range(5)]
        parents = np.concatenate([parents, [foot], [wrist] * 5])
        heads = np.concatenate([heads, more])
    return parents, heads


@pytest.mark.parametrize("whole_rig", [False, True])
@pytest.mark.parametrize("ends", [False, True])
@pytest.mark.parametrize("t_pose", [False, True])
@pytest.mark.parametrize("body", range(4))
def test_bones_by_shape(body, t_pose, ends, whole_rig):
    """Limbs of several people, in A- and T-pose, with and without fingers, toes and joints that divide limbs."""
    coefficients = BODY.held_out_bodies[body]
    heads = t_posed_body(BODY, coefficients)[1] if t_pose else BODY.bones(coefficients)[0].astype(np.float64)
    bones, parents = list(range(RIG.bone_count)), RIG.parents
    if not whole_rig:
        bones, parents, heads = _vrm_skeleton(heads)
    if ends:
        parents, heads = _with_ends(bones, parents, heads)
    found = _by_shape(heads, parents)
    for side in "LR":
        for bone in LIMB_BONES[1:]:
            assert bones[found[f"{bone}.{side}"]] == RIG.bone_index(f"{bone}.{side}"), f"{bone}.{side}"
    assert RIG.bone_names[bones[found["neck01"]]].startswith("neck")


def _usual_skeleton(*, fingers, toes, twist, armature, hand_ends):
    """Names, parents and heads (j, 3), X left, Y up, Z forward, of a skeleton as animation tools make it, in T-pose."""
    joints = []

    def add(name, parent, *head):
        joints.append((name, parent, head))
        return len(joints) - 1

    above = add("Armature", -1, 0, 0, 0) if armature else -1
    hips = chest = add("root", above, 0, 1.0, 0)
    for height in (1.1, 1.22, 1.34):
        chest = add("spine", chest, 0, height, -0.01)
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
                joint = add("finger", joint, (0.8 + 0.03 * k) * x, 1.43, 0.02 * finger - 0.05)
        if hand_ends:
            add("end", wrist, 0.89 * x, 1.43, -0.02)
        thigh = add(f"upperleg01.{side}", hips, 0.09 * x, 0.94, 0)
        joint = add(f"foot.{side}", add(f"lowerleg01.{side}", thigh, 0.09 * x, 0.5, 0.01), 0.09 * x, 0.1, -0.03)
        for toe in range(toes):
            joint = add("toe", joint, 0.1 * x, 0.02, 0.09 + 0.07 * toe)
        if twist:
            for parent, *place in ((arm, 0.3, 1.43, -0.02), (elbow, 0.6, 1.43, -0.02), (thigh, 0.09, 0.7, 0)):
                add("twist", parent, place[0] * x, *place[1:])
    names, parents, heads = zip(*joints)
    return names, np.array(parents), np.array(heads, dtype=np.float64)


@pytest.mark.parametrize("axes", [[0, 1, 2], [2, 0, 1]])
@pytest.mark.parametrize("toes", [0, 1, 2])
@pytest.mark.parametrize("fingers", [0, 5])
@pytest.mark.parametrize("more", [(), ("twist",), ("armature",), ("hand_ends",), ("twist", "hand_ends")])
def test_usual_skeletons_by_shape(axes, toes, fingers, more):
    """With and without fingers, toes, twist joints, ends of hands and a node above the hips; Y up and Z up."""
    options = {name: name in more for name in ("twist", "armature", "hand_ends")}
    names, parents, heads = _usual_skeleton(fingers=fingers, toes=toes, **options)
    found = _by_shape(heads[:, axes], parents)
    expected = {name for name in names if name in RIG.bone_names}
    assert {bone: names[joint] for bone, joint in found.items() if bone in expected} == {
        bone: bone for bone in expected
    }


@pytest.mark.parametrize("turned", [False, True])
def test_an_avatar_with_nameless_joints(tmp_path, turned):
    """Toes tell which way it looks; the warning names the joints that were taken."""
    bones, parents, heads = _vrm_skeleton(PERSON.bone_heads.astype(np.float64))
    parents, heads = _with_ends(bones, parents, heads)
    turn = np.array([-1.0, -1.0, 1.0]) if turned else np.ones(3)
    names = [f"Bone.{k:03d}" for k in range(len(heads))]
    builder = _person_on(bones, parents, heads * turn, names, vertices=PERSON.vertices * turn)
    avatar = load_document(tmp_path, builder)
    assert distances(avatar.vertices, PERSON.vertices).mean() < 8  # spine joints only lie somewhere along the rig's
    left_arm = bones.index(RIG.bone_index("upperarm01.L"))
    assert f"'Bone.{left_arm:03d}' for upperarm01.L" in avatar.warnings[0]
    assert len(avatar.warnings) == 1 + turned


def _person_on(bones, parents, heads, names, **changes):
    """The person skinned to joints of some of the rig's bones."""
    owner = np.array([max(k for k, b in enumerate(bones) if b in _line(bone)) for bone in range(RIG.bone_count)])
    return person_document(
        joint_names=names,
        joint_parents=parents,
        joint_heads=heads,
        influence_joints=owner[PERSON.influence_bones],
        **changes,
    )


def _line(bone):
    way = []
    while bone >= 0:
        way.append(bone)
        bone = RIG.parents[bone]
    return way


def test_ends_of_limbs_by_place(tmp_path):
    """A name misspelt and one of the tool's own, at the ends of limbs whose other joints are known."""
    bones, parents, heads = _vrm_skeleton(PERSON.bone_heads.astype(np.float64))
    called = _sided("{}.{}", VRM, "L", "R") | {f"foot.{s}": f"Foor.{s}" for s in "LR"}
    called |= {f"wrist.{s}": f"Paw_0.{s}" for s in "LR"}
    names = [called.get(RIG.bone_names[bone], f"helper {k}") for k, bone in enumerate(bones)]
    avatar = load_document(tmp_path, _person_on(bones, parents, heads, names))
    assert distances(avatar.vertices, PERSON.vertices).mean() < 5
    for bone in ("wrist.L", "foot.L", "wrist.R", "foot.R"):
        assert distances(*(body.bone_heads[RIG.bone_index(bone)] for body in (avatar, PERSON))) < 4
        assert f"{called[bone]!r} for {bone}" in avatar.warnings[0]


def test_what_is_too_near_is_no_end_of_a_limb(tmp_path):
    """A joint that halves a shin is not taken for the ankle that has no joint: that is put where the skin tells."""
    known = [f"{bone}.{side}" for side in "LR" for bone in ("upperarm01", "lowerarm01", "wrist", "upperleg01")]
    known += ["root", "lowerleg01.L", "lowerleg01.R", "lowerleg02.L", "lowerleg02.R"]
    bones, parents, heads = _skeleton_of(known, PERSON.bone_heads.astype(np.float64))
    for side in "LR":
        knee, ankle = (PERSON.bone_heads[RIG.bone_index(f"{bone}.{side}")] for bone in ("lowerleg01", "foot"))
        heads[bones.index(RIG.bone_index(f"lowerleg02.{side}"))] = 0.6 * knee + 0.4 * ankle
    avatar = load_document(tmp_path, _person_on(bones, parents, heads, _vrm_names(bones)))
    assert "the skeleton has no joint for foot.L, foot.R: put where skin says" in avatar.warnings[0]
    _assert_ends_are_near(avatar, "foot")


@pytest.mark.parametrize("turned", [False, True])
def test_a_skeleton_without_hands_and_feet(tmp_path, turned):
    """Forearms and shins carry them; garments bind to joints that nothing hangs on."""
    known = [bone for bone in _sided("{}.{}", VRM, "L", "R") if not bone.startswith(("wrist", "foot"))]
    bones, parents, heads = _skeleton_of([*known, "root", "spine04", "head"], PERSON.bone_heads.astype(np.float64))
    turn = np.array([-1.0, -1.0, 1.0]) if turned else np.ones(3)
    changes = {"vertices": PERSON.vertices * turn}
    avatar = load_document(tmp_path, _person_on(bones, parents, heads * turn, _vrm_names(bones), **changes))
    assert "wrist.L, foot.L, wrist.R, foot.R" in avatar.warnings[0]
    _assert_ends_are_near(avatar, "wrist", "foot")
    carried = np.unique(avatar.influence_bones[avatar.influence_weights > 0])
    assert not {"wrist.L", "foot.R"} & {RIG.bone_names[bone] for bone in carried}


def test_a_limb_without_skin_is_still_refused(tmp_path):
    known = [bone for bone in _sided("{}.{}", VRM, "L", "R") if not bone.startswith("foot")]
    bones, parents, heads = _skeleton_of([*known, "root"], PERSON.bone_heads.astype(np.float64))
    document = {"influence_joints": np.zeros((len(PERSON.vertices), 1), dtype=int)}
    document["influence_weights"] = np.ones((len(PERSON.vertices), 1))
    person = person_document(joint_names=_vrm_names(bones), joint_parents=parents, joint_heads=heads, **document)
    with pytest.raises(AvatarError, match=r"no joint for 2 of the 12 .*: foot\.L, foot\.R;"):
        load_document(tmp_path, person)


def _vrm_names(bones):
    called = _sided("{}.{}", VRM, "L", "R")
    return [called.get(RIG.bone_names[bone], f"helper {k}") for k, bone in enumerate(bones)]


def _assert_ends_are_near(avatar, *ends):
    for bone in (f"{end}.{side}" for end in ends for side in "LR"):
        assert distances(*(body.bone_heads[RIG.bone_index(bone)] for body in (avatar, PERSON))) < 30, bone


@pytest.mark.parametrize("name", ["Torso", "Chest", "Trunk"])
def test_one_joint_of_the_trunk_at_the_hips(tmp_path, name):
    """Whatever it is called: it is no chest, and skin bends with the spine as cloth does."""
    bones, parents, heads = _skeleton_of(
        [*_sided("{}.{}", VRM, "L", "R"), "root", "neck01", "head"], PERSON.bone_heads.astype(np.float64)
    )
    called = _sided("{}.{}", VRM, "L", "R") | {"root": name, "neck01": "Neck", "head": "Head"}
    avatar = load_document(tmp_path, _person_on(bones, parents, heads, [called[RIG.bone_names[b]] for b in bones]))
    spine = [bone for bone, each in enumerate(RIG.bone_names) if each.startswith("spine")]
    assert distances(avatar.bone_heads[spine], PERSON.bone_heads[spine]).max() < 25
    chest = np.linalg.norm(PERSON.vertices - PERSON.bone_heads[RIG.bone_index("spine01")], axis=1) < 0.15
    belly = np.linalg.norm(PERSON.vertices - PERSON.bone_heads[RIG.bone_index("spine04")], axis=1) < 0.12
    carried = [avatar.influence_bones[at, avatar.influence_weights[at].argmax(axis=1)] for at in (chest, belly)]
    usual = [np.bincount(each, minlength=RIG.bone_count)[spine].argmax() for each in carried]
    assert usual[1] < usual[0], "the belly hangs on a lower bone of the spine than the chest"


def _striding_skeleton():
    """The person in a stride: joint names that count along each limb, parents, heads and vertices."""
    called = {"root": "Skeleton_torso_joint_1", "spine02": "Skeleton_torso_joint_2", "spine01": "torso_joint_3"}
    called |= {"neck01": "Skeleton_neck_joint_1", "head": "Skeleton_neck_joint_2"}
    for side in "LR":
        numbers = zip(("upperarm01", "lowerarm01", "wrist"), ("__4_", "__3_", "__2_"))
        called |= {f"{bone}.{side}": f"Skeleton_arm_joint_{side}{number}" for bone, number in numbers}
        legs = enumerate(("upperleg01", "lowerleg01", "foot"), start=1)
        called |= {f"{bone}.{side}": f"leg_joint_{side}_{number}" for number, bone in legs}
    swings = {"upperleg01.L_y": -0.6, "lowerleg01.R_y": 0.8, "upperarm01.R_y": 0.5, "upperleg01.R_y": 0.3}
    transforms = RIG.bone_transforms(RIG.joint_positions(swings), heads=PERSON.bone_heads)
    heads = np.einsum("bij,bj->bi", transforms[..., :3], PERSON.bone_heads) + transforms[..., 3]
    bones, parents, heads = _skeleton_of(called, heads.astype(np.float64))
    return bones, parents, heads, [called[RIG.bone_names[bone]] for bone in bones], PERSON.posed_vertices(transforms)


def test_limbs_whose_joints_are_counted(tmp_path):
    """Names that tell limb and side, in a stride that has no symmetry: the order of joints tells the rest."""
    bones, parents, heads, names, vertices = _striding_skeleton()
    avatar = load_document(tmp_path, _person_on(bones, parents, heads, names, vertices=vertices))
    assert distances(avatar.vertices, PERSON.vertices).mean() < 8
    for bone in [f"{bone}.{side}" for bone in LIMB_BONES[1:] for side in "LR"]:
        assert distances(*(body.bone_heads[RIG.bone_index(bone)] for body in (avatar, PERSON))) < 12, bone
    assert "not by name, these joints were taken: 'Skeleton_arm_joint_L__4_' for" in avatar.warnings[0]


def test_a_refusal_says_what_was_taken_for_what(tmp_path):
    """Bones that are lacking, joints that were recognised and joints that were not, in a sentence."""
    bones, parents, heads, names, vertices = _striding_skeleton()
    names = [name.replace("leg_joint_L", "left thigh").replace("leg_joint_R", "member") for name in names]
    with pytest.raises(AvatarError) as refused:
        load_document(tmp_path, _person_on(bones, parents, heads, names, vertices=vertices))
    said = str(refused.value).split("person.glb: ")[1]
    assert said.startswith(
        "no joint for 6 of the 12 rig bones it must have: upperleg01.L, lowerleg01.L, foot.L and 3 more; "
    )
    assert "taken: 'Skeleton_arm_joint_L__4_'" in said and "Name joints as the rig, Mixamo" in said
    assert len(said) < 300


def test_limbs_that_are_no_chains_are_not_guessed_at():
    """A leg of which the parts are not each other's."""
    _, parents, heads, names, _ = _striding_skeleton()
    assert not find_human_skeleton(names, parents, heads, RIG).missing
    mixed = [name.replace("leg_joint_L_3", "leg_joint_R_9") for name in names]
    assert find_human_skeleton(mixed, parents, heads, RIG).missing == ("foot.L",)


def test_what_is_no_person(tmp_path):
    """A chain, a star, a single place and a lopsided body are not guessed at."""
    heads = np.arange(30.0).reshape(-1, 3)
    assert _by_shape(heads, np.arange(-1, 9)) == {}
    assert _by_shape(heads, np.array([-1] + [0] * 9)) == {}
    assert _by_shape(np.zeros((10, 3)), np.arange(-1, 9)) == {}
    bones, parents, heads = _vrm_skeleton(PERSON.bone_heads.astype(np.float64))
    lopsided = heads.copy()
    lopsided[bones.index(RIG.bone_index("wrist.L"))] += [0.5, 0, 0.4]
    lopsided[bones.index(RIG.bone_index("foot.L"))] += [0.5, 0, 0.4]
    assert _by_shape(lopsided, parents) == {}
    names = [f"Bone.{k}" for k in range(RIG.bone_count)]
    crooked = PERSON.bone_heads + np.array([0, 0, 1.0]) * (np.arange(RIG.bone_count) % 3)[:, None]
    with pytest.raises(AvatarError, match="no joint for 12 of the 12 rig bones it must have"):
        load_document(tmp_path, person_document(joint_names=names, joint_heads=crooked))

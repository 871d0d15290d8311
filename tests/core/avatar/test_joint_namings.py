"""Avatars on skeletons that few names, or none, tell: the person is the same, or the refusal says what is missing."""

import json

import numpy as np
import pytest
from gltf_person import PERSON, RIG, distances, load_document, person_document, skeleton_of, with_ends

from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.formats.gltf_builder import write_glb
from physkin_core.rig.vrm_bones import HUMANOID_BONES

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, which `Avatar.warnings` keeps
HEADS = PERSON.bone_heads.astype(np.float64)
VRM = {bone: name for name, bone in HUMANOID_BONES.items() if bone[-2:] in (".L", ".R")}


@pytest.mark.parametrize("turned", [False, True])
def test_an_avatar_with_nameless_joints(tmp_path, turned):
    """Toes tell which way it looks; the warning names the joints that were taken."""
    bones, parents, heads = skeleton_of(HUMANOID_BONES.values(), HEADS)
    parents, heads = with_ends(bones, parents, heads)
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
    owner = np.array(
        [max(k for k, b in enumerate(bones) if b in RIG.ancestors(bone)) for bone in range(RIG.bone_count)]
    )
    return person_document(
        joint_names=names,
        joint_parents=parents,
        joint_heads=heads,
        influence_joints=owner[PERSON.influence_bones],
        **changes,
    )


def test_ends_of_limbs_by_place(tmp_path):
    """A name misspelt and one of the tool's own, at the ends of limbs whose other joints are known."""
    bones, parents, heads = skeleton_of(HUMANOID_BONES.values(), HEADS)
    called = VRM | {f"foot.{s}": f"Foor.{s}" for s in "LR"}
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
    bones, parents, heads = skeleton_of(known, HEADS)
    for side in "LR":
        knee, ankle = (PERSON.bone_heads[RIG.bone_index(f"{bone}.{side}")] for bone in ("lowerleg01", "foot"))
        heads[bones.index(RIG.bone_index(f"lowerleg02.{side}"))] = 0.6 * knee + 0.4 * ankle
    avatar = load_document(tmp_path, _person_on(bones, parents, heads, _vrm_names(bones)))
    assert "the skeleton has no joint for foot.L, foot.R: put where skin says" in avatar.warnings[0]
    _assert_ends_are_near(avatar, "foot")


@pytest.mark.parametrize("turned", [False, True])
def test_a_skeleton_without_hands_and_feet(tmp_path, turned):
    """Forearms and shins carry them; garments bind to joints that nothing hangs on."""
    known = [bone for bone in VRM if not bone.startswith(("wrist", "foot"))]
    bones, parents, heads = skeleton_of([*known, "root", "spine04", "head"], HEADS)
    turn = np.array([-1.0, -1.0, 1.0]) if turned else np.ones(3)
    changes = {"vertices": PERSON.vertices * turn}
    avatar = load_document(tmp_path, _person_on(bones, parents, heads * turn, _vrm_names(bones), **changes))
    assert "wrist.L, foot.L, wrist.R, foot.R" in avatar.warnings[0]
    _assert_ends_are_near(avatar, "wrist", "foot")
    carried = np.unique(avatar.influence_bones[avatar.influence_weights > 0])
    assert not {"wrist.L", "foot.R"} & {RIG.bone_names[bone] for bone in carried}


def test_a_limb_without_skin_is_still_refused(tmp_path):
    known = [bone for bone in VRM if not bone.startswith("foot")]
    bones, parents, heads = skeleton_of([*known, "root"], HEADS)
    document = {"influence_joints": np.zeros((len(PERSON.vertices), 1), dtype=int)}
    document["influence_weights"] = np.ones((len(PERSON.vertices), 1))
    person = person_document(joint_names=_vrm_names(bones), joint_parents=parents, joint_heads=heads, **document)
    with pytest.raises(AvatarError, match=r"no joint for 2 of the 12 .*: foot\.L, foot\.R;"):
        load_document(tmp_path, person)


def _vrm_names(bones):
    return [VRM.get(RIG.bone_names[bone], f"helper {k}") for k, bone in enumerate(bones)]


def _assert_ends_are_near(avatar, *ends):
    for bone in (f"{end}.{side}" for end in ends for side in "LR"):
        assert distances(*(body.bone_heads[RIG.bone_index(bone)] for body in (avatar, PERSON))) < 30, bone


@pytest.mark.parametrize("name", ["Chest", "Trunk"])
def test_one_joint_of_the_trunk_at_the_hips(tmp_path, name):
    """Whatever it is called: it is no chest, and skin bends with the spine as cloth does."""
    bones, parents, heads = skeleton_of([*VRM, "root", "neck01", "head"], HEADS)
    called = VRM | {"root": name, "neck01": "Neck", "head": "Head"}
    avatar = load_document(tmp_path, _person_on(bones, parents, heads, [called[RIG.bone_names[b]] for b in bones]))
    spine = [bone for bone, each in enumerate(RIG.bone_names) if each.startswith("spine")]
    assert distances(avatar.bone_heads[spine], PERSON.bone_heads[spine]).max() < 25
    chest = np.linalg.norm(PERSON.vertices - PERSON.bone_heads[RIG.bone_index("spine01")], axis=1) < 0.15
    belly = np.linalg.norm(PERSON.vertices - PERSON.bone_heads[RIG.bone_index("spine04")], axis=1) < 0.12
    carried = [avatar.influence_bones[at, avatar.influence_weights[at].argmax(axis=1)] for at in (chest, belly)]
    usual = [np.bincount(each, minlength=RIG.bone_count)[spine].argmax() for each in carried]
    assert usual[1] < usual[0], "the belly hangs on a lower bone of the spine than the chest"


def test_bones_file_wins_over_names(tmp_path):
    """Chosen or beside the avatar: a figure whose left upper arm no name tells, as another joint has its name."""
    builder = person_document()
    for node in builder.document["nodes"]:
        node["name"] = {"upperarm01.L": "Lump", "upperarm02.L": "upperarm01.L"}.get(
            node.get("name"), node.get("name", "")
        )
    write_glb(tmp_path / "me.glb", builder)
    file = tmp_path / "names.json"
    file.write_text(json.dumps({"upperarm01.L": "Lump"}))
    plain = load_avatar(BUNDLED_AVATAR, RIG).bone_heads.shape
    chosen = load_avatar(tmp_path / "me.glb", RIG, bones=file)
    assert distances(chosen.bone_heads, PERSON.bone_heads).max() < 5 and chosen.bone_heads.shape == plain
    file.rename(tmp_path / "me.bones.json")
    np.testing.assert_array_equal(load_avatar(tmp_path / "me.glb", RIG).bone_heads, chosen.bone_heads)
    (tmp_path / "me.bones.json").write_text(json.dumps({"upperarm01.L": "Lumq"}))
    with pytest.raises(
        AvatarError, match="me.glb: bones file .*me.bones.json: me.glb has no 'Lumq'; did you mean 'Lump'"
    ):
        load_avatar(tmp_path / "me.glb", RIG)

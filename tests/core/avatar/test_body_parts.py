"""Which parts of an avatar are its body: by name, and by how much skin there is."""

import numpy as np
import pytest
from gltf_person import PERSON, RIG, add_part, distances, faces_on, load_document, person_document
from scipy.spatial import cKDTree

from physkin_core.avatar.body_parts import ACCESSORY, BODY, CLOTHES, UNKNOWN, kind_of_part
from physkin_core.rig.canonical_pose import LIMB_SEGMENTS

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, which `Avatar.warnings` keeps
TRUNK = [bone for bone, name in enumerate(RIG.bone_names) if not name.split(".")[0].startswith(("upper", "lower"))]
LIMBS = [RIG.bone_index(name) for name in LIMB_SEGMENTS]


@pytest.mark.parametrize(
    ("names", "kind"),
    [
        (["N00_002_03_Tops_01_CLOTH (Instance)", "Body (merged).baked"], CLOTHES),
        (["N00_000_00_Body_00_SKIN (Instance)", "Body"], BODY),
        (["N00_000_00_EyeIris_00_EYE", "Face"], ACCESSORY),
        (["N00_000_00_HairBack_00_HAIR", "Body"], ACCESSORY),
        (["Material.001", "Wolf3D_Outfit_Bottom"], CLOTHES),
        (["Wolf3D_Teeth", "Wolf3D_Teeth"], ACCESSORY),
        (["Wolf3D_Skin", "Wolf3D_Head"], BODY),
        (["eyeLashes01", "Mesh"], ACCESSORY),
        (["Eyelashes"], ACCESSORY),
        (["dresses"], CLOTHES),
        (["Beta_HighLimbsGeoSG2", "Beta_Surface"], UNKNOWN),
        (["topology that caps", "Ch36"], ACCESSORY),
        (["Shape"], UNKNOWN),
        (["joint-l-hip"], ACCESSORY),
        (["helper-skirt"], ACCESSORY),
        (["Beta_Joints"], UNKNOWN),
    ],
)
def test_kinds_by_name(names, kind):
    """Whole words in any spelling; the material's name comes first."""
    assert kind_of_part(names) == kind


def _faces_on(bones):
    strongest = PERSON.influence_bones[np.arange(len(PERSON.vertices)), PERSON.influence_weights.argmax(axis=1)]
    return PERSON.faces[np.isin(strongest, bones)[PERSON.faces].all(axis=1)]


def test_clothes_over_a_body_are_worn_already(tmp_path):
    """A jacket, hair and a part without a telling name, all over skin."""
    builder, jacket = person_document(), faces_on("spine", "root", "clavicle", "upperarm")
    for name in ("Jacket", "Hair", "Ch36"):
        add_part(builder, name, jacket, offset=0.01)
    avatar = load_document(tmp_path, builder)
    np.testing.assert_array_equal(avatar.vertices, load_document(tmp_path, person_document()).vertices)
    (warning,) = avatar.warnings
    shown, worn = "shown, though garments do not heed it: 'Hair'", "worn already: 'Jacket', 'Ch36'"
    assert warning == f"of 4 parts these were taken as the body: 'body'; {worn}; {shown}"
    assert len(avatar.accessories.faces) == len(jacket)
    assert [len(piece.faces) for piece in avatar.clothes] == 2 * [len(jacket)]


def test_accessories_move_with_the_body_in_pictures_alone(tmp_path):
    """Hair, what lies on the head without a telling name, shoes, lashes on cards that one sees through; not lashes on
    others, clear shells and stockings."""
    head, foot = (_faces_on([RIG.bone_index(bone)]) for bone in ("head", "foot.L"))
    leg = _faces_on([RIG.bone_index(f"{bone}.L") for bone in ("lowerleg01", "lowerleg02", "foot")])
    builder = person_document()
    add_part(builder, "Shoes", foot, offset=0.005)
    add_part(builder, "Stockings", leg, offset=0.005)
    for name in ("Hair", "Cube.003", "Eyelashes", "Cornea"):
        add_part(builder, name, head, offset=0.02)
    add_part(builder, "Lashes", head, offset=0.02, material={"name": "FaceEyelash", "alphaMode": "BLEND"})
    avatar = load_document(tmp_path, builder)
    shown = "heed it: 'Shoes', 'Hair', 'Cube.003', 'Lashes/FaceEyelash'"
    assert f"worn already: 'Stockings'; shown, though garments do not {shown}; left out" in avatar.warnings[0]
    assert avatar.warnings[0].endswith("left out: 'Eyelashes', 'Cornea'")
    drawn, count = avatar.with_accessories(), len(avatar.vertices)
    np.testing.assert_array_equal(drawn.faces[: len(avatar.faces)], avatar.faces)
    assert len(drawn.faces) == len(avatar.faces) + len(foot) + 3 * len(head) + len(leg) == len(drawn.file_corners)
    nod = RIG.joint_positions({"head_y": 0.3})
    bones = RIG.bone_transforms(nod, heads=avatar.bone_heads)
    posed = drawn.posed_vertices(bones)
    np.testing.assert_array_equal(posed[:count], avatar.posed_vertices(bones))
    assert distances(posed[count:], drawn.vertices[count:]).mean() > 15
    gaps = [cKDTree(body[:count]).query(body[count:])[0] for body in (drawn.vertices, posed)]
    assert np.abs(gaps[0] - gaps[1]).mean() < 1e-3


def test_joints_between_the_parts_of_a_robot_are_shown(tmp_path):
    """Balls in the gaps of a body whose names say nothing: they are no clothes, and pictures show them."""
    builder = person_document()
    add_part(builder, "Beta_Joints", _faces_on(LIMBS), offset=-0.006)
    builder.document["meshes"][0]["name"] = builder.document["nodes"][-2]["name"] = "Beta_Surface"
    avatar = load_document(tmp_path, builder)
    assert avatar.clothes == () and len(avatar.accessories.faces) == len(_faces_on(LIMBS))
    assert avatar.warnings[0].endswith("do not heed it: 'Beta_Joints'")


def test_clothes_are_the_body_of_what_has_nothing_else(tmp_path):
    """Where all is clothes by name, there is no skin that could be told from them."""
    trunk = _faces_on(TRUNK)
    builder = person_document(faces=_faces_on([bone for bone in range(RIG.bone_count) if bone not in TRUNK]))
    builder.document["meshes"][0]["name"] = builder.document["nodes"][-1]["name"] = "Trousers"
    add_part(builder, "Jacket", trunk)
    avatar = load_document(tmp_path, builder)
    assert len(avatar.faces) > len(trunk) and avatar.clothes == ()
    assert "though by name clothes, as there is too little skin under them" in avatar.warnings[0]


def test_a_body_in_pieces_is_whole(tmp_path):
    """Parts without telling names that fill each other up are all taken, without a word."""
    builder = person_document(faces=PERSON.faces[::2])
    builder.document["meshes"][0]["name"] = builder.document["nodes"][-1]["name"] = "Object_7"
    add_part(builder, "Object_8", PERSON.faces[1::2])
    avatar = load_document(tmp_path, builder)
    assert len(avatar.faces) == len(PERSON.faces) and avatar.warnings == ()


def test_an_avatar_of_hair_is_taken_as_it_is(tmp_path):
    """Where nothing would be left, all is body."""
    builder = person_document(faces=PERSON.faces[::2])
    builder.document["meshes"][0]["name"] = "hair"
    add_part(builder, "hair 2", PERSON.faces[1::2])
    assert len(load_document(tmp_path, builder).faces) == len(PERSON.faces)

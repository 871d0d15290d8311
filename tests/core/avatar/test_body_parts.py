"""Which parts of an avatar are its body: by name, and by how much skin there is."""

import numpy as np
import pytest
from gltf_person import PERSON, RIG, distances, load_document, person_document
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


def _add_part(builder, name, faces, offset=0.0):
    """A mesh of the person's faces, moved along the normals' rough direction, in a node of its own."""
    document, binary = builder.document, builder.document["meshes"][0]["primitives"][0]["attributes"]
    centre = PERSON.vertices[faces].mean(axis=(0, 1))
    moved = PERSON.vertices + offset * np.sign(PERSON.vertices - centre)
    position = builder.add_accessor((moved[:, [1, 2, 0]]).astype(np.float32))
    indices = builder.add_accessor(faces.astype(np.uint16).reshape(-1))
    primitive = {"attributes": {**binary, "POSITION": position}, "indices": indices}
    document["meshes"].append({"name": name, "primitives": [primitive]})
    document["nodes"].append({"name": name, "mesh": len(document["meshes"]) - 1, "skin": 0})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)


def _faces_on(bones):
    strongest = PERSON.influence_bones[np.arange(len(PERSON.vertices)), PERSON.influence_weights.argmax(axis=1)]
    return PERSON.faces[np.isin(strongest, bones)[PERSON.faces].all(axis=1)]


def test_clothes_over_a_body_are_left_out(tmp_path):
    """A jacket, hair and a part without a telling name, all over skin."""
    builder = person_document()
    for name in ("Jacket", "Hair", "Ch36"):
        _add_part(builder, name, _faces_on(TRUNK), offset=0.01)
    avatar = load_document(tmp_path, builder)
    assert avatar.vertices.shape == PERSON.vertices.shape
    (warning,) = avatar.warnings
    shown, left_out = "shown, though garments do not heed it: 'Hair'", "left out: 'Jacket', 'Ch36'"
    assert warning == f"of 4 parts these were taken as the body: 'body'; {shown}; {left_out}"
    assert len(avatar.accessories.faces) == len(_faces_on(TRUNK))


def test_accessories_move_with_the_body_in_pictures_alone(tmp_path):
    """Hair, what lies on the head without a telling name, and shoes; not lashes, stockings and what is clear."""
    head, foot = (_faces_on([RIG.bone_index(bone)]) for bone in ("head", "foot.L"))
    leg = _faces_on([RIG.bone_index(f"{bone}.L") for bone in ("lowerleg01", "lowerleg02", "foot")])
    builder = person_document()
    _add_part(builder, "Shoes", foot, offset=0.005)
    _add_part(builder, "Stockings", leg, offset=0.005)
    for name in ("Hair", "Cube.003", "Eyelashes", "Glasses"):
        _add_part(builder, name, head, offset=0.02)
    builder.document["materials"] = [{"name": "lens", "alphaMode": "BLEND"}]
    builder.document["meshes"][-1]["primitives"][0]["material"] = 0
    avatar = load_document(tmp_path, builder)
    assert "heed it: 'Shoes', 'Hair', 'Cube.003'; left out: 'Stockings', 'Eyelashes'" in avatar.warnings[0]
    drawn, count = avatar.with_accessories(), len(avatar.vertices)
    np.testing.assert_array_equal(drawn.faces[: len(avatar.faces)], avatar.faces)
    assert len(drawn.faces) == len(avatar.faces) + len(foot) + 2 * len(head) == len(drawn.file_corners)
    nod = RIG.joint_positions({"head_y": 0.3})
    bones = RIG.bone_transforms(nod, heads=avatar.bone_heads)
    posed = drawn.posed_vertices(bones)
    np.testing.assert_array_equal(posed[:count], avatar.posed_vertices(bones))
    assert distances(posed[count:], drawn.vertices[count:]).mean() > 20
    gaps = [cKDTree(body[:count]).query(body[count:])[0] for body in (drawn.vertices, posed)]
    assert np.abs(gaps[0] - gaps[1]).mean() < 1e-3


def test_clothes_without_a_body_are_the_body(tmp_path):
    """Where there is no skin beneath, what lies there is kept, and the warning says so."""
    trunk = _faces_on(TRUNK)
    rest = _faces_on([bone for bone in range(RIG.bone_count) if bone not in TRUNK])
    builder = person_document(faces=rest)
    _add_part(builder, "Jacket", trunk)
    avatar = load_document(tmp_path, builder)
    assert len(avatar.faces) == len(rest) + len(trunk)
    assert "('Jacket' though by name clothes, as there is too little skin under them)" in avatar.warnings[0]


def test_a_body_in_pieces_is_whole(tmp_path):
    """Parts without telling names that fill each other up are all taken, without a word."""
    builder = person_document(faces=PERSON.faces[::2])
    builder.document["meshes"][0]["name"] = builder.document["nodes"][-1]["name"] = "Object_7"
    _add_part(builder, "Object_8", PERSON.faces[1::2])
    avatar = load_document(tmp_path, builder)
    assert len(avatar.faces) == len(PERSON.faces) and avatar.warnings == ()


def test_an_avatar_of_hair_is_taken_as_it_is(tmp_path):
    """Where nothing would be left, all is body."""
    builder = person_document(faces=PERSON.faces[::2])
    builder.document["meshes"][0]["name"] = "hair"
    _add_part(builder, "hair 2", PERSON.faces[1::2])
    assert len(load_document(tmp_path, builder).faces) == len(PERSON.faces)

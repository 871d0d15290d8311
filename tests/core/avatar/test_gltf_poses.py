"""The pose that a glTF avatar's body is taken in: that in which it was bound, at any heading and tilt, and not the one
that nodes hold when the file is opened."""

import numpy as np
import pytest
from gltf_person import BODY, PERSON, RIG, distances, load_document, person_document, primitive_of, t_posed_body
from scipy.spatial.transform import Rotation

from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.export.export import main as export
from physkin_core.formats.gltf_builder import write_glb
from physkin_core.formats.gltf_file import GltfFile

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, which `Avatar.warnings` keeps
KICK = {"root": (20, 40, 10), "spine03": (20, 10, 0), "head": (0, 40, 0), "upperleg01.L": (-80, 0, 0)}
KICK |= {"lowerleg01.L": (60, 0, 0), "upperarm01.R": (0, 0, 70)}
EXACT = 0.1
"""[mm] What float32 and rounding leave of a body that is only moved."""


def turned_nodes(builder, turns):
    """Have joints turned about X, Y and Z [degrees], by bone."""
    for bone, angles in turns.items():
        rotation = Rotation.from_euler("xyz", angles, degrees=True).as_quat().tolist()
        builder.document["nodes"][RIG.bone_index(bone)]["rotation"] = rotation
    return builder


def turned_document(angles, **changes):
    """The person turned about the root frame's X, Y and Z [degrees], mesh and joints as one."""
    turn = Rotation.from_euler("xyz", angles, degrees=True)
    vertices, heads = changes.pop("vertices", PERSON.vertices), changes.pop("joint_heads", PERSON.bone_heads)
    return person_document(vertices=turn.apply(vertices), joint_heads=turn.apply(heads), **changes)


def assert_is_the_person(avatar, most=EXACT):
    assert distances(avatar.vertices, PERSON.vertices).max() < most
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < most


@pytest.mark.parametrize(
    "turns", [KICK, {"root": (30, 0, 0)}, {"root": (0, 30, 0)}, {"root": (0, 180, 0)}, {"root": (-90, 0, 0)}]
)
def test_the_bind_pose_counts(tmp_path, turns):
    """However nodes hold root, spine, head and limbs, the body is that of the inverse bind matrices; the file's own
    vertices are where the file shows them."""
    avatar = load_document(tmp_path, turned_nodes(person_document(), turns))
    assert_is_the_person(avatar)
    in_file = avatar.file_vertices @ [[0, 1, 0], [0, 0, 1], [1, 0, 0]]  # glTF's Z is forward, X is left
    assert distances(in_file, PERSON.vertices).max() > 100


def test_a_file_of_our_own_is_read_back(tmp_path):
    """Its root is tilted in the first frame, and its clothes hang on joints of their own."""
    assert export(["dance", "-g", "trousers", "-o", str(tmp_path / "dance.glb"), "--rate", "2"]) == 0
    avatar, shown = load_avatar(tmp_path / "dance.glb", RIG), load_avatar(BUNDLED_AVATAR, RIG)
    assert distances(avatar.bone_heads, shown.bone_heads).max() < EXACT
    assert len(avatar.clothes) > 0 and not any("figures" in warning for warning in avatar.warnings)
    trousers, legs = avatar.clothes[0].vertices, avatar.bone_heads[RIG.bone_index("foot.L")]
    assert trousers[:, 2].min() == pytest.approx(legs[2], abs=0.1), "they hang, though the file shows a dancer"
    assert np.abs(trousers[:, 0]).max() < 0.25


@pytest.mark.parametrize(
    "angles", [(0, 0, 30), (0, 0, -60), (0, 0, 150), (0, 30, 0), (0, 8, 0), (30, 0, 0), (20, 30, 50)]
)
def test_bodies_that_are_stored_turned(tmp_path, angles):
    """Headings come back as they were. Of a tilt only the skeleton tells, whose posture is its own: a few millimetres
    are left, as shoulders of this body lie a fifth of a degree off the rig's."""
    avatar = load_document(tmp_path, turned_document(angles))
    assert_is_the_person(avatar, EXACT if angles[:2] == (0, 0) else 5)
    assert any("turned" in warning for warning in avatar.warnings)


def test_a_stoop_is_a_posture(tmp_path):
    """A trunk that leans while legs stand is left as it is."""
    stoop = {"root": (25, 0, 0), "upperleg01.L": (-25, 0, 0), "upperleg01.R": (-25, 0, 0)}
    heads = _worlds_of(tmp_path, turned_nodes(person_document(), stoop))[:, :3, 3][:, [2, 0, 1]]
    avatar = load_document(tmp_path, person_document(joint_heads=heads))
    assert not any("tilted" in warning for warning in avatar.warnings)


def inverse_binds(builder):
    """(b, 4, 4) of the person's skin; what is returned can be stored by `store_binds`."""
    accessor = builder.document["accessors"][builder.document["skins"][0]["inverseBindMatrices"]]
    start = builder.document["bufferViews"][accessor["bufferView"]]["byteOffset"]
    stored = np.frombuffer(bytes(builder.binary), np.float32, 16 * RIG.bone_count, start)
    return stored.reshape(-1, 4, 4).transpose(0, 2, 1).astype(np.float64)


def store_binds(builder, matrices):
    return builder.add_accessor(matrices.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32))


def test_skins_of_one_figure_that_were_bound_apart(tmp_path):
    """A second mesh, bound in another frame, unit and pose, comes to the first by its own inverse bind matrices."""
    half = len(PERSON.faces) // 2
    builder = person_document(faces=PERSON.faces[:half])
    primitive, document = primitive_of(builder), builder.document
    binds = inverse_binds(builder)
    elsewhere = np.diag([100.0, 100.0, 100.0, 1.0])
    elsewhere[:3, :3] = elsewhere[:3, :3] @ Rotation.from_euler("x", 90, degrees=True).as_matrix()
    moved = PERSON.vertices[:, [1, 2, 0]] @ elsewhere[:3, :3].T
    other = {**primitive["attributes"], "POSITION": builder.add_accessor(moved.astype(np.float32))}
    indices = builder.add_accessor(PERSON.faces[half:].astype(np.uint16).reshape(-1))
    document["meshes"].append({"name": "body 2", "primitives": [{"attributes": other, "indices": indices}]})
    joints = document["skins"][0]["joints"]
    matrices = store_binds(builder, binds @ np.linalg.inv(elsewhere))
    document["skins"].append({"joints": joints, "inverseBindMatrices": matrices})
    document["nodes"].append({"name": "body 2", "mesh": 1, "skin": 1})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    avatar = load_document(tmp_path, turned_nodes(builder, KICK))
    corners = avatar.vertices[avatar.faces]
    assert distances(corners, PERSON.vertices[PERSON.faces]).max() < EXACT
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < EXACT


def test_a_head_with_a_skin_of_its_own(tmp_path):
    """Bound in the space of the body's mesh, but with no joint of its skin."""
    head = RIG.bone_index("head")
    bones = PERSON.influence_bones[np.arange(len(PERSON.vertices)), PERSON.influence_weights.argmax(axis=1)]
    on_head = (bones == head)[PERSON.faces]
    rigid = {"influence_joints": np.minimum(bones, head)[:, None], "influence_weights": np.ones((len(bones), 1))}
    builder = person_document(faces=PERSON.faces[~on_head.any(axis=1)], **rigid)
    primitive, document, binds = primitive_of(builder), builder.document, inverse_binds(builder)
    kept = [bone for bone in range(RIG.bone_count) if bone != head]  # the last one
    document["skins"][0] |= {"joints": kept, "inverseBindMatrices": store_binds(builder, binds[kept])}
    indices = builder.add_accessor(PERSON.faces[on_head.all(axis=1)].astype(np.uint16).reshape(-1))
    first = builder.add_accessor(np.zeros((len(bones), 4), np.uint8))
    own = {"attributes": {**primitive["attributes"], "JOINTS_0": first}, "indices": indices}
    document["meshes"].append({"name": "face", "primitives": [own]})
    document["skins"].append({"joints": [head], "inverseBindMatrices": store_binds(builder, binds[[head]])})
    document["nodes"].append({"name": "face", "mesh": 1, "skin": 1})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    joints = np.where(bones == head, 0, bones)
    primitive["attributes"]["JOINTS_0"] = builder.add_accessor(
        np.column_stack([joints, 0 * joints, 0 * joints, 0 * joints]).astype(np.uint8)
    )
    avatar = load_document(tmp_path, turned_nodes(builder, {"head": (0, 40, 0)}))
    kept_faces = np.concatenate([PERSON.faces[~on_head.any(axis=1)], PERSON.faces[on_head.all(axis=1)]])
    assert distances(avatar.vertices[avatar.faces], PERSON.vertices[kept_faces]).max() < EXACT


def test_joints_of_no_skin_follow_their_parents(tmp_path):
    """Hips and a vertebra that nothing was bound to are placed by the nodes next to them."""
    builder = person_document()
    left_out = [RIG.bone_index(bone) for bone in ("root", "spine04")]
    kept = [bone for bone in range(RIG.bone_count) if bone not in left_out]
    skin = builder.document["skins"][0]
    skin["inverseBindMatrices"] = store_binds(builder, inverse_binds(builder)[kept])
    skin["joints"] = kept
    instead = dict(zip(left_out, (RIG.bone_index("pelvis.L"), RIG.bone_index("spine05"))))
    place = np.array([kept.index(instead.get(bone, bone)) for bone in range(RIG.bone_count)])
    strongest = np.argsort(-PERSON.influence_weights, axis=1)[:, :4]
    joints = place[np.take_along_axis(PERSON.influence_bones, strongest, axis=1)]
    primitive_of(builder)["attributes"]["JOINTS_0"] = builder.add_accessor(joints.astype(np.uint8))
    avatar = load_document(
        tmp_path, turned_nodes(builder, {bone: KICK[bone] for bone in ("root", "spine03", "upperleg01.L")})
    )
    assert distances(avatar.vertices, PERSON.vertices).max() < EXACT
    assert distances(avatar.bone_heads, PERSON.bone_heads)[left_out].max() < EXACT


def test_where_the_bind_pose_is_none_nodes_count(tmp_path):
    """Rigid parts that were modelled each about its own joint have unit matrices; a body that was bound in a crouch and
    stands as its nodes are is taken as it stands."""
    bones = PERSON.influence_bones[np.arange(len(PERSON.vertices)), PERSON.influence_weights.argmax(axis=1)]
    rigid = {"influence_joints": bones[:, None], "influence_weights": np.ones((len(bones), 1))}
    faces = PERSON.faces[(bones[PERSON.faces] == bones[PERSON.faces[:, :1]]).all(axis=1)]
    about = person_document(vertices=PERSON.vertices - PERSON.bone_heads[bones], faces=faces, **rigid)
    about.document["skins"][0]["inverseBindMatrices"] = store_binds(about, np.tile(np.eye(4), (RIG.bone_count, 1, 1)))
    avatar = load_document(tmp_path, about)
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < EXACT
    assert distances(avatar.vertices[avatar.faces], PERSON.vertices[faces]).max() < EXACT
    crouch = {f"upperleg01.{side}": (-100, 0, 0) for side in "LR"} | {
        f"lowerleg01.{side}": (120, 0, 0) for side in "LR"
    }
    worlds = _worlds_of(tmp_path, turned_nodes(person_document(), crouch))
    builder = person_document()
    binds = inverse_binds(builder)
    moved = (worlds @ binds)[bones]
    crouched = np.einsum("vij,vj->vi", moved[:, :3, :3], PERSON.vertices[:, [1, 2, 0]]) + moved[:, :3, 3]
    builder = person_document(vertices=crouched[:, [2, 0, 1]], **rigid)
    builder.document["skins"][0]["inverseBindMatrices"] = store_binds(builder, np.linalg.inv(worlds))
    assert_is_the_person(load_document(tmp_path, builder))


def _worlds_of(tmp_path, builder):
    write_glb(tmp_path / "posed.glb", builder)
    return GltfFile(tmp_path / "posed.glb").node_worlds[: RIG.bone_count]


def test_bones_and_the_files_joints(tmp_path):
    """A bone moves by its node's transform times the inverse of what the avatar keeps: here to the pose of the file."""
    builder = turned_nodes(person_document(), KICK)
    avatar = load_document(tmp_path, builder)
    worlds = GltfFile(tmp_path / "person.glb").node_worlds
    assert (avatar.file_joints == np.arange(RIG.bone_count)).all()
    transforms = worlds[avatar.file_joints] @ np.linalg.inv(avatar.file_joint_frames)
    posed = avatar.posed_vertices(transforms[:, :3])
    assert distances(posed, avatar.file_vertices).max() < 1  # four of eight influences are in the file


@pytest.mark.parametrize("angles", [(0, 0, 0), (0, 0, 180), (0, 0, 90), (0, 0, -60)])
@pytest.mark.parametrize("pose", ["A", "T", "flat"])
def test_feet_tell_where_a_nameless_figure_faces(tmp_path, pose, angles):
    """By the skin before the ankles, even where all joints lie in one plane."""
    names = [f"bone_{bone}" for bone in range(RIG.bone_count)]
    vertices, heads, _ = t_posed_body(BODY, BODY.held_out_bodies[0])
    vertices, heads = (PERSON.vertices, PERSON.bone_heads) if pose == "A" else (vertices, heads.copy())
    if pose == "flat":
        heads[:, 0] = heads[RIG.bone_index("upperleg01.L"), 0]
    avatar = load_document(tmp_path, turned_document(angles, vertices=vertices, joint_heads=heads, joint_names=names))
    assert distances(avatar.vertices, PERSON.vertices).max() < 25  # moved back by half a foot's length it would be 200
    assert not any("guess" in warning for warning in avatar.warnings)
    trunk = [RIG.bone_index(bone) for bone in ("neck01", "head", "clavicle.L", "clavicle.R")]
    if pose != "flat":  # by their place along the chain; the next joints are 30 to 100 away
        assert distances(avatar.bone_heads, PERSON.bone_heads)[trunk].max() < 20

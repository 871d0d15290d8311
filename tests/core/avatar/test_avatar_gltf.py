"""GLB, glTF and VRM avatars: the same person from any pose, naming, scale, axis and storage."""

import base64

import numpy as np
import pytest
from gltf_person import (
    BODY,
    PERSON,
    RIG,
    dense_weights,
    distances,
    load_document,
    make_vrm,
    person_document,
    primitive_of,
    t_posed_body,
    write_gltf,
    write_vrm,
)

from physkin_core.avatar.avatar import AvatarError, avatar_from_body
from physkin_core.avatar.loading import load_avatar
from physkin_core.rig.rig import Rig
from physkin_core.rig.vrm_bones import HUMANOID_BONES
from physkin_prepare.avatar import AVATAR_PATH, BUNDLED_BODY, prepare_avatar

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, tested with plain meshes


def test_demo_avatar_round_trip(tmp_path):
    """Vertices and bones come back within 0.1 mm; the file stays small; the shipped one is what the script writes."""
    person = avatar_from_body(BODY, BODY.held_out_bodies[BUNDLED_BODY])
    prepare_avatar(tmp_path / "avatar.glb")
    assert (tmp_path / "avatar.glb").stat().st_size < 1e6
    for path in (tmp_path / "avatar.glb", AVATAR_PATH):
        avatar = load_avatar(path, RIG)
        assert np.array_equal(avatar.faces, person.faces)
        assert distances(avatar.vertices, person.vertices).max() < 0.1
        assert distances(avatar.bone_heads, person.bone_heads).max() < 0.1
        assert distances(avatar.bone_tails, person.bone_tails).max() < 0.1
        assert np.allclose(avatar.influence_weights.sum(axis=1), 1, atol=1e-6)
        assert np.abs(dense_weights(avatar) - dense_weights(PERSON)).mean() < 3e-4  # four of eight influences are kept
        assert avatar.warnings == ()


@pytest.mark.parametrize("body_index", [0, 1, 2])
@pytest.mark.parametrize("vrm_version", ["1.0", "0.x"])
def test_t_posed_vrm_is_the_same_person(tmp_path, vrm_version, body_index):
    """T-pose, 20 humanoid joints, feet on the ground: the canonical A-pose to millimetres, joints, too.

    Rig bones that a VRM has no joint for (where a thigh or a neck is divided) are placed within 2 cm.
    """
    write_vrm(tmp_path / "person.vrm", body_index=body_index, vrm_version=vrm_version)
    avatar = load_avatar(tmp_path / "person.vrm", RIG)
    person = avatar_from_body(BODY, BODY.held_out_bodies[body_index])
    distance = distances(avatar.vertices, person.vertices)
    assert distance.mean() < 3 and distance.max() < 20
    heads, tails = distances(avatar.bone_heads, person.bone_heads), distances(avatar.bone_tails, person.bone_tails)
    assert max(heads.mean(), tails.mean()) < 4 and max(heads.max(), tails.max()) < 20
    stated = [RIG.bone_index(bone) for bone in HUMANOID_BONES.values()]
    assert heads[stated].max() < 4
    assert np.abs(dense_weights(avatar) - dense_weights(person)).sum(axis=1).mean() / 2 < 0.07
    assert avatar.warnings == ()


def test_centimetre_armature_and_turned_nodes(tmp_path):
    """A Z-up armature in centimetres under a scaled and turned node, with helper nodes as matrices: the same person."""
    builder = person_document()
    document = builder.document
    nodes, root = document["nodes"], 0
    to_centimetres = np.diag([100.0, 100.0, 100.0, 1.0])
    up = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0], [0, -1.0, 0, 0], [0, 0, 0, 1]])  # this maps Z up to Y up
    for node in nodes[:-1]:
        node["translation"] = (100 * up[:3, :3].T @ node["translation"]).tolist()
    half = np.sqrt(0.5)
    nodes.append({"name": "Armature", "rotation": [-half, 0, 0, half], "scale": [0.01] * 3, "children": [root]})
    document["scenes"][0]["nodes"] = [len(nodes) - 1, len(nodes) - 2]
    # Inverse bind matrices go from the mesh to each joint's own frame, in centimetres.
    view = document["bufferViews"][document["accessors"][document["skins"][0]["inverseBindMatrices"]]["bufferView"]]
    bind = np.frombuffer(bytes(builder.binary), np.float32, 36 * 16, view["byteOffset"]).reshape(-1, 4, 4)
    changed = np.einsum("ij,njk->nik", to_centimetres @ np.linalg.inv(up), bind.transpose(0, 2, 1).astype(np.float64))
    changed = changed.transpose(0, 2, 1).astype(np.float32)
    builder.binary[view["byteOffset"] : view["byteOffset"] + view["byteLength"]] = changed.tobytes()
    spine = nodes[RIG.bone_index("spine05")]
    matrix = np.eye(4)
    matrix[:3, 3] = spine.pop("translation")
    spine["matrix"] = matrix.T.reshape(-1).tolist()
    avatar = load_document(tmp_path, builder)
    assert distances(avatar.vertices, PERSON.vertices).max() < 0.1
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < 0.1


def test_fingers_follow_the_wrist(tmp_path):
    """Finger joints without a rig bone turn with the arm, and their influence goes to the wrist."""
    vertices, heads, _ = t_posed_body(BODY, BODY.held_out_bodies[0])
    wrist = RIG.bone_index("wrist.L")
    fingers = (PERSON.influence_bones == wrist) & (np.linalg.norm(vertices - heads[wrist], axis=1) > 0.1)[:, None]
    assert fingers.any()
    builder = person_document(
        vertices=vertices,
        joint_names=[*RIG.bone_names, "finger", "finger tip"],
        joint_parents=[*RIG.parents, wrist, RIG.bone_count],
        joint_heads=np.concatenate([heads, heads[[wrist, wrist]] + [[0, 0.1, 0], [0, 0.13, 0]]]),
        influence_joints=np.where(fingers, RIG.bone_count + 1, PERSON.influence_bones),
    )
    avatar = load_document(tmp_path, builder)
    moved = fingers.any(axis=1)
    assert distances(avatar.vertices, PERSON.vertices)[moved].max() < 2
    assert (dense_weights(avatar)[moved, wrist] > 0.5).all()


def test_humanoid_bones_outside_the_skin(tmp_path):
    """A VRM may state a bone that no vertex follows and the skin does not list; it counts as a joint."""
    names = [f"own_{bone}" for bone in range(RIG.bone_count)]
    builder = person_document(joint_names=names)
    make_vrm(builder, {role: RIG.bone_index(bone) for role, bone in HUMANOID_BONES.items()})
    nodes, wrist = builder.document["nodes"], RIG.bone_index("wrist.L")
    nodes[wrist].setdefault("children", []).append(len(nodes))
    nodes.append({"name": "hand marker"})
    builder.document["extensions"]["VRMC_vrm"]["humanoid"]["humanBones"]["leftHand"]["node"] = len(nodes) - 1
    assert distances(load_document(tmp_path, builder).bone_heads, PERSON.bone_heads)[wrist] < 4


def test_external_and_embedded_buffers(tmp_path):
    """A .gltf with its buffer beside it (and a space in its name) or inside it as base64 reads like the GLB."""
    builder = person_document()
    (tmp_path / "the buffer.bin").write_bytes(bytes(builder.binary))
    write_gltf(tmp_path / "beside.gltf", builder, buffer_uri="the%20buffer.bin")
    data = base64.b64encode(bytes(builder.binary)).decode()
    write_gltf(tmp_path / "inside.gltf", builder, buffer_uri=f"data:application/octet-stream;base64,{data}")
    for name in ("beside.gltf", "inside.gltf"):
        assert distances(load_avatar(tmp_path / name, RIG).vertices, PERSON.vertices).max() < 0.1


def test_sparse_normalised_and_interleaved_accessors(tmp_path):
    """Positions with a sparse correction, byte weights, and a strided view read as the plain ones."""
    builder = person_document()
    document, attributes = builder.document, primitive_of(builder)["attributes"]
    positions = document["accessors"][attributes["POSITION"]]
    view = document["bufferViews"][positions["bufferView"]]
    stored = np.frombuffer(bytes(builder.binary), np.float32, 3 * len(PERSON.vertices), view["byteOffset"]).reshape(
        -1, 3
    )
    wrong = np.zeros((len(stored), 5), dtype=np.float32)  # two more floats a vertex: interleaved with something else
    wrong[:, :3] = stored
    rows = np.array([7, 100, 4000], dtype=np.uint16)
    wrong[rows] = 55.0
    positions["bufferView"] = builder.add_view(wrong)
    document["bufferViews"][-1]["byteStride"] = 20
    positions["sparse"] = {
        "count": len(rows),
        "indices": {"bufferView": builder.add_view(rows), "componentType": 5123},
        "values": {"bufferView": builder.add_view(stored[rows])},
    }
    avatar = load_document(tmp_path, builder)
    assert distances(avatar.vertices, PERSON.vertices).max() < 0.1
    weights = np.round(255 * np.sort(PERSON.influence_weights, axis=1)[:, ::-1][:, :4]).astype(np.uint8)
    attributes["WEIGHTS_0"] = builder.add_accessor(weights, normalized=True)
    avatar = load_document(tmp_path, builder)
    assert np.allclose(avatar.influence_weights.sum(axis=1), 1, atol=1e-6)
    assert np.abs(dense_weights(avatar) - dense_weights(PERSON)).mean() < 5e-4


def test_morph_targets_are_applied(tmp_path):
    """A body shape stored as a morph target with a default weight is what is loaded."""
    builder = person_document()
    mesh, offset = builder.document["meshes"][0], np.zeros((len(PERSON.vertices), 3), dtype=np.float32)
    offset[:, 2] = 0.02 * (PERSON.vertices[:, 2] > 0)
    mesh["primitives"][0]["targets"] = [{"POSITION": builder.add_accessor(offset)}]
    mesh["weights"] = [0.5]
    moved = load_document(tmp_path, builder).vertices - PERSON.vertices
    assert np.allclose(moved[:, 0], 0.01 * (PERSON.vertices[:, 2] > 0), atol=1e-4)


def test_several_primitives_and_nodes_are_one_surface(tmp_path):
    """Two primitives with vertices of their own and a second node: welded at the seams, no vertex is doubled."""
    builder = person_document()
    document, primitive = builder.document, primitive_of(builder)
    half = len(PERSON.faces) // 2
    arrays = {}
    for name, width, dtype in (("POSITION", 3, np.float32), ("JOINTS_0", 4, np.uint8), ("WEIGHTS_0", 4, np.uint16)):
        view = document["bufferViews"][document["accessors"][primitive["attributes"][name]]["bufferView"]]
        stored = np.frombuffer(bytes(builder.binary), dtype, width * len(PERSON.vertices), view["byteOffset"])
        arrays[name] = stored.reshape(-1, width)
    used, faces = np.unique(PERSON.faces[half:], return_inverse=True)
    second = {name: builder.add_accessor(a[used], normalized=name == "WEIGHTS_0") for name, a in arrays.items()}
    document["meshes"].append({"primitives": [{"attributes": second, "indices": None}]})
    document["meshes"][1]["primitives"][0]["indices"] = builder.add_accessor(faces.reshape(-1).astype(np.uint16))
    primitive["indices"] = builder.add_accessor(PERSON.faces[:half].astype(np.uint16).reshape(-1))
    document["nodes"].append({"name": "second part", "mesh": 1, "skin": 0, "translation": [9, 9, 9]})  # to be ignored
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    avatar = load_document(tmp_path, builder)
    assert avatar.vertices.shape == PERSON.vertices.shape and avatar.faces.shape == PERSON.faces.shape
    assert np.allclose(avatar.vertices[avatar.faces], PERSON.vertices[PERSON.faces], atol=1e-4)


def _add_cube(builder, parent):
    corners = np.array([[x, y, z] for x in (0, 0.1) for y in (0, 0.1) for z in (0, 0.1)], dtype=np.float32)
    strip = builder.add_accessor(np.array([0, 1, 2, 3, 6, 7, 4, 5, 0, 1], dtype=np.uint16))
    document, position = builder.document, builder.add_accessor(corners)
    document["meshes"].append({"primitives": [{"attributes": {"POSITION": position}, "indices": strip, "mode": 5}]})
    document["nodes"].append({"name": "box", "mesh": len(document["meshes"]) - 1})
    above = document["scenes"][0]["nodes"] if parent is None else document["nodes"][parent].setdefault("children", [])
    above.append(len(document["nodes"]) - 1)


def test_meshes_without_a_skin(tmp_path):
    """What hangs on a joint moves with it (here to be part of the body); what hangs on none is left out, with a
    warning."""
    worn, prop = person_document(), person_document()
    _add_cube(worn, RIG.bone_index("head"))
    worn.document["nodes"][-1]["name"] = "extra head"
    _add_cube(prop, None)
    with_cube, without = load_document(tmp_path, worn), load_document(tmp_path, prop)
    assert len(with_cube.vertices) == len(PERSON.vertices) + 8 and with_cube.warnings == ()
    head = RIG.bone_index("head")
    added = np.setdiff1d(np.arange(len(with_cube.vertices)), np.arange(len(PERSON.vertices)))
    assert np.allclose(dense_weights(with_cube)[added, head], 1)
    assert np.allclose(with_cube.vertices[added].min(axis=0), PERSON.bone_heads[head], atol=1e-4)
    assert len(without.vertices) == len(PERSON.vertices)
    assert "'box' has no skin" in without.warnings[0]


def test_an_avatar_facing_backwards_is_turned(tmp_path):
    """A file against the standard's axes is recognised by its skeleton, turned, and the warning says so."""
    half_turn = np.array([-1.0, -1.0, 1.0])
    avatar = load_document(
        tmp_path, person_document(vertices=PERSON.vertices * half_turn, joint_heads=PERSON.bone_heads * half_turn)
    )
    assert distances(avatar.vertices, PERSON.vertices).max() < 0.1
    assert "faces -X with Z up" in avatar.warnings[0]


def test_faces_inside_out_and_vertices_without_influences(tmp_path):
    """Faces whose enclosed volume is negative come back outward; all-zero skinning weights go to the first joint, with
    a warning that counts them."""
    builder = person_document(faces=PERSON.faces[:, ::-1])
    weights = np.zeros((len(PERSON.vertices), 4), dtype=np.float32)
    weights[5:, 0] = 1
    primitive_of(builder)["attributes"]["WEIGHTS_0"] = builder.add_accessor(weights)
    avatar = load_document(tmp_path, builder)
    corners = avatar.vertices[avatar.faces]
    assert np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) > 0
    assert avatar.warnings[0].startswith("5 vertices of 'body' have no skinning weights")


def test_another_rig_by_its_own_names(tmp_path):
    """A rig without human limbs binds an avatar whose joints bear its bones' names, pose untouched."""
    rig = Rig(
        ("base", "arm"), np.array([-1, 0]), np.array([[0, 0, 0], [0, 0, 0.5]]), np.array([[0, 0, 0.5], [0, 0, 1]]), ()
    )
    heads = np.array([[0.0, 0, 0.2], [0, 0.1, 0.8]])
    bones = (PERSON.vertices[:, 2:] > 0).astype(int)
    arguments = {"joint_parents": [-1, 0], "joint_heads": heads, "influence_joints": bones}
    arguments["influence_weights"] = np.ones_like(bones, dtype=np.float64)
    avatar = load_document(tmp_path, person_document(joint_names=["base", "arm"], **arguments), rig)
    assert np.allclose(avatar.vertices, PERSON.vertices - heads[0], atol=1e-5)
    assert np.allclose(avatar.bone_heads, heads - heads[0], atol=1e-5)
    with pytest.raises(
        AvatarError,
        match="no joint for 1 of the 2 rig bones it must have: arm; taken: 'base' as base; not recognised: 'leg'",
    ):
        load_document(tmp_path, person_document(joint_names=["base", "leg"], **arguments), rig)
    write_vrm(tmp_path / "person.vrm")
    with pytest.raises(AvatarError, match="it must have: base, arm; taken: none; not recognised: '"):
        load_avatar(tmp_path / "person.vrm", rig)


def test_a_rig_file_is_not_for_skinned_files(tmp_path):
    """A file with its own skeleton does not take another."""
    prepare_avatar(tmp_path / "avatar.glb")
    with pytest.raises(AvatarError, match="has its own skeleton"):
        load_avatar(tmp_path / "avatar.glb", RIG, rig_file=tmp_path / "other.json")

"""What users' glTF files are like: several figures, levels of detail, parts without a skin, numbers slightly off,
tails, hair, half bodies. The person comes out as from a plain file."""

import json

import numpy as np
import pytest
import trimesh
from gltf_person import (
    PERSON,
    RIG,
    add_part,
    distances,
    faces_on,
    load_document,
    person_document,
    primitive_of,
)
from scipy.spatial import cKDTree

from physkin_core import load_avatar
from physkin_core.avatar.avatar import AvatarError

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, which `Avatar.warnings` keeps
HEAD, CHEST = RIG.bone_index("head"), RIG.bone_index("spine01")


def assert_is_the_person(avatar):
    assert len(avatar.vertices) == len(PERSON.vertices)
    assert distances(avatar.vertices, PERSON.vertices).max() < 0.1
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < 0.1


def add_figure(builder, name, *, at=(0.0, 0.0, 0.0), size=1.0, joints=None, heads=PERSON.bone_heads):
    """The person once more, on a skeleton of its own, glTF's frame. joints: (j,) indices of the only bones that it has
    joints for."""
    document = builder.document
    first, bones = len(document["nodes"]), range(RIG.bone_count) if joints is None else joints
    heads = heads[:, [1, 2, 0]].astype(np.float64) * size
    for place, bone in enumerate(bones):
        above = next((list(bones).index(each) for each in RIG.ancestors(bone)[1:] if each in bones), None)
        offset = heads[bone] + at if above is None else heads[bone] - heads[list(bones)[above]]
        document["nodes"].append({"name": f"{name}_{RIG.bone_names[bone]}", "translation": offset.tolist()})
        siblings = document["scenes"][0]["nodes"] if above is None else document["nodes"][first + above]
        siblings = siblings if above is None else siblings.setdefault("children", [])
        siblings.append(first + place)
    binds = np.tile(np.eye(4), (len(bones), 1, 1))
    binds[:, :3, 3] = -heads[list(bones)]
    matrices = builder.add_accessor(binds.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32))
    joint_nodes = list(range(first, first + len(bones)))
    document["skins"].append({"joints": joint_nodes, "inverseBindMatrices": matrices})
    attributes = dict(primitive_of(builder)["attributes"])
    positions = (size * PERSON.vertices[:, [1, 2, 0]]).astype(np.float32)
    attributes["POSITION"] = builder.add_accessor(positions)
    if joints is not None:
        attributes["JOINTS_0"] = builder.add_accessor(np.zeros((len(positions), 4), np.uint8))
        attributes["WEIGHTS_0"] = builder.add_accessor(np.eye(4, dtype=np.float32)[np.zeros(len(positions), int)])
    mesh = {"attributes": attributes, "indices": primitive_of(builder)["indices"]}
    document["meshes"].append({"name": name, "primitives": [mesh]})
    document["nodes"].append({"name": name, "mesh": len(document["meshes"]) - 1, "skin": len(document["skins"]) - 1})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)


def test_of_several_people_one_is_worn(tmp_path):
    """The largest, or the first of that size; the others are named, and left out."""
    builder = person_document()
    add_figure(builder, "child", at=(-1, 0, 0), size=0.6)
    add_figure(builder, "friend", at=(1, 0, 0))
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    assert avatar.warnings[0].startswith("3 figures are in the file: 'body' is taken")
    assert avatar.warnings[0].endswith("left out: 'child', 'friend'")


def test_clothes_that_bring_the_skeleton_are_no_second_person(tmp_path):
    """Joints where the figure's are, under other nodes and names: the mesh moves with the figure's."""
    builder = person_document()
    add_figure(builder, "jacket")
    document = builder.document
    jacket = faces_on("spine", "root", "clavicle", "upperarm")
    primitive = document["meshes"][1]["primitives"][0]
    primitive["indices"] = builder.add_accessor(jacket.astype(np.uint16).reshape(-1))
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    (piece,) = avatar.clothes
    assert len(piece.faces) == len(jacket) and not any("figures" in said for said in avatar.warnings)
    elbow = RIG.joint_positions({"upperarm01.L_x": 0.5})
    bones = RIG.bone_transforms(elbow, heads=avatar.bone_heads)
    expected = avatar.posed_vertices(bones)[cKDTree(avatar.vertices).query(piece.vertices)[1]]
    assert distances(piece.posed_vertices(bones), expected).max() < 0.1


@pytest.mark.parametrize("name", ["LOD", "lod_", None])
def test_the_finest_level_of_detail_counts(tmp_path, name):
    """By name, or by shape where names say nothing."""
    builder = person_document()
    cells = np.unique(np.floor(PERSON.vertices / 0.015), axis=0, return_inverse=True)[1].reshape(-1)
    near = np.unique(cells, return_index=True)[1]
    faces = cells[PERSON.faces]
    faces = faces[(faces != np.roll(faces, 1, axis=1)).all(axis=1)]
    document, own = builder.document, primitive_of(builder)["attributes"]
    file = {"POSITION": PERSON.vertices[near][:, [1, 2, 0]].astype(np.float32)}
    for each, dtype in (("JOINTS_0", np.uint8), ("WEIGHTS_0", np.uint16)):
        view = document["bufferViews"][document["accessors"][own[each]]["bufferView"]]
        stored = np.frombuffer(bytes(builder.binary), dtype, 4 * len(PERSON.vertices), view["byteOffset"])
        file[each] = stored.reshape(-1, 4)[near]
    coarse = {each: builder.add_accessor(array, normalized=each == "WEIGHTS_0") for each, array in file.items()}
    indices = builder.add_accessor(faces.astype(np.uint16).reshape(-1))
    document["meshes"].append({"primitives": [{"attributes": coarse, "indices": indices}]})
    document["nodes"].append({"name": "Figure", "mesh": 1, "skin": 0})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    if name is not None:
        document["nodes"][-2]["name"], document["nodes"][-1]["name"] = f"Figure_{name}0", f"Figure_{name}1"
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    assert "draw again what others draw finer: 'Figure" in avatar.warnings[0]


@pytest.mark.parametrize("names", ["rigify", ""])
def test_a_large_horse_is_no_person(tmp_path, names):
    """The trunk of what stands on four legs lies, whatever its joints are called."""
    builder, heads = person_document(), PERSON.bone_heads.copy()
    on_all_fours = [bone for bone in range(RIG.bone_count) if "leg" not in RIG.bone_names[bone]]
    on_all_fours = [bone for bone in on_all_fours if not RIG.bone_names[bone].startswith(("foot", "pelvis"))]
    arms = [bone for bone in on_all_fours if "arm" in RIG.bone_names[bone] or "wrist" in RIG.bone_names[bone]]
    heads[on_all_fours] = heads[on_all_fours][:, [2, 1, 0]] * [1, 1, -1]
    shoulder = heads[RIG.bone_index("upperarm01.L")]
    heads[arms] = shoulder * [1, 0, 1] + (PERSON.bone_heads[arms] - PERSON.bone_heads[arms[0]]) * [0, 1, 1]
    add_figure(builder, "horse", at=(3, 0, 0), size=1.5, heads=heads)
    if not names:
        for node in builder.document["nodes"]:
            node["name"] = node["name"] if not node["name"].startswith("horse") else ""
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    assert avatar.warnings[0].startswith("2 figures are in the file: 'body' is taken")


def test_levels_of_detail_by_name_differ_as_much_as_they_like(tmp_path):
    """A cross-section of the figure stands for the one far away."""
    builder = person_document()
    document = builder.document
    document["nodes"][-1]["name"] = "Person"
    primitive = primitive_of(builder)
    few = {**primitive, "indices": builder.add_accessor(PERSON.faces[::40].astype(np.uint16).reshape(-1))}
    document["meshes"].append({"primitives": [few]})
    document["nodes"].append({"name": "Person_LOD3", "mesh": 1, "skin": 0})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    assert len(avatar.faces) == len(PERSON.faces)
    assert avatar.warnings == ("these meshes draw again what others draw finer: 'Person_LOD3'; left out",)


@pytest.mark.parametrize("shared", [True, False])
def test_a_body_that_is_drawn_from_both_sides_is_one_body(tmp_path, shared):
    """With its inside as further faces, of the same vertices or of their copies."""
    count, copies = len(PERSON.vertices), 1 if shared else 2
    builder = person_document(
        vertices=np.concatenate([PERSON.vertices] * copies),
        faces=np.concatenate([PERSON.faces, PERSON.faces[:, ::-1] + count * (copies - 1)]),
        influence_joints=np.concatenate([PERSON.influence_bones] * copies),
        influence_weights=np.concatenate([PERSON.influence_weights] * copies),
    )
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    np.testing.assert_array_equal(avatar.faces, PERSON.faces)


def test_a_body_whose_inside_has_a_material_is_one_body(tmp_path):
    builder = person_document()
    indices = builder.add_accessor(PERSON.faces[:, ::-1].astype(np.uint16).reshape(-1))
    builder.document["materials"] = [{"name": "front"}, {"name": "back"}]
    inside = {**primitive_of(builder), "indices": indices, "material": 1}
    primitive_of(builder)["material"] = 0
    builder.document["meshes"][0]["primitives"].append(inside)
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    np.testing.assert_array_equal(avatar.faces, PERSON.faces)


def test_nameless_clothes_over_a_whole_body_are_worn_already(tmp_path):
    """There is room for the surface of a stout body, but they lie over what skin there is."""
    builder = person_document()
    shirt = faces_on("spine03", "spine02", "spine01", "upperarm")
    add_part(builder, "", shirt, offset=0.012)
    avatar = load_document(tmp_path, builder)
    assert len(avatar.clothes) == 1 and len(avatar.clothes[0].faces) == len(shirt)
    assert distances(avatar.vertices[: len(PERSON.vertices)], PERSON.vertices).max() < 0.1


def test_vertices_that_no_face_uses_may_be_anywhere(tmp_path):
    builder = person_document(
        vertices=np.concatenate([PERSON.vertices, np.full((5, 3), np.nan)]),
        influence_joints=np.concatenate([PERSON.influence_bones, PERSON.influence_bones[:5]]),
        influence_weights=np.concatenate([PERSON.influence_weights, PERSON.influence_weights[:5]]),
    )
    assert_is_the_person(load_document(tmp_path, builder))


@pytest.mark.parametrize("axis", [0, 2])
def test_a_mirrored_figure_faces_where_its_feet_point(tmp_path, axis):
    """The nodes above mirror it, so that its left is what names call right."""
    builder = person_document()
    document, scale = builder.document, [1.0, 1.0, 1.0]
    scale[axis] = -1.0
    nodes = document["scenes"][0]["nodes"]
    roots = [node for node in nodes if "mesh" not in document["nodes"][node]]
    document["nodes"].append({"name": "Armature", "scale": scale, "children": roots})
    document["scenes"][0]["nodes"] = [*(set(nodes) - set(roots)), len(document["nodes"]) - 1]
    avatar = load_document(tmp_path, builder)
    assert "by its feet it faces the other way than by its names: left and right are exchanged" in avatar.warnings
    assert cKDTree(PERSON.vertices * [1, -1, 1]).query(avatar.vertices)[0].max() < 1e-3
    toes = avatar.vertices[avatar.vertices[:, 2] < avatar.vertices[:, 2].min() + 0.05][:, 0].mean()
    assert toes > avatar.bone_heads[RIG.bone_index("foot.L"), 0]


def rigid_document(*, turned=0.0):
    """The person cut up into parts without a skin, each a mesh of its bone's node. turned: left upper arm [radians]."""
    builder = person_document()
    document, primitive = builder.document, primitive_of(builder)
    strongest = PERSON.influence_bones[np.arange(len(PERSON.vertices)), PERSON.influence_weights.argmax(axis=1)]
    nodes = {node["name"]: node for node in document["nodes"]}
    document["meshes"] = []
    for bone, name in enumerate(RIG.bone_names):
        faces = PERSON.faces[strongest[PERSON.faces[:, 0]] == bone]
        if len(faces):
            at = (PERSON.vertices - PERSON.bone_heads[bone])[:, [1, 2, 0]].astype(np.float32)
            indices = builder.add_accessor(faces.astype(np.uint16).reshape(-1))
            part = {**primitive, "attributes": {"POSITION": builder.add_accessor(at)}, "indices": indices}
            document["meshes"].append({"primitives": [part]})
            nodes[name]["mesh"] = len(document["meshes"]) - 1
    del document["skins"], document["nodes"][-1]
    document["scenes"][0]["nodes"].pop()
    nodes["upperarm01.L"]["rotation"] = [0.0, 0.0, np.sin(turned / 2), np.cos(turned / 2)]
    return builder


@pytest.mark.parametrize("turned", [0.0, 1.2])
def test_rigid_parts_move_with_their_nodes(tmp_path, turned):
    """As a robot's do, in any pose. Cut edges are in both parts; a raised arm gapes there when it is lowered."""
    avatar = load_document(tmp_path, rigid_document(turned=turned))
    assert len(avatar.faces) == len(PERSON.faces)
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < (0.1 if turned == 0 else 5)
    off = 1000 * cKDTree(PERSON.vertices).query(avatar.vertices)[0]
    assert off.max() < 0.1 if turned == 0 else off.mean() < 2
    assert not any("no skeleton" in said for said in avatar.warnings)


def test_a_mesh_that_lost_its_skin_is_a_plain_mesh(tmp_path):
    """Joints that carry nothing do not count: a skeleton is fitted."""
    builder = person_document()
    del builder.document["skins"], builder.document["nodes"][-1]["skin"]
    avatar = load_document(tmp_path, builder)
    assert any("no skeleton in the file" in said for said in avatar.warnings)


def test_the_nodes_morph_weights_win(tmp_path):
    """Over the mesh's, as glTF says; here these are all zero."""
    builder = person_document()
    mesh, offset = builder.document["meshes"][0], np.zeros((len(PERSON.vertices), 3), dtype=np.float32)
    offset[:, 2] = 0.02 * (PERSON.vertices[:, 2] > 0)
    mesh["primitives"][0]["targets"] = [{"POSITION": builder.add_accessor(offset)}]
    for on_mesh, on_node, moved in (([0.0], [0.5], 0.01), ([1.0], [0.0], 0.0), (None, [1.0], 0.02)):
        mesh.pop("weights", None)
        mesh |= {} if on_mesh is None else {"weights": on_mesh}
        builder.document["nodes"][-1]["weights"] = on_node
        found = load_document(tmp_path, builder).vertices - PERSON.vertices
        assert np.allclose(found[:, 0], moved * (PERSON.vertices[:, 2] > 0), atol=1e-4)


def test_a_primitive_without_a_skin_moves_with_the_joint_that_it_lies_at(tmp_path):
    builder = person_document()
    eye = trimesh.creation.icosphere(2, 0.015)
    at = PERSON.bone_heads[HEAD][[1, 2, 0]] + [0.03, 0.06, 0.08]
    eyes = {"attributes": {"POSITION": builder.add_accessor((eye.vertices + at).astype(np.float32))}, "material": 0}
    eyes["indices"] = builder.add_accessor(eye.faces.astype(np.uint16).reshape(-1))
    builder.document["materials"] = [{"name": "eyes"}]
    builder.document["meshes"][0]["primitives"].append(eyes)
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    assert len(avatar.accessories.vertices) == len(eye.vertices)
    assert (avatar.accessories.influence_bones[:, 0] == HEAD).all()
    assert avatar.warnings[0].startswith(
        "meshes[0].primitives[1] of mesh 'body' has no skinning weights: it moves with"
    )
    for attribute in ("JOINTS_0", "WEIGHTS_0"):
        primitive_of(builder)["attributes"].pop(attribute)
    with pytest.raises(AvatarError, match=r"meshes\[0\]\.primitives\[0\] of mesh 'body' has a skin but no JOINTS_0"):
        load_document(tmp_path, builder)


def test_a_rotation_that_was_never_set_is_none(tmp_path):
    builder = person_document()
    builder.document["nodes"][HEAD]["rotation"] = [0, 0, 0, 0]
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    assert avatar.warnings[0].startswith(
        f"'head': nodes[{HEAD}].rotation is [0.0, 0.0, 0.0, 0.0], which turns by nothing"
    )


def test_what_is_not_finite_is_refused_only_where_it_decides(tmp_path):
    """A node that bears no bone of a person, and the bind matrix of a joint that nothing hangs on."""
    builder = person_document()
    nodes = builder.document["nodes"]
    nodes[HEAD].setdefault("children", []).append(len(nodes))
    nodes.append({"name": "lock of hair", "translation": [float("nan"), 0, 0]})
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    assert "'lock of hair'" in avatar.warnings[0] and "3 finite numbers" in avatar.warnings[0]
    nodes[-1].pop("translation")
    accessor = builder.document["accessors"][builder.document["skins"][0]["inverseBindMatrices"]]
    start = builder.document["bufferViews"][accessor["bufferView"]]["byteOffset"] + 64 * HEAD
    builder.binary[start : start + 64] = np.full(16, np.nan, np.float32).tobytes()
    assert_is_the_person(load_document(tmp_path, builder))
    builder.binary[start - 64 * HEAD : start + 64] = np.full(16 * (HEAD + 1), np.nan, np.float32).tobytes()
    with pytest.raises(AvatarError, match="36 inverse bind matrices .* needs a finite one"):
        load_document(tmp_path, builder)


def test_a_few_skinning_weights_that_are_none(tmp_path):
    builder = person_document()
    strongest = np.argsort(-PERSON.influence_weights, axis=1)[:, :4]
    weights = np.take_along_axis(PERSON.influence_weights, strongest, axis=1).astype(np.float32)
    weights[7, 3], weights[9, 3] = -0.001, np.nan
    primitive_of(builder)["attributes"]["WEIGHTS_0"] = builder.add_accessor(weights)
    avatar = load_document(tmp_path, builder)
    assert_is_the_person(avatar)
    assert avatar.warnings == (
        "2 vertices of 'body' have skinning weights that are below 0 or not finite, the first is 7: taken as 0",
    )


def _with_box(size, at, bone):
    """The person and a box in one mesh, on one bone."""
    box = trimesh.creation.box(size)
    for _ in range(4):
        box = box.subdivide()
    width, count = PERSON.influence_bones.shape[1], len(box.vertices)
    bones = np.concatenate([PERSON.influence_bones, np.full((count, width), bone)])
    weights = np.concatenate([PERSON.influence_weights, np.eye(width)[np.zeros(count, int)]])
    vertices = np.concatenate([PERSON.vertices, box.vertices + at])
    faces = np.concatenate([PERSON.faces, box.faces + len(PERSON.vertices)])
    return {"vertices": vertices, "faces": faces, "influence_joints": bones, "influence_weights": weights}


@pytest.mark.parametrize(
    ("size", "offset", "bone"),
    [((0.04, 0.25, 0.7), (-0.12, 0, -0.2), HEAD), ((0.02, 1.6, 0.5), (-0.2, 0, 0.1), CHEST)],
    ids=["long hair", "wings"],
)
def test_what_no_human_has_is_shown_and_not_heeded(tmp_path, size, offset, bone):
    """Pieces of the body's own mesh that reach far from their bone, or hang from the head below the shoulders."""
    avatar = load_document(tmp_path, person_document(**_with_box(size, PERSON.bone_heads[bone] + offset, bone)))
    assert_is_the_person(avatar)
    assert avatar.accessories is not None and "appendage" in avatar.warnings[0]


def test_a_tail_of_nameless_joints(tmp_path):
    parts = _with_box((0.5, 0.06, 0.06), np.array([-0.4, 0, 0]), RIG.bone_count)
    far = parts["vertices"][:, 0] < -0.45
    parts["influence_joints"] = np.where(far[:, None], RIG.bone_count + 1, parts["influence_joints"])
    heads = np.concatenate([PERSON.bone_heads, [[-0.15, 0, 0], [-0.45, 0, 0]]])
    joints = {"joint_names": [*RIG.bone_names, "Bone.001", "Bone.002"], "joint_heads": heads}
    avatar = load_document(
        tmp_path, person_document(joint_parents=[*RIG.parents, 0, RIG.bone_count], **joints, **parts)
    )
    assert_is_the_person(avatar)
    assert avatar.warnings[0].endswith("shown, though garments do not heed it: 'Bone.001/appendage'")


def test_a_big_head_is_a_head(tmp_path):
    """A cartoon's, in a piece of its own."""
    box = _with_box((0.5, 0.6, 0.5), PERSON.bone_heads[HEAD] + [0, 0, 0.25], HEAD)
    avatar = load_document(tmp_path, person_document(**box))
    assert len(avatar.vertices) == len(box["vertices"]) and avatar.warnings == ()


def test_half_a_body_is_named(tmp_path):
    legs = {tuple(face) for face in faces_on("upperleg", "lowerleg", "foot").tolist()}
    upper = np.array([face for face in PERSON.faces.tolist() if tuple(face) not in legs])
    (warning,) = load_document(tmp_path, person_document(faces=upper)).warnings
    legs = "the left thigh, the left shin, the right thigh, the right shin"
    assert warning == f"the body has no skin on {legs}: clothes there have nothing to lie on"


@pytest.mark.timeout(60)
@pytest.mark.parametrize("kind", ["many skins of one joint", "many joints far down a chain"])
def test_hostile_skeletons_take_no_time(tmp_path, kind):
    """Time grows with the file, not with its square, which would be minutes here."""
    count, deep = 120_000, 2_000
    if "skins" in kind:
        nodes, skins = [{}], [{"joints": [0]}] * count
    else:
        leaves = list(range(count, count + deep))
        nodes = [*({"children": [node + 1]} for node in range(count - 1)), {"children": leaves}, *[{}] * deep]
        skins = [{"joints": leaves}]
    path = tmp_path / "a.gltf"
    path.write_text(json.dumps({"asset": {"version": "2.0"}, "nodes": nodes, "skins": skins}))
    with pytest.raises(AvatarError, match="no faces on its skeleton|has 122000 bones, allowed are 2048"):
        load_avatar(path, RIG)

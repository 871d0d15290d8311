"""A held-out body as a glTF document that tests may change before it is written and loaded; bare, or dressed."""

import json
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.loading import load_avatar
from physkin_core.formats.gltf_builder import GltfBuilder, write_glb
from physkin_core.model.garment import vertex_normals
from physkin_core.rig.canonical_pose import t_pose_rotations, turned_down_the_chain
from physkin_core.rig.vrm_bones import HUMANOID_BONES
from physkin_prepare.gltf_export import skinned_document

BODY = load_body_model()
RIG = BODY.rig
PERSON = avatar_from_body(BODY, BODY.held_out_bodies[0])


def person_document(**changes):
    """The person of held-out body 0 at the canonical pose, as a document that tests may change before writing."""
    arguments = {
        "vertices": PERSON.vertices,
        "faces": PERSON.faces,
        "joint_names": RIG.bone_names,
        "joint_parents": RIG.parents,
        "joint_heads": PERSON.bone_heads.astype(np.float64),
        "influence_joints": PERSON.influence_bones,
        "influence_weights": PERSON.influence_weights,
        **changes,
    }
    return skinned_document(**arguments)


def rig_json(heads, tails, *, weights=True, **extra):
    """A rig file's content for the person with bones there, with its skinning weights."""
    parents = [RIG.bone_names[parent] if parent >= 0 else None for parent in RIG.parents]
    rows = zip(RIG.bone_names, parents, heads.tolist(), tails.tolist())
    bones = [dict(zip(("name", "parent", "head", "tail"), row)) for row in rows]
    if weights:
        extra["influence_bones"] = PERSON.influence_bones.tolist()
        extra["influence_weights"] = PERSON.influence_weights.tolist()
    return {"bones": bones, **extra}


def load_document(tmp_path, builder, rig=RIG, name="person.glb"):
    write_glb(tmp_path / name, builder)
    return load_avatar(tmp_path / name, rig)


def skeleton_of(bones, heads):
    """Joints of some of the rig's bones: index in the rig, parents, heads (j, 3)."""
    bones = sorted({RIG.bone_index(bone) for bone in bones})
    parents = [next((bones.index(above) for above in RIG.ancestors(bone)[1:] if above in bones), -1) for bone in bones]
    return bones, np.array(parents), heads[bones]


def with_ends(bones, parents, heads):
    """Toes, and five fingers a hand, as joints of their own."""
    for side, way in (("L", 1.0), ("R", -1.0)):
        foot, wrist = (bones.index(RIG.bone_index(f"{bone}.{side}")) for bone in ("foot", "wrist"))
        more = [heads[foot] + [0.14, 0, -0.05]] + [heads[wrist] + [0.02 * k - 0.04, way * 0.09, 0] for k in range(5)]
        parents = np.concatenate([parents, [foot], [wrist] * 5])
        heads = np.concatenate([heads, more])
    return parents, heads


def primitive_of(builder):
    return builder.document["meshes"][0]["primitives"][0]


def distances(first, second):
    """Millimetres between corresponding points."""
    return 1000 * np.linalg.norm(np.asarray(first) - np.asarray(second), axis=-1)


def dense_weights(avatar):
    """Skinning weights (vertices, bones)."""
    dense = np.zeros((len(avatar.vertices), RIG.bone_count))
    np.add.at(dense, (np.arange(len(dense))[:, None], avatar.influence_bones), avatar.influence_weights)
    return dense


def write_gltf(path: Path, builder: GltfBuilder, *, buffer_uri: str) -> None:
    """Write the JSON alone; `buffer_uri` is where its buffer is found (a file beside it, or a data URI)."""
    document = {**builder.document, "buffers": [{**builder.document["buffers"][0], "uri": buffer_uri}]}
    path.write_text(json.dumps(document), encoding="utf-8")


# --- T-posed people, as VRMs are

LICENCE = "https://vrm.dev/licenses/1.0/"


def write_vrm(path, *, body_index=8, vrm_version="1.0"):
    """A held-out body as a VRM stands: T-pose as rest, feet on the ground, only the 20 humanoid joints. Version "0.x"
    faces -Z."""
    vertices, heads, _ = t_posed_body(BODY, BODY.held_out_bodies[body_index])
    turn = np.diag([-1.0, -1.0, 1.0]) if vrm_version == "0.x" else np.eye(3)
    vertices, heads = ((points + [0, 0, -vertices[:, 2].min()]) @ turn for points in (vertices, heads))
    role = {bone: name for name, bone in HUMANOID_BONES.items()}
    kept = [bone for bone, name in enumerate(RIG.bone_names) if name in role]
    joint = np.zeros(RIG.bone_count, dtype=np.int64)  # of each bone, its own or its nearest kept ancestor's
    for bone, parent in enumerate(RIG.parents):
        joint[bone] = kept.index(bone) if bone in kept else joint[parent]
    names = [role[RIG.bone_names[bone]] for bone in kept]
    builder = skinned_document(
        vertices,
        BODY.faces,
        [f"J_{name}" for name in names],
        [int(joint[RIG.parents[bone]]) if bone else -1 for bone in kept],
        heads[kept],
        joint[BODY.influence_bones],
        BODY.influence_weights,
    )
    make_vrm(builder, {name: node for node, name in enumerate(names)}, vrm_version)
    write_glb(path, builder)


def make_vrm(builder, nodes, version="1.0"):
    """Have a document say that it is a VRM. nodes: of its joints, by VRM humanoid bone."""
    if version == "1.0":
        bones = {bone: {"node": node} for bone, node in nodes.items()}
        meta = {"name": "PhySkin", "version": "1", "authors": ["PhySkin"], "licenseUrl": LICENCE}
        vrm = {"VRMC_vrm": {"specVersion": "1.0", "meta": meta, "humanoid": {"humanBones": bones}}}
    else:
        bones = [{"bone": bone, "node": node} for bone, node in nodes.items()]
        vrm = {"VRM": {"specVersion": "0.0", "meta": {"title": "PhySkin"}, "humanoid": {"humanBones": bones}}}
    builder.document |= {"extensions": vrm, "extensionsUsed": list(vrm)}


def t_posed_body(body, coefficients):
    """A body with arms straight out and legs straight down: vertices (V, 3), heads (b, 3), tails (b, 3)."""
    avatar, rig = avatar_from_body(body, coefficients), body.rig
    heads, tails = avatar.bone_heads.astype(np.float64), avatar.bone_tails.astype(np.float64)
    turns = t_pose_rotations(dict(zip(rig.bone_names, heads)))
    turns = {rig.bone_index(name): turn for name, turn in turns.items()}
    transforms, posed = turned_down_the_chain(heads, rig.parents, turns)
    tails = np.einsum("bij,bj->bi", transforms[..., :3], tails) + transforms[..., 3]
    return avatar.posed_vertices(transforms), posed, tails


# --- The person as makers of avatars dress theirs: skin where it is seen, clothes in meshes and materials of their own

SLEEVE, EASE = 0.045, 0.008
"""[m] How far sleeves and other clothes are from the skin."""
NORMALS = vertex_normals(PERSON.vertices, PERSON.faces)


def faces_on(*bones):
    """Faces of the person that hang on bones whose names begin so."""
    strongest = PERSON.influence_bones[np.arange(len(PERSON.vertices)), PERSON.influence_weights.argmax(axis=1)]
    chosen = [bone for bone, name in enumerate(RIG.bone_names) if name.startswith(bones)]
    return PERSON.faces[np.isin(strongest, chosen)[PERSON.faces].all(axis=1)]


TRUNK, ARMS, LEGS = (
    ("spine", "root", "clavicle", "breast", "pelvis"),
    ("upperarm", "lowerarm"),
    ("upperleg", "lowerleg"),
)
SLEEVES = {"short": ("upperarm",), "long": ARMS}


def add_part(builder, name, faces, *, offset=0.0, material=None, inwards=False):
    """A mesh of the person's faces, `offset` [m] (a number, or one a vertex) off the skin, in a node of its own.
    material: glTF's."""
    document, binary = builder.document, builder.document["meshes"][0]["primitives"][0]["attributes"]
    moved = PERSON.vertices + np.broadcast_to(offset, len(PERSON.vertices))[:, None] * NORMALS
    position = builder.add_accessor(moved[:, [1, 2, 0]].astype(np.float32))
    primitive = {"attributes": {**binary, "POSITION": position}}
    primitive["indices"] = builder.add_accessor(faces.astype(np.uint16).reshape(-1))
    if material is not None:
        document.setdefault("materials", []).append(material)
        primitive["material"] = len(document["materials"]) - 1
    document["meshes"].append({"name": name, "primitives": [primitive]})
    document["nodes"].append({"name": name, "mesh": len(document["meshes"]) - 1, "skin": 0})
    document["scenes"][0]["nodes"].append(len(document["nodes"]) - 1)


def plain(name, *colour, **more):
    """A material of one colour, linear RGB or RGBA."""
    colour = [*colour, *[1.0] * (4 - len(colour))]
    return {"name": name, "pbrMetallicRoughness": {"baseColorFactor": colour}, **more}


def dressed_document(*, sleeves="long", skin_beneath=False):
    """Ready Player Me's meshes and names: skin only where it is seen, a top, trousers, shoes, hair, eyes."""
    trunk_and_arms = faces_on(*TRUNK, *SLEEVES[sleeves])
    legs = faces_on(*LEGS)
    covered = {tuple(face) for face in np.concatenate([trunk_and_arms, legs, faces_on("foot")]).tolist()}
    seen = np.array([face for face in PERSON.faces.tolist() if skin_beneath or tuple(face) not in covered])
    builder = person_document(faces=seen)
    builder.document["meshes"][0]["name"] = builder.document["nodes"][-1]["name"] = "Wolf3D_Body"
    builder.document["materials"] = [plain("Wolf3D_Body", 0.5, 0.27, 0.18)]
    builder.document["meshes"][0]["primitives"][0]["material"] = 0
    wide = np.full(len(PERSON.vertices), EASE)
    wide[np.unique(faces_on(*SLEEVES[sleeves]))] = SLEEVE
    add_part(builder, "Wolf3D_Outfit_Top", trunk_and_arms, offset=wide, material=plain("Top", 0.6, 0.05, 0.05))
    add_part(builder, "Wolf3D_Outfit_Bottom", legs, offset=EASE, material=plain("Bottom", 0.05, 0.07, 0.25))
    add_part(builder, "Wolf3D_Outfit_Footwear", faces_on("foot"), offset=0.004, material=plain("Shoes", 0.1, 0.1, 0.1))
    head = faces_on("head")
    upper = head[PERSON.vertices[head][..., 2].min(axis=1) > PERSON.vertices[head][..., 2].max() - 0.12]
    add_part(builder, "Wolf3D_Hair", upper, offset=0.012, material=plain("Hair", 0.08, 0.04, 0.02))
    return builder

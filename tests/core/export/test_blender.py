"""Blender shows exported files as they are draped, and a .glb as the specification has it."""

import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest
from core.export.gltf_reader import Reader
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
FROM_GLTF = np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]])
"""Y up becomes Z up. USD is read as it is."""


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
    asked = ["-g", "trousers", "-g", "tshirt", "--materials", str(look), "--rate", str(RATE), "-o", str(path)]
    assert main(["export", "walk", *asked]) == 0
    found = in_blender(path)
    assert any("knit" in name for name in found["pictures"])
    expected = skinned(path) if kind == ".glb" else draped(models)
    for (name, frame), world in expected.items():
        shown = found[f"{name}/{frame}"]
        assert cKDTree(world).query(shown)[0].max() < CLOSE, (name, frame)
        if name != "body":  # skin under cloth is left out
            assert cKDTree(shown).query(world)[0].max() < CLOSE, (name, frame)


def skinned(path):
    """World positions of each mesh and frame as the glTF file has them."""
    reader = Reader(path)
    names = [mesh.name for mesh in reader.file.meshes]
    return {(name, frame): reader.skinned(name, frame) @ FROM_GLTF.T for name in names for frame in FRAMES}


def draped(models):
    """World positions of each mesh and frame as they are draped."""
    motion = load_motion("walk").resampled(RATE)
    outfit = Outfit(models, load_avatar(BUNDLED_AVATAR, models[0].rig))
    found = {}
    for frame, positions in enumerate(motion.positions_for(models[0].rig)[: FRAMES[-1] + 1]):
        clouds = outfit.drape(positions, time=motion.times[frame], root=motion.root[frame])
        if frame in FRAMES:
            turn = Rotation.from_quat(motion.root_orientation[frame])
            for name, points in zip(("body", "trousers", "tshirt"), (outfit.posed_body(positions), *clouds)):
                found[name, frame] = turn.apply(points[:, :3]) + motion.root_position[frame]
    return found

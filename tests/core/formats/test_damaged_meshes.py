"""A thousand damaged files for each reader of meshes: each is read, or refused in one sentence."""

from __future__ import annotations

import json

import pytest
import trimesh
from core.points.splat_files import splat_ply
from fuzzing import check_refusals
from gltf_person import PERSON, person_document, rig_json, write_gltf
from PIL import Image

from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.gltf_avatar import load_gltf
from physkin_core.avatar.rig_file import read_rig_file
from physkin_core.export.gltf_builder import write_glb
from physkin_core.file_reading import reading
from physkin_core.mesh.mesh_file import read_mesh
from physkin_core.model.garment import GarmentError, load_garment
from physkin_core.points.point_files import PointFileError, read_points

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]
SEEDS = range(1000)
BALL = trimesh.creation.icosphere(subdivisions=2)
LEAST = 50
"""Of a thousand, how many are refused at least; else nothing was damaged."""


@pytest.mark.parametrize("name", ["a.ply", "text.ply", "a.stl", "text.stl", "a.off"])
def test_surfaces(tmp_path, name):
    suffix = name.split(".")[1]
    kinds = {"text.ply": {"encoding": "ascii"}, "text.stl": {"file_type": "stl_ascii"}}
    BALL.export(tmp_path / name, **kinds.get(name, {"file_type": suffix}))
    assert check_refusals(read_mesh, tmp_path / name, GarmentError, SEEDS) > LEAST


@pytest.mark.parametrize("read", [read_mesh, load_garment, read_points])
def test_obj(tmp_path, read):
    """With texture coordinates, parts, a library and a picture."""
    Image.new("RGB", (8, 8)).save(tmp_path / "cloth.png")
    (tmp_path / "ball.mtl").write_text("newmtl cloth\nmap_Kd cloth.png\n")
    lines = ["mtllib ball.mtl", "o ball", "usemtl cloth"] + [f"v {x} {y} {z}" for x, y, z in BALL.vertices.tolist()]
    lines += [f"vt {x} {y}" for x, y, _ in BALL.vertices.tolist()]
    lines += [f"f {a}/{a} {b}/{b} {c}/{c}" for a, b, c in (BALL.faces + 1).tolist()]
    (tmp_path / "ball.obj").write_text("\n".join(lines))
    error = PointFileError if read is read_points else GarmentError
    assert check_refusals(read, tmp_path / "ball.obj", error, SEEDS) > LEAST


@pytest.mark.parametrize(("read", "error"), [(read_mesh, GarmentError), (read_points, PointFileError)])
def test_glb_of_garments_and_points(tmp_path, read, error):
    BALL.export(tmp_path / "ball.glb")
    assert check_refusals(read, tmp_path / "ball.glb", error, SEEDS) > LEAST


@pytest.mark.parametrize("layout", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_splats(tmp_path, layout):
    (tmp_path / "splats.ply").write_bytes(splat_ply(layout))
    assert check_refusals(read_points, tmp_path / "splats.ply", PointFileError, SEEDS) > LEAST


@pytest.mark.parametrize("name", ["person.glb", "person.gltf"])
def test_avatars(tmp_path, monkeypatch, name):
    """Up to the arrays of the file, which fitting a body to a mesh without bones would follow."""
    monkeypatch.setattr("physkin_core.avatar.gltf_avatar.retarget_plain_mesh", lambda *given, **told: None)
    monkeypatch.setattr("physkin_core.avatar.gltf_avatar.retarget", lambda *given: None)
    builder = person_document()
    if name.endswith(".glb"):
        write_glb(tmp_path / name, builder)
    else:
        (tmp_path / "person.bin").write_bytes(builder.binary)
        write_gltf(tmp_path / name, builder, buffer_uri="person.bin")

    def read(path):
        with reading(f"avatar {path}", AvatarError):
            load_gltf(path, None)

    assert check_refusals(read, tmp_path / name, AvatarError, SEEDS) > LEAST


def test_rig_files(tmp_path):
    bones = rig_json(PERSON.bone_heads, PERSON.bone_tails, weights=False)
    (tmp_path / "me.rig.json").write_text(json.dumps(bones))
    assert check_refusals(read_rig_file, tmp_path / "me.rig.json", AvatarError, SEEDS) > LEAST

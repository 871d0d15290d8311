"""A garment file's texture coordinates, materials, pictures and parts are in what is written."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from PIL import Image
from training.small_runs import write_belly_band

from physkin_core import load_garment
from physkin_core.mesh.mesh_file import read_mesh
from physkin_training.fit_garment.checks import check_garment, write_garment


@pytest.fixture
def band(tmp_path):
    """A band about the waist of the garment maker's body: vertices (n, 3) and faces (f, 3)."""
    write_belly_band(tmp_path / "plain.obj")
    garment = load_garment(tmp_path / "plain.obj")
    return garment.vertices, garment.faces


def places(vertices):
    """Texture places (n, 2) that tell where a vertex is."""
    return np.column_stack([vertices[:, 1] + 0.5, vertices[:, 2] + 0.5])


def write_textured_obj(folder, vertices, faces):
    """Two parts of two materials, one with a picture; a third of the faces turned; the lower part has no texture."""
    (folder / "textures").mkdir()
    Image.new("RGB", (4, 4), "red").save(folder / "textures" / "knit.png")
    (folder / "cloth.mtl").write_text("newmtl knit wool\nmap_Kd textures/knit.png\nnewmtl plain\nKd 1 0 0\n")
    lines = ["mtllib cloth.mtl"] + [f"v {x:.6f} {y:.6f} {z:.6f}" for x, y, z in vertices.tolist()]
    lines += [f"vt {u:.6f} {v:.6f}" for u, v in places(vertices).tolist()]
    upper = vertices[faces, 2].mean(axis=1) > 0.12
    for name, material, chosen in (("yoke", "knit wool", upper), ("hem", "plain", ~upper)):
        lines += [f"o {name}", f"usemtl {material}"]
        corner = "{0}/{0}" if name == "yoke" else "{0}"
        for a, b, c in (faces[chosen] + 1).tolist():
            order = (a, b, c) if a % 3 else (a, c, b)
            lines.append("f " + " ".join(corner.format(vertex) for vertex in order))
    (folder / "band.obj").write_text("\n".join(lines) + "\n")
    return upper


def test_an_obj_keeps_its_look(band, template, tmp_path):
    """Through turned faces and faces cut in four."""
    vertices, faces = band
    upper = write_textured_obj(tmp_path, vertices, faces)
    mesh = read_mesh(tmp_path / "band.obj")
    assert str(mesh.look) == "UVs, 2 materials, 2 parts"
    checked = check_garment(mesh, template, template)
    assert not checked.refused
    (tmp_path / "out").mkdir()
    write_garment(tmp_path / "out" / "garment.obj", checked)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == ["garment.mtl", "garment.obj", "knit.png"]
    assert "map_Kd knit.png" in (tmp_path / "out" / "garment.mtl").read_text()
    text = (tmp_path / "out" / "garment.obj").read_text()
    assert [line for line in text.splitlines() if line[0] in "mou"] == [
        "mtllib garment.mtl", "o yoke", "usemtl knit wool", "o hem", "usemtl plain",
    ]  # fmt: skip
    again = read_mesh(tmp_path / "out" / "garment.obj")
    textured = np.isfinite(again.look.uv).all(axis=(1, 2))
    np.testing.assert_array_equal(textured, again.look.part == 0)
    assert textured.mean() == pytest.approx(upper.mean(), abs=0.01)
    expected = places(again.vertices)[again.faces[textured]]
    np.testing.assert_allclose(again.look.uv[textured], expected, atol=2e-4)
    read = load_garment(tmp_path / "out" / "garment.obj")
    np.testing.assert_array_equal(read.vertices, checked.garment.vertices)
    np.testing.assert_array_equal(read.faces, checked.garment.faces)


def test_a_glb_of_two_meshes_keeps_its_look(band, template, tmp_path):
    """Its meshes are one garment again, and textures come out as pictures."""
    vertices, faces = band
    scene = trimesh.Scene()
    upper = vertices[faces, 2].mean(axis=1) > 0.12
    for name, chosen in (("yoke", upper), ("hem", ~upper)):
        used, own = np.unique(faces[chosen], return_inverse=True)
        picture = Image.new("RGB", (4, 4), "green")
        material = trimesh.visual.material.PBRMaterial(name=f"{name} cloth", baseColorTexture=picture)
        visual = trimesh.visual.TextureVisuals(uv=places(vertices[used]), material=material)
        mesh = trimesh.Trimesh(vertices[used], own.reshape(-1, 3), visual=visual, process=False)
        scene.add_geometry(mesh, node_name=name)
    scene.export(tmp_path / "band.glb")
    mesh = read_mesh(tmp_path / "band.glb")
    assert len(mesh.vertices) == len(vertices) and str(mesh.look) == "UVs, 2 materials, 2 parts"
    checked = check_garment(mesh, template, template)
    write_garment(tmp_path / "garment.obj", checked)
    again = read_mesh(tmp_path / "garment.obj")
    assert sorted(again.look.parts) == ["hem", "yoke"] and sorted(again.look.materials) == ["hem_cloth", "yoke_cloth"]
    assert (tmp_path / "yoke_cloth.png").is_file() and (tmp_path / "hem_cloth.png").is_file()
    np.testing.assert_allclose(again.look.uv, places(again.vertices)[again.faces], atol=2e-4)

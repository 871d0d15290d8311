"""`physkin bind-points`."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from core.points.splat_files import splat_ply

from physkin_core import BUNDLED_AVATAR, Draper, SplatDraper, cli, load_avatar, load_motion
from physkin_core.points.point_files import read_points

pytestmark = pytest.mark.filterwarnings("ignore::physkin_core.AvatarWarning")


@pytest.fixture(scope="module")
def draper(garment_model):
    return Draper(garment_model, load_avatar(BUNDLED_AVATAR, garment_model.rig))


@pytest.fixture(scope="module")
def pose(garment_model):
    motion = load_motion("kick")
    return motion.positions_for(garment_model.rig)[20], motion.gravity[20]


def test_mesh_in_its_own_axes_and_unit(model_path, garment_model, draper, pose, tmp_path):
    """The garment's own mesh is draped as the garment is, and comes back in centimetres, Y up."""
    vertices = 100 * garment_model.garment.vertices[:, [1, 2, 0]]
    trimesh.Trimesh(vertices, garment_model.garment.faces, process=False).export(tmp_path / "in.obj")
    arguments = ["bind-points", str(model_path), str(tmp_path / "in.obj"), "--motion", "kick", "--frame", "20"]
    assert cli.main([*arguments, "--up", "Y", "--scale", "0.01", "-o", str(tmp_path / "out.obj")]) == 0
    expected = 100 * draper.drape(*pose)[:, [1, 2, 0]]
    np.testing.assert_allclose(read_points(tmp_path / "out.obj").points, expected, atol=2e-3)


def test_normals_of_a_mesh_turn_with_it(model_path, garment_model, draper, pose, tmp_path):
    """Of a GLB, which is Y up by its standard."""
    garment = garment_model.garment
    mesh = trimesh.Trimesh(garment.vertices[:, [1, 2, 0]], garment.faces, process=False)
    mesh.export(tmp_path / "in.glb", include_normals=True)
    arguments = ["bind-points", str(model_path), str(tmp_path / "in.glb"), "--motion", "kick", "--frame", "20"]
    assert cli.main([*arguments, "-o", str(tmp_path / "out.glb")]) == 0
    given = {"points": garment.vertices, "point_normals": mesh.vertex_normals[:, [2, 0, 1]]}
    expected = Draper(garment_model, draper.avatar, **given).drape(*pose)
    found = read_points(tmp_path / "out.glb")
    np.testing.assert_allclose(found.points, expected[:, [1, 2, 0]], atol=2e-5)
    np.testing.assert_allclose(found.normals, expected[:, [4, 5, 3]], atol=1e-3)


def test_splats_of_every_frame(model_path, garment_model, draper, tmp_path, capsys):
    """Numbered files of what `SplatDraper` gives."""
    source = tmp_path / "in.ply"
    source.write_bytes(splat_ply("binary_little_endian", garment_model.garment.vertices[::50]))
    arguments = ["bind-points", str(model_path), str(source), "--motion", "kick", "--rate", "5", "--all"]
    assert cli.main([*arguments, "-o", str(tmp_path / "out.ply")]) == 0
    motion = load_motion("kick").resampled(5)
    files = sorted(tmp_path.glob("out_*.ply"))
    assert [file.name for file in files] == [f"out_{frame:04d}.ply" for frame in range(motion.frame_count)]
    assert f"out_0000.ply to {files[-1].name}" in capsys.readouterr().out
    splats = SplatDraper(garment_model, draper.avatar, read_points(source).splats)
    expected = splats.drape(motion.positions_for(garment_model.rig)[3], motion.gravity[3])
    found = read_points(files[3]).splats
    np.testing.assert_allclose(found.centres, expected.centres, atol=1e-5)
    np.testing.assert_allclose(found.scales, expected.scales, rtol=1e-3)


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["-o", "out.obj"], "cannot write out.obj: the name must end in .ply"),
        (["--scale", "0", "-o", "out.ply"], "--scale is 0.0; allowed: a number above 0"),
        (["--up", "W", "-o", "out.ply"], "--up W: allowed are two different axes of X, -X"),
        (["--up", "Y", "--forward=-Y", "-o", "out.ply"], "--up Y --forward -Y: allowed are two different axes"),
        (["--frame", "999", "-o", "out.ply"], "has frames 0 to"),
        (["--scale", "100", "-o", "out.ply"], "in.ply: point"),
        (["-o", "{tmp}/none/out.ply"], "No such file or directory"),
    ],
)
def test_errors_are_one_line(arguments, reason, model_path, garment_model, tmp_path, capsys):
    source = tmp_path / "in.ply"
    source.write_bytes(splat_ply("ascii", garment_model.garment.vertices[::50]))
    told = [word.format(tmp=tmp_path) for word in arguments]
    assert cli.main(["bind-points", str(model_path), str(source), *told]) == 2
    lines = capsys.readouterr().err.splitlines()
    assert lines[-1].startswith("error: ") and reason in lines[-1]

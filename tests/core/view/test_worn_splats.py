"""Splats on the page: in place of the garment that they lie on, where a `SplatDraper` has them."""

import numpy as np
import pytest
from core.points.splat_files import FIELDS, splat_ply, splat_table
from scipy.spatial.transform import Rotation

from physkin_core import BUNDLED_AVATAR, SplatDraper, load_avatar, load_garment_model
from physkin_core.points.point_files import read_splat_file, splat_colours
from physkin_core.view.scene.scene_state import SceneState

COUNT = 300


@pytest.fixture(scope="module")
def shirt():
    return load_garment_model("tanktop")


@pytest.fixture(scope="module")
def splats(tmp_path_factory, shirt):
    """A file of splats on the T-shirt."""
    path = tmp_path_factory.mktemp("splats") / "shirt.ply"
    path.write_bytes(splat_ply("binary_little_endian", shirt.garment.vertices[:COUNT]))
    return path


def test_splats_follow_every_frame(asset_loader, shirt, splats):
    """Sliders move them as they do those of a draper; once their garment is off, there are none."""
    state = SceneState(asset_loader, ["tanktop"], points=splats)
    assert state.has_splats
    state.set_joint(state.rig.joint_names.index("upperarm01.L_x"), 0.5)
    frame = state.advance(0.0)
    alone = SplatDraper(shirt, load_avatar(BUNDLED_AVATAR, shirt.rig), read_splat_file(splats).splats)
    down = Rotation.from_quat(frame.pose.root_orientation).inv().apply([0.0, 0.0, -1.0])
    wanted = alone.drape(frame.pose.positions, down)
    np.testing.assert_allclose(frame.splats.splats.centres, wanted.centres, atol=2e-5)
    np.testing.assert_allclose(frame.splats.splats.covariances(), wanted.covariances(), atol=1e-8)
    assert frame.splats.garment == 0 and frame.splats.colours.shape == (COUNT, 3)
    state.wear(["trousers", "tanktop"])
    assert state.advance(0.0).splats.garment == 1
    state.wear(["trousers"])
    assert state.advance(0.0).splats is None


def test_files_that_cannot_be_used_are_told(asset_loader, tmp_path, shirt, splats):
    """Before there is a page."""
    (tmp_path / "far.ply").write_bytes(splat_ply("ascii", shirt.garment.vertices[:COUNT] + [0, 0, 1]))
    with pytest.raises(ValueError, match=r"far.ply: point .* from garment 'tanktop'"):
        SceneState(asset_loader, ["tanktop"], points=tmp_path / "far.ply")
    (tmp_path / "cloud.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 1\n"
        "property float x\nproperty float y\nproperty float z\nend_header\n0 0 0\n"
    )
    with pytest.raises(ValueError, match="cloud.ply as points: they are no Gaussian splats"):
        SceneState(asset_loader, ["tanktop"], points=tmp_path / "cloud.ply")


def test_colours_and_opacity_of_splats(splats):
    """As the first harmonics and the logistic function have them; without any, the garment's colour, opaque."""
    table = splat_table(count=COUNT)
    colours, opacity = splat_colours(read_splat_file(splats).look, COUNT)
    first, place = FIELDS.index("f_dc_0"), FIELDS.index("opacity")
    np.testing.assert_allclose(colours, np.clip(0.5 + 0.2820948 * table[:, first : first + 3], 0, 1), atol=1e-6)
    np.testing.assert_allclose(opacity, 1 / (1 + np.exp(-table[:, place].astype(float))), atol=1e-6)
    colours, opacity = splat_colours(None, 4)
    assert colours is None and (opacity == 1).all()

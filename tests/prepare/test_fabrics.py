"""What fabrics look like is made as it is shipped."""

import numpy as np
import pytest

from physkin_core.look.cloth_look import FABRICS_PATH

Image = pytest.importorskip("PIL.Image", reason="needs pillow: pip install 'physkin[view]'")
fabrics = pytest.importorskip("physkin_prepare.fabrics")


def test_the_shipped_tiles_are_what_is_made(tmp_path):
    """But for single pixels, which rounding moves on another machine."""
    fabrics.main(["--output", str(tmp_path)])
    assert {file.name for file in tmp_path.iterdir()} == {file.name for file in FABRICS_PATH.iterdir()}
    assert (tmp_path / "garment.mtl").read_text() == (FABRICS_PATH / "garment.mtl").read_text()
    for file in tmp_path.glob("*.png"):
        made, shipped = (np.asarray(Image.open(path)).astype(int) for path in (file, FABRICS_PATH / file.name))
        assert (made != shipped).mean() < 0.001, file.name


@pytest.mark.parametrize("name", fabrics.FABRIC_TILES)
def test_tiles_fit_together(name):
    """The step over an edge is no larger than those within."""
    shade = np.asarray(Image.open(FABRICS_PATH / f"{name}.png")).astype(float)
    for axis in (0, 1):
        steps = np.abs(np.roll(shade, -1, axis) - shade).mean(axis=1 - axis)
        assert steps[-1] <= steps[:-1].max() * 1.2

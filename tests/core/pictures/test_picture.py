"""Pictures: what is drawn where, sheets, and the errors. Rendering needs the `[view]` extra."""

import sys

import numpy as np
import pytest

from physkin_core.pictures.picture import BACKGROUND, CLOTH_COLOUR, Mesh, PictureError, contact_sheet, render, save_png

PAPER = round(255 * BACKGROUND)
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
QUADS = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
CUBE = Mesh(CORNERS, np.array([[q[0], *q[k : k + 2]] for q in QUADS for k in (1, 2)]), CLOTH_COLOUR)
SMALL = {"size": (48, 60), "samples": 4}


def moved(offset):
    """The cube, elsewhere."""
    return Mesh(CUBE.vertices + offset, CUBE.faces, CUBE.colour)


def blue(image):
    """(h, w) where the cube's colour shows."""
    return image[..., 2].astype(int) - image[..., 0] > 40


def test_cube_stands_in_the_middle_of_light_paper():
    """The mesh fills the picture's middle in its own colour; the corners above are plain."""
    pytest.importorskip("mitsuba")
    image = render([CUBE], **SMALL)
    assert image.shape == (60, 48, 3)
    assert image.dtype == np.uint8
    assert blue(image)[25:35, 18:30].all()
    assert np.abs(image[:4].astype(int) - PAPER).max() <= 1
    assert (image[-1].min(axis=-1) > 140).all()
    assert render([CUBE], floor=None, **SMALL)[-1].min() == PAPER


@pytest.mark.parametrize(("azimuth", "side"), [(0.0, "right"), (180.0, "left")])
def test_camera_goes_around(azimuth, side):
    """From the front, Y (the body's left) is on the picture's right; from behind on its left."""
    pytest.importorskip("mitsuba")
    bounds = np.array([[-1.5, -1.5, -1.5], [1.5, 1.5, 1.5]])
    seen = blue(render([moved([0.0, 0.9, 0.0])], azimuth=azimuth, elevation=0, bounds=bounds, floor=None, **SMALL))
    assert seen[:, 24:].any() == (side == "right")
    assert seen[:, :24].any() == (side == "left")


def test_everything_fits():
    """A tall and a wide box stay inside the picture whichever way the camera looks."""
    pytest.importorskip("mitsuba")
    for stretch in ([1, 1, 8], [8, 1, 1], [1, 8, 1]):
        seen = blue(render([Mesh(CORNERS * stretch, CUBE.faces, CLOTH_COLOUR)], azimuth=35, floor=None, **SMALL))
        assert seen.any()
        assert not (seen[0].any() or seen[-1].any() or seen[:, 0].any() or seen[:, -1].any())


def test_faces_have_their_own_colours():
    """Of a cube seen from the front, Y (its left, on the picture's right) is red and the rest the cloth's blue."""
    pytest.importorskip("mitsuba")
    red = CORNERS[CUBE.faces].mean(axis=1)[:, 1] > 0.4
    colours = np.where(red[:, None], (0.8, 0.1, 0.1), CLOTH_COLOUR)
    image = render([Mesh(CORNERS, CUBE.faces, colours)], azimuth=45, elevation=0, floor=None, **SMALL).astype(int)
    assert (image[25:35, 28:34, 0] > image[25:35, 28:34, 2] + 40).all()
    assert (image[25:35, 14:20, 2] > image[25:35, 14:20, 0] + 15).all()


@pytest.mark.parametrize(
    ("mesh", "message"),
    [
        (Mesh(np.zeros((3, 2)), np.array([[0, 1, 2]])), "vertices"),
        (Mesh(np.zeros((3, 3)), np.zeros((0, 3), dtype=int)), "faces"),
        (Mesh(np.full((3, 3), np.nan), np.array([[0, 1, 2]])), "not finite"),
        (Mesh(np.zeros((3, 3)), np.array([[0, 1, 3]])), "0 to 3.*3 vertices"),
        (Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.zeros((2, 3))), r"one a face \(1, 3\), got \(2, 3\)"),
    ],
)
def test_meshes_that_cannot_be_drawn(mesh, message):
    """The error says what is wrong with the mesh."""
    pytest.importorskip("mitsuba")
    with pytest.raises(ValueError, match=message):
        render([mesh], **SMALL)
    with pytest.raises(ValueError, match="nothing to draw"):
        render([])


def test_missing_extra_says_what_to_install(monkeypatch, tmp_path):
    """Without mitsuba or pillow the error names the extra."""
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(PictureError, match=r"mitsuba.*\[view\]"):
        render([CUBE])
    with pytest.raises(PictureError, match=r"pillow.*\[view\]"):
        save_png(tmp_path / "a.png", np.zeros((2, 2, 3), dtype=np.uint8))


def test_contact_sheet_lays_out_rows():
    """Three pictures in two columns: two rows, the last cell empty. Refused: no pictures, no columns, differing sizes,
    a caption too few."""
    pictures = [np.full((10, 20, 3), value, dtype=np.uint8) for value in (10, 20, 30)]
    sheet = contact_sheet(pictures, columns=2, gap=4)
    assert sheet.shape == (2 * 14 + 4, 2 * 24 + 4, 3)
    cells = [sheet[row : row + 10, column : column + 20] for row in (4, 18) for column in (4, 28)]
    assert all((cell == value).all() for cell, value in zip(cells, (10, 20, 30, PAPER)))
    for wrong, options, message in (
        ([], dict(columns=2), "at least one picture"),
        (pictures, dict(columns=0), "one column, got 3 and 0"),
        ([pictures[0], pictures[0][:2]], dict(columns=2), "one size"),
        (pictures, dict(columns=2, captions=["a"]), "3 pictures but 1 captions"),
    ):
        with pytest.raises(ValueError, match=message):
            contact_sheet(wrong, **options)


def test_captions_are_written_under_the_pictures(tmp_path):
    """The caption leaves ink below its picture and nowhere else; the file reads back the same."""
    image_module = pytest.importorskip("PIL.Image")
    pictures = [np.full((30, 80, 3), PAPER, dtype=np.uint8)] * 2
    sheet = contact_sheet(pictures, columns=2, captions=["walk", ""], gap=4)
    assert (sheet[:34] == PAPER).all()
    assert (sheet[34:, :84] < 128).any()
    assert (sheet[:, 86:] == PAPER).all()
    save_png(tmp_path / "sheet.png", sheet)
    np.testing.assert_array_equal(np.asarray(image_module.open(tmp_path / "sheet.png")), sheet)

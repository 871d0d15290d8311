"""An exported file in a real browser: three.js, by the loader that pages use, shows it."""

import io
import time

import numpy as np
import pytest
from browser import CHROMIUM, Browser

from physkin_core.cli import main

ONTO_ITS_FEET = (0.5**0.5, 0.5**0.5, 0.0, 0.0)
"""Quaternion w, x, y, z from glTF's Y up to viser's Z up."""


@pytest.fixture
def browser():
    if CHROMIUM is None:
        pytest.skip("needs chromium: apt-get install chromium")
    opened = Browser(size=(1400, 640))
    yield opened
    opened.close()


def test_three_js_shows_the_file(tmp_path, browser):
    """A figure from head to foot, clothes in their colour, and a silent console."""
    viser = pytest.importorskip("viser", reason="needs viser: pip install 'physkin[view]'")
    assert main(["export", "walk", "-g", "tshirt", "--rate", "10", "-o", str(tmp_path / "walk.glb")]) == 0
    server = viser.ViserServer(port=8395, verbose=False)
    try:
        server.initial_camera.position, server.initial_camera.look_at = (0.0, -2.6, 0.9), (0.0, 0.0, 0.9)
        browser.open(f"http://localhost:{server.get_port()}")
        browser.wait("document.querySelector('canvas') !== null")
        assert (middle(browser) > 240).all(), "nothing there yet"
        server.scene.add_glb("/walk", (tmp_path / "walk.glb").read_bytes(), wxyz=ONTO_ITS_FEET)
        end = time.monotonic() + 30
        while not is_a_person_in_blue(middle(browser)):  # it walks: no picture is like the one before
            assert time.monotonic() < end, "no person in a blue shirt is shown"
            time.sleep(0.3)
        assert browser.errors == []
    finally:
        server.stop()


def middle(browser):
    """(h, w, 3) pixels between the page's notice and its panel."""
    image = pytest.importorskip("PIL.Image").open(io.BytesIO(browser.picture())).convert("RGB")
    return np.array(image)[:, 420:980].astype(int)


def is_a_person_in_blue(picture):
    """As high as one is in this picture, and not all of it is the shirt."""
    drawn = picture.min(axis=2) < 240
    blue = drawn & (picture[..., 2] > picture[..., 0] + 30)
    return 0.5 < drawn.any(axis=1).mean() < 0.9 and 0.1 < blue.sum() / drawn.sum() < 0.6

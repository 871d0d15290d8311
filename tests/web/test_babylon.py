"""Clothes in Babylon, as docs/browser.md puts them there, in a real browser."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, Browser, served

from import_graph import ROOT
from physkin_core import BUNDLED_AVATAR
from physkin_core.cli import main

PACKAGE = ROOT / "build" / "web"

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="needs chromium: apt-get install chromium"),
    pytest.mark.skipif(not (PACKAGE / "made").exists(), reason="needs `make wasm`: emscripten and npm"),
]


def test_clothes_are_drawn_and_move(tmp_path):
    """A red shirt above blue trousers, arms out; a leg that is raised takes the trousers along."""
    bound = tmp_path / "outfit.physkin"
    assert main(["bind", str(BUNDLED_AVATAR), "-g", "trousers", "-g", "tshirt", "-o", str(bound)]) == 0
    for file in (*PACKAGE.glob("*.js"), PACKAGE / "physkin.wasm", Path(__file__).with_name("babylon.html")):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "node_modules").symlink_to(PACKAGE / "node_modules")
    with served(tmp_path) as address:
        browser = Browser(size=(600, 800))
        try:
            browser.open(f"{address}/babylon.html")
            browser.wait("window.shown === 1", seconds=60)
            stands = picture(browser)
            browser.value("window.step({ 'upperleg01.L_y': -1.2 })")
            raised = picture(browser)
            assert browser.errors == []
        finally:
            browser.close()
    shirt, trousers = red(stands), red(stands[..., ::-1])
    assert 0.02 < shirt.mean() < 0.3 and 0.05 < trousers.mean() < 0.4
    assert np.argwhere(shirt)[:, 0].mean() + 100 < np.argwhere(trousers)[:, 0].mean()
    assert (trousers != red(raised[..., ::-1])).sum() > 0.1 * trousers.sum()
    assert (shirt != red(raised)).sum() < 0.2 * shirt.sum()  # the knee covers some of its hem


def picture(browser):
    """(h, w, 3) pixels."""
    image = pytest.importorskip("PIL.Image").open(io.BytesIO(browser.picture())).convert("RGB")
    return np.array(image).astype(int)


def red(pixels):
    return pixels[..., 0] > pixels[..., 2] + 60

"""A VRM avatar that @pixiv/three-vrm loads and poses wears our clothes, in a real browser."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, Browser, served
from gltf_person import write_vrm

from import_graph import ROOT
from physkin_core.cli import main

PACKAGE = ROOT / "build" / "web"

pytestmark = [
    pytest.mark.skipif(CHROMIUM is None, reason="needs chromium: apt-get install chromium"),
    pytest.mark.skipif(not (PACKAGE / "made").exists(), reason="needs `make wasm`: emscripten and npm"),
]


def test_a_posed_avatar_is_dressed(tmp_path):
    """In VRM 1.0 and 0.x, whose models look the other way, alike: seen from ahead cloth is before the trunk."""
    for name, version in (("one", "1.0"), ("zero", "0.x")):
        write_vrm(tmp_path / f"{name}.vrm", vrm_version=version)
        bound = tmp_path / f"{name}.physkin"
        assert main(["bind", str(tmp_path / f"{name}.vrm"), "-g", "trousers", "-g", "tshirt", "-o", str(bound)]) == 0
    for file in (*PACKAGE.glob("*.js"), PACKAGE / "physkin.wasm", Path(__file__).with_name("vrm.html")):
        (tmp_path / file.name).write_bytes(file.read_bytes())
    (tmp_path / "node_modules").symlink_to(PACKAGE / "node_modules")
    with served(tmp_path) as address:
        pictures = [shown(f"{address}/vrm.html?name={name}") for name in ("one", "zero")]
    figures = [picture.min(axis=2) < 250 for picture in pictures]
    cloths = [figure & (picture[..., 0] > picture[..., 1] + 150) for figure, picture in zip(figures, pictures)]
    for figure, cloth in zip(figures, cloths):
        assert 0.6 < cloth.sum() / figure.sum() < 0.9
    assert (cloths[0] != cloths[1]).sum() < 0.02 * cloths[0].sum()


def shown(address):
    """(h, w, 3) pixels of a page."""
    browser = Browser(size=(700, 800))
    try:
        browser.open(address)
        browser.wait("window.shown === true")
        image = pytest.importorskip("PIL.Image").open(io.BytesIO(browser.picture())).convert("RGB")
        return np.array(image).astype(int)
    finally:
        browser.close()

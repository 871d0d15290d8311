"""`physkin export --web`: a page of static files, in a real browser."""

from __future__ import annotations

import io
import json
import time

import numpy as np
import pytest
from browser import CHROMIUM, Browser, served

from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model
from physkin_core.cli import main
from physkin_core.export import web_page
from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME

GARMENTS = ("trousers", "tshirt")
SIZE = (1000, 700)

made = pytest.mark.skipif(not web_page.PAGE.is_dir(), reason="needs `make wasm`: emscripten and npm")


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The page of a walk in wind."""
    folder = tmp_path_factory.mktemp("page")
    worn = [word for name in GARMENTS for word in ("-g", name)]
    assert main(["export", "walk", *worn, "--rate", "20", "--wind", "2", "-1", "0", "--web", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def browser(folder):
    """With the page loaded."""
    if CHROMIUM is None:
        pytest.skip("needs chromium: apt-get install chromium")
    with served(folder) as address:
        opened = Browser(size=SIZE)
        opened.open(address)
        opened.wait("window.shown !== undefined", seconds=120)
        yield opened
        opened.close()


@made
def test_files_are_small(folder):
    """At most 2.65 MB a garment on the wire, 0.15 of it to keep it out of the skin, and 0.3 more of one that sways;
    nothing that was only needed on the way."""
    swaying = [name for name in GARMENTS if load_garment_model(name).sway is not None]
    assert (folder / "outfit.physkin.gz").stat().st_size < 2.65e6 * len(GARMENTS) + 0.3e6 * len(swaying)
    assert not (folder / "outfit.physkin").exists()


@made
def test_wind_of_the_command_blows_on_the_page(folder):
    assert json.loads((folder / "motion.json").read_text())["wind"] == [-1.0, 0.0, 2.0]


@made
def test_cloth_in_the_browser_is_the_native_one(browser, monkeypatch):
    """0.1 mm from it on average: the browser has no fused multiply-adds, so that an activation may be rounded the other
    way, layer after layer, and contact takes another plane where two are equally deep: 0.4 mm at most."""
    monkeypatch.setenv("PHYSKIN_NATIVE_ISA", "baseline")
    models = [load_garment_model(name) for name in GARMENTS]
    outfit = Outfit(models, load_avatar(BUNDLED_AVATAR, models[0].rig), hide_covered=False)
    pose = {"lowerarm01.L_z": -1.0, "upperleg01.R_y": -0.6}
    found = browser.value(
        "import('./physkin.js').then(({loadOutfit}) => loadOutfit('outfit.physkin.gz')).then((outfit) => {"
        f"outfit.step({pose});"
        "return outfit.garments.map(({positions}) => Array.from(positions)); })"
    )
    for positions, wanted in zip(found, outfit.drape(pose)):
        cloth = np.reshape(positions, (-1, 3)) @ FROM_ROOT_FRAME
        off = np.linalg.norm(cloth - wanted[:, :3], axis=1)
        assert off.mean() < 1e-4 and off.max() < 4e-4


@made
def test_the_page_shows_a_dressed_avatar(browser):
    """A figure from head to foot in a red shirt, which can be taken off; a silent console."""
    end = time.monotonic() + 60
    while not is_a_person(picture(browser)):
        assert time.monotonic() < end, "no person is shown"
        time.sleep(0.3)
    assert red(picture(browser)).mean() > 0.02
    browser.click("document.querySelectorAll('#garments input')[1]")
    end = time.monotonic() + 30
    while red(picture(browser)).mean() > 0.002:
        assert time.monotonic() < end, "the shirt is still there"
        time.sleep(0.3)
    browser.click("document.querySelectorAll('#garments input')[1]")
    assert browser.errors == []


@made
def test_a_fabric_is_chosen(browser):
    """Of the shirt; the trousers keep theirs."""
    choice = "document.querySelectorAll('#fabrics select')[1]"
    browser.value(f"{choice}.value = 'leather'; {choice}.dispatchEvent(new Event('change'))")
    assert browser.value("window.shown.outfit.garments.map(({fabric}) => fabric)") == ["jersey", "leather"]
    browser.value(f"{choice}.value = 'jersey'; {choice}.dispatchEvent(new Event('change'))")
    assert browser.errors == []


@made
def test_sliders_and_pause(browser):
    """The motion stands still when paused; a slider bends an arm, and all go back to rest."""
    browser.click("document.getElementById('play')")
    first = browser.value("window.shown.player.after(1).positions")
    assert browser.value("window.shown.player.after(1).positions") == first
    joint = browser.value("window.shown.outfit.joints.findIndex(({name}) => name === 'lowerarm01.L_z')")
    slider = f"document.querySelectorAll('#joints input')[{joint}]"
    browser.value(f"{slider}.value = -0.5; {slider}.dispatchEvent(new Event('input'))")
    bent = browser.value("window.shown.player.after(0).positions")
    assert bent[joint] == pytest.approx(first[joint] - 0.5, abs=1e-6)
    browser.click("document.getElementById('rest')")
    assert browser.value("window.shown.player.after(0).positions") == first
    browser.click("document.getElementById('play')")


def picture(browser):
    """(h, w, 3) pixels left of the panel."""
    image = pytest.importorskip("PIL.Image").open(io.BytesIO(browser.picture())).convert("RGB")
    return np.array(image)[:, :720].astype(int)


def red(pixels):
    return pixels[..., 0] > pixels[..., 2] + 60


def is_a_person(pixels):
    """As high as one is in this picture."""
    return 0.5 < (pixels.min(axis=2) < 200).any(axis=1).mean() < 0.95


def test_an_installation_without_the_module_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(web_page, "PAGE", tmp_path / "none")
    assert main(["export", "walk", "-g", "tshirt", "--web", str(tmp_path / "page")]) == 2
    assert "`make wasm` makes it" in capsys.readouterr().err
    assert not (tmp_path / "page").exists()


def test_a_file_is_no_folder(tmp_path, capsys):
    (tmp_path / "page").touch()
    assert main(["export", "walk", "-g", "tshirt", "--web", str(tmp_path / "page")]) == 2
    assert "it is a file; name a folder" in capsys.readouterr().err

"""The page in a real browser, and what happens to errors on it."""

from __future__ import annotations

import io
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures.process import BrokenProcessPool

import numpy as np
import pytest
from browser import CHROMIUM, Browser

from physkin_core import cli
from physkin_core.model.model_file import MODELS_PATH
from physkin_core.view.scene.figures import look_at_contact
from physkin_core.view.scene.scene_state import SceneState

pytest.importorskip("viser", reason="needs viser: pip install 'physkin[view]'")

from physkin_core.view.page import Page, Readout  # noqa: E402
from physkin_core.view.viewer import Viewer  # noqa: E402

JOINT = "clavicle.L_x"
"""The first slider of the left arm."""


@pytest.fixture(scope="module")
def shown(asset_loader):
    """A T-shirt on a page that runs: page and state."""
    state, page = SceneState(asset_loader, ["tshirt"], motion="walk"), Page(port=8380)
    viewer = Viewer(page, state, motion="walk")
    running = threading.Thread(target=page.run, args=(viewer.tick,))
    running.start()
    yield page, state
    page.end()
    running.join()
    viewer.close()


@pytest.fixture(scope="module")
def browser(shown):
    """With the page loaded, the motion paused."""
    if CHROMIUM is None:
        pytest.skip("needs chromium: apt-get install chromium")
    page, state = shown
    opened = Browser(size=(1000, 560))
    try:
        opened.open(page.address)
        opened.wait("document.body && document.body.textContent.includes('Load a motion')")
        state.pause()
        opened.wait("document.querySelector('canvas') !== null")
        yield opened
    finally:
        opened.close()


def pixels(browser):
    """(h, w, 3) of the half of the window without the panel."""
    image = pytest.importorskip("PIL.Image").open(io.BytesIO(browser.picture())).convert("RGB")
    return np.array(image)[:, : image.width // 2].astype(int)


def changed_share(picture, before):
    """Of pixels that clearly differ."""
    return (np.abs(picture - before).max(axis=2) > 40).mean()


def still(browser, *, unlike=None):
    """The pixels once something is drawn, or differs from a picture, and two pictures running are alike."""
    last = pixels(browser)
    for _ in range(60):
        time.sleep(0.3)
        now = pixels(browser)
        drawn = now.std() > 10 and (unlike is None or changed_share(now, unlike) > 0.001)
        if (now == last).all() and drawn:
            return now
        last = now
    raise TimeoutError("the page does not come to rest")


def find(kind, text):
    """A JavaScript expression for the last element of a kind whose text is that."""
    return f"[...document.querySelectorAll('{kind}')].filter(each => each.textContent.trim() === '{text}').pop()"


def test_slider_moves_the_cloth(shown, browser):
    """By the keyboard, in a real browser: the state, the cloth and the picture follow, and the console stays silent."""
    _, state = shown
    state.rest()
    before, joint = still(browser), state.rig.joint_names.index(JOINT)
    start = state.pose.positions[joint]
    browser.click(find("[role=tab]", "Pose"))
    browser.wait(f"{find('*', 'left arm [degrees]')} !== undefined")
    browser.click(find("*", "left arm [degrees]"))
    slider = "[...document.querySelectorAll('[role=slider]')].find(each => each.checkVisibility())"
    browser.wait(f"{slider} !== undefined", seconds=20)
    browser.value(f"{slider}.focus()")
    for _ in range(12):
        browser.press("ArrowRight", 39)
    end = time.monotonic() + 20
    while state.pose.positions[joint] - start < np.radians(8) and time.monotonic() < end:
        time.sleep(0.1)
    assert state.posed_by_hand and state.pose.positions[joint] - start >= np.radians(8)
    assert changed_share(still(browser, unlike=before), before) < 0.3  # a slow browser may draw the old picture first
    assert browser.errors == []


def test_header_says_what_it_measures(shown, browser):
    """Of what is worn; how it sits is told beside the heat maps, and shadows are drawn."""
    page, _ = shown
    browser.wait("/draping, 1 garment0\\.\\d\\d ms/.test(document.body.textContent)")
    title = browser.value(f"{find('td', 'draping, 1 garment')}.parentElement.title")
    assert "physkin bench" in title and page.lamp.cast_shadow
    browser.click(find("[role=tab]", "Look"))
    browser.wait(f"{find('td', 'edge strain, tshirt')} !== undefined")


def test_readouts_are_text(shown):
    """What a name means goes on its rows of all garments. What looks like HTML is none: a garment model may be called
    whatever its maker likes."""
    readout = Readout(shown[0], {"strain": '"<b>longer</b>"'})
    readout.show({"strain, skirt": "1 %", "other": None, "<img src=x onerror=alert(1)>": "<b>"})
    first, *others = re.findall('<tr title="([^"]*)">', readout._html.content)
    assert first == "&quot;&lt;b&gt;longer&lt;/b&gt;&quot;" and others == ["", ""]
    assert "<img" not in readout._html.content and "&lt;img" in readout._html.content
    assert "<b>" not in readout._html.content


def test_error_is_a_notice(shown, browser):
    """What a callback raises shows in one sentence; the page goes on drawing."""
    page, state = shown
    page.guarded(state.choose_motion)("nosuch")
    browser.wait("document.body.textContent.includes(\"no bundled motion 'nosuch'\")")
    state.set_joint(0, 0.1)
    end = time.monotonic() + 20
    while state.advance(0.0) is not None and time.monotonic() < end:  # given to the page, or to us: the page draws on
        time.sleep(0.1)
    assert browser.errors == []


def test_figures_come_from_a_process_until_that_ends(asset_loader, monkeypatch):
    """Those of the pose shown; that there will be no more is told once, and frames go on."""
    monkeypatch.setattr("physkin_core.view.viewer.LOOK_EVERY", 0.0)
    state, page = SceneState(asset_loader, ["tshirt"], motion=None), Page(port=8392)
    viewer = Viewer(page, state, motion=None)

    def until(true) -> None:
        end = time.monotonic() + 60
        while not true():
            assert time.monotonic() < end
            viewer.tick(0.05)
            time.sleep(0.05)

    try:
        until(lambda: viewer._contact is not None)
        question = viewer._drawing.figures.question(viewer._frame)
        assert viewer._contact.inside_percent == look_at_contact(**question).inside_percent
        (pid,) = viewer._process._processes
        os.kill(pid, signal.SIGKILL)
        state.set_joint(0, 0.1)
        with pytest.raises(BrokenProcessPool):
            until(lambda: False)
        state.set_joint(0, 0.2)
        viewer.tick(0.05)
        assert viewer._frame.pose.positions[0] == state.pose.positions[0] and viewer._contact is None
    finally:
        viewer.close()
        page.server.stop()


def test_a_model_that_was_loaded_is_a_choice(asset_loader, tmp_path):
    """Beside a shipped one of its name; one that cannot be read is none."""
    own, broken = tmp_path / "skirt.safetensors", tmp_path / "broken.safetensors"
    shutil.copy(MODELS_PATH / "tanktop.safetensors", own)
    broken.write_text("no model")
    state, page = SceneState(asset_loader, ["trousers"]), Page(port=8394)
    viewer = Viewer(page, state, motion=None)
    try:
        with pytest.raises(ValueError, match="broken"):
            viewer._clothes._load_model(broken)
        viewer._clothes._load_model(own)
        garment = viewer._clothes._layers[1][0]
        assert garment.value == garment.options[-1] == "skirt, file" and state.garments == ("trousers", str(own))
    finally:
        viewer.close()
        page.server.stop()


def test_sigterm_ends_whatever_is_being_done():
    """With status 143."""
    code = "import time; from physkin_core.view import view; view.end_at_sigterm(); print(flush=True); time.sleep(60)"
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True)
    with process:
        assert process.stdout.readline() == "\n"
        process.terminate()
        assert process.wait(60) == 143


def test_tick_error_is_told_once(shown):
    """One that comes again with each tick does not flood whoever looks."""
    page, told, count = Page(port=8390), [], iter(range(100))
    page.report = told.append

    def tick(seconds):
        if next(count) == 5:
            page.end()
        raise ValueError("a sentence")

    page.run(tick)
    assert [str(error) for error in told] == ["a sentence"] and next(count) == 6


@pytest.mark.parametrize(
    ("address", "told"),
    [
        ({"port": 99999}, "port is 99999; allowed: 1 to 65535"),
        ({"port": 0}, "port is 0; allowed"),
        ({"host": "192.0.2.7"}, "cannot listen at 192.0.2.7: .* allowed: an address of this machine"),
    ],
)
def test_addresses_that_cannot_be(address, told):
    """Refused, where the server would wait for ever. The host is one of those that documentation is written with."""
    with pytest.raises(ValueError, match=told):
        Page(**address)


def test_errors_before_there_is_a_page_are_one_line(capsys):
    assert cli.main(["view", "--no-browser", "-g", "tshirt", "--tucked", "skirt"]) == 2
    assert "none of the garments" in capsys.readouterr().err.splitlines()[-1]

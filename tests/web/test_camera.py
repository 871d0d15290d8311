"""`physkin export --web --camera`: a film of our own avatar in place of a camera moves the avatar of the page."""

from __future__ import annotations

import io
import json
import time
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, Browser, served
from gltf_person import write_vrm
from posed_landmarks import ROW as LANDMARK
from posed_landmarks import SEGMENTS, landmarks_of
from random_models import random_avatar, random_model

from physkin_core import Motion, Outfit, load_body_model, load_motion
from physkin_core.cli import main
from physkin_core.export import web_page
from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME
from physkin_core.motion.loading import save_motion

FRAMES, PART, RATE_HZ, SIZE = 30, 12, 2.5, (480, 360)
"""Of the walk, and of each other part of the film: nobody, the upper half of a body, two people. A slow film, as few
landmarks a second are found on busy cores."""
REPEATED = 4
"""Frames of the camera for each of these."""
ALL = FRAMES + 3 * PART
TO_CAMERA = np.arctan2(1.4, 4.2)
"""[rad] to the left: where the page's camera stands, which films the avatar."""
KEEP = """(({ shown }) => {
  shown.kept = [];
  let times = null;
  const keep = () => {
    if (shown.camera.times !== times) {
      times = shown.camera.times;
      const { positions, root } = shown.camera.now();
      const cloth = Array.from(shown.outfit.garments[1].positions.slice(0, 300));
      const said = document.getElementById('seen').textContent;
      shown.kept.push([performance.now() / 1000, positions, root, said, cloth]);
    }
    requestAnimationFrame(keep);
  };
  keep();
})(window)"""
"""Keeps what each landmark frame moves."""

made = pytest.mark.skipif(
    not (web_page.PAGE / web_page.FINDER).is_dir(), reason="needs `make wasm`: emscripten and npm"
)


@pytest.fixture(scope="module")
def clip(tmp_path_factory):
    """A walk in its place, towards the camera, that raises both arms sideways, without their swing, and lowers them."""
    walk = load_motion("walk").resampled(15.0)
    frames = np.arange(FRAMES) % (walk.frame_count - 1)
    positions, raised = walk.positions[frames].copy(), np.sin(np.pi * np.arange(FRAMES) / (FRAMES - 1)) ** 2
    for column, joint in enumerate(walk.joint_names):
        if "arm" in joint:
            angle = {"upperarm01.L_x": 1.6, "upperarm01.R_x": -1.6}.get(joint, 0.0)
            positions[:, column] = positions[:, column] * (1 - raised) + angle * raised
    turn = np.tile([0.0, 0.0, np.sin(TO_CAMERA / 2), np.cos(TO_CAMERA / 2)], (FRAMES, 1))
    place = np.where([False, False, True], walk.root_position[frames], 0.0)
    path = tmp_path_factory.mktemp("clip") / "raise.safetensors"
    save_motion(Motion(walk.joint_names, positions, turn, place, RATE_HZ, "raise"), path)
    return path


@pytest.fixture(scope="module")
def folder(clip, tmp_path_factory):
    """Its page, with a camera."""
    folder = tmp_path_factory.mktemp("page")
    assert main(["export", str(clip), "-g", "trousers", "-g", "tshirt", "--web", str(folder), "--camera"]) == 0
    return folder


@pytest.fixture(scope="module")
def address(folder):
    """Of the page."""
    if CHROMIUM is None:
        pytest.skip("needs chromium: apt-get install chromium")
    with served(folder) as address:
        yield address


@pytest.fixture(scope="module")
def film(folder, address, tmp_path_factory):
    """The walk as the page draws it, then the other parts, as .y4m."""
    image = pytest.importorskip("PIL.Image")
    browser = Browser(size=(640, 640))
    browser.open(address)
    browser.wait("window.shown !== undefined", seconds=120)
    browser.send("Emulation.setDeviceMetricsOverride", width=SIZE[0], height=SIZE[1], deviceScaleFactor=1, mobile=False)
    browser.value("document.getElementById('panel').style.display = 'none'")
    browser.value("window.shown.figure.model.traverse((mesh) => (mesh.castShadow = false)); 1")  # slow in software
    drawn = []
    motion = json.loads((folder / "motion.json").read_text())
    for positions, root in zip(motion["positions"], motion["root"]):
        pose = json.dumps({"positions": positions, "root": root, "again": False})
        browser.value(f"window.shown.player.after = () => ({pose})")
        browser.value("new Promise((done) => requestAnimationFrame(() => requestAnimationFrame(() => done(1))))")
        drawn.append(np.array(image.open(io.BytesIO(browser.picture())).convert("RGB")))
    browser.close()
    empty = np.broadcast_to(drawn[0][:1, :1], drawn[0].shape)
    halves = [np.array(image.fromarray(each[:180, 120:360]).resize(SIZE)) for each in drawn[:PART]]
    pairs = [
        np.concatenate([each[:, 120:360], drawn[at + 5][:, 120:360]], axis=1) for at, each in enumerate(drawn[:PART])
    ]
    path = tmp_path_factory.mktemp("film") / "film.y4m"
    with path.open("wb") as file:
        file.write(f"YUV4MPEG2 W{SIZE[0]} H{SIZE[1]} F{REPEATED * RATE_HZ:.0f}:1 Ip A1:1 C420jpeg\n".encode())
        for frame in np.repeat([*drawn, *[empty] * PART, *halves, *pairs], REPEATED, axis=0):
            bands = image.fromarray(frame).convert("YCbCr").split()
            light, *colours = (band.point(lambda value: 16 + value * 55 // 64) for band in bands)  # of 16 to 235
            file.write(b"FRAME\n" + light.tobytes())
            for colour in colours:
                file.write(colour.resize((SIZE[0] // 2, SIZE[1] // 2), image.Resampling.BOX).tobytes())
    return path


@made
@pytest.mark.slow
def test_a_film_moves_the_avatar(address, film, clip, tmp_path):
    """Limbs of the walk, as the camera sees them, are within 15 degrees in the median; how far they point towards it,
    MediaPipe has to guess. While nobody is there, in half a body and before two people nothing jumps, and the page says
    what it sees. The page does not draw while it follows, as that is done by the same cores here."""
    browser = Browser(film=film)
    browser.open(address)
    browser.wait("window.shown !== undefined", seconds=120)
    browser.value("[window.shown.draw, window.shown.stage.draw] = [window.shown.stage.draw, () => {}]; 1")
    browser.click("document.getElementById('camera')")
    browser.wait("window.shown.camera?.times.length > 3", seconds=120)
    browser.value(KEEP)
    length = ALL / RATE_HZ
    time.sleep(length + 3)
    times, positions, roots, said, cloth = map(list, zip(*browser.value("window.shown.kept")))
    browser.value("window.shown.stage.draw = window.shown.draw; 1")
    browser.wait("document.getElementById('seen').textContent.includes('You are seen')")
    time.sleep(2)
    (tmp_path / "page.png").write_bytes(browser.picture())
    assert browser.errors == []
    browser.close()

    rig, motion, times = load_body_model().rig, load_motion(clip), np.array(times)
    roots = np.array(roots)
    roots = np.concatenate([roots[:, :3] @ FROM_ROOT_FRAME, roots[:, 3:6] @ FROM_ROOT_FRAME, roots[:, 6:]], axis=1)
    seen = landmarks_of(rig, np.array(positions), roots)
    upright = np.tile([0.0, 0, 0, 0, 0, 0, 1], (FRAMES, 1))
    truth = landmarks_of(rig, motion.positions_for(rig), upright)
    off = min((in_picture(seen, truth, times, start) for start in np.arange(0, length, 0.1)), key=spread)
    print(
        {limb: np.round(np.median(angles), 1) for limb, angles in off.items()},
        f"{len(times) / (length + 3):.1f} a second",
    )
    assert all(np.median(off[limb]) < 15 for limb in ("upper arm", "forearm", "thigh", "shin")), off
    assert any("Nobody is seen" in each for each in said) and any("leg" in each for each in said), set(said)
    assert any("You are seen" in each for each in said)
    speeds = np.abs(np.diff(positions, axis=0)).max(axis=1) / np.diff(times)
    assert np.isfinite(positions).all() and np.percentile(speeds, 95) < 12  # [rad/s]; a walker's knee has 7
    assert np.ptp(np.array(cloth), axis=0).max() > 0.03


def in_picture(seen, truth, times, start):
    """Angles [degrees] between limbs in the picture's plane where they do not point at the camera, by limb, while the
    film walks, if it began so long before the first time [s]."""
    frames = ((times - times[0] + start) * RATE_HZ) % ALL
    walks = (frames >= 3) & (frames < FRAMES)
    found = {}
    for limb, (first, last) in SEGMENTS.items():
        ends = [[LANDMARK[f"{part}.{side}"] for side in "LR"] for part in (first, last)]
        one, two = (at[:, ends[1]] - at[:, ends[0]] for at in (seen[walks], truth[frames[walks].astype(int)]))
        plain = np.linalg.norm(two[..., 1:], axis=-1) > 0.5 * np.linalg.norm(two, axis=-1)
        angles = np.arctan2(one[..., 2], one[..., 1]) - np.arctan2(two[..., 2], two[..., 1])
        found[limb] = np.degrees(np.abs((angles + np.pi) % (2 * np.pi) - np.pi))[plain]
    return found


def spread(off):
    return np.mean([np.median(angles) if len(angles) else np.inf for angles in off.values()])


@made
def test_without_a_camera_the_page_says_so(address):
    """And the avatar goes on with the page's motion."""
    browser = Browser()
    browser.open(address)
    browser.wait("window.shown !== undefined", seconds=120)
    assert "neither sent nor kept" in browser.value("document.getElementById('live').textContent")
    browser.click("document.getElementById('camera')")
    browser.wait("document.getElementById('seen').textContent.includes('not found')", seconds=30)
    assert browser.value("document.getElementById('camera').textContent") == "Camera"
    first = browser.value("window.shown.player.after(0).positions")
    browser.wait(f"window.shown.player.after(0).positions.some((each, at) => each !== {json.dumps(first)}[at])")
    assert browser.errors == []
    browser.close()


@made
def test_what_finds_landmarks_lies_only_in_pages_with_a_camera(folder, tmp_path):
    """With the licence that it is under."""
    assert {"pose.js", "pose_landmark_lite.tflite", "LICENSE"} <= {
        each.name for each in (folder / "mediapipe").iterdir()
    }
    assert main(["export", "walk", "-g", "tshirt", "--web", str(tmp_path)]) == 0
    assert not (tmp_path / "mediapipe").exists() and not (tmp_path / "camera.json").exists()
    assert "camera" not in json.loads((tmp_path / "motion.json").read_text())


@made
def test_a_file_without_clips_walks_until_the_camera_is_on(tmp_path):
    """The place of its hips is scaled by its legs."""
    avatar = tmp_path / "me.vrm"
    write_vrm(avatar)
    assert main(["export", str(avatar), "-g", "tshirt", "--web", str(tmp_path / "page"), "--camera"]) == 0
    motion = json.loads((tmp_path / "page" / "motion.json").read_text())
    assert motion["name"] == "walk"
    assert 0.5 < motion["camera"] < 1.5


def test_a_camera_is_for_pages(tmp_path, capsys):
    assert main(["export", "walk", "-g", "tshirt", "-o", str(tmp_path / "a.glb"), "--camera"]) == 2
    assert "--camera is for pages" in capsys.readouterr().err


@made
def test_garments_of_another_rig_cannot_follow_a_camera(tmp_path):
    """Its joints are not those that landmarks move."""
    rng = np.random.default_rng(0)
    model = random_model(rng)
    outfit = Outfit([model], random_avatar(rng, model.rig))
    still = Motion(model.rig.joint_names, np.zeros((1, len(model.rig.joint_names))), [[0, 0, 0, 1]], [[0, 0, 1]], 30.0)
    with pytest.raises(ValueError, match="leave --camera out"):
        web_page.write_web_page(tmp_path / "page", outfit, still, [None], camera=True)
    assert not (tmp_path / "page").exists()


def test_an_installation_without_what_finds_landmarks_says_so(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(web_page, "PAGE", Path(tmp_path / "none"))
    assert main(["export", "walk", "-g", "tshirt", "--web", str(tmp_path / "page"), "--camera"]) == 2
    assert "`make wasm` makes it" in capsys.readouterr().err

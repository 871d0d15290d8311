"""A running node in a browser: garment nodes through a rosbridge, skinned by the module; the page that shows them."""

from __future__ import annotations

import base64
import io
import json
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from browser import CHROMIUM, Browser, served

from import_graph import ROOT
from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model, load_motion
from physkin_core.cli import main
from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME
from physkin_core.model.skinning import SkinningData
from physkin_core.runtime.evaluator import Skinner

pytest.importorskip("physkin_msgs", reason="needs physkin_msgs")
pytest.importorskip("websockets", reason="needs websockets")

from rosbridge import PlayedNode, encoded, played_bridge

PACKAGE = ROOT / "build" / "web"
NODE = shutil.which("node")
GARMENTS = ("skirt", "tshirt")
TOPICS = ("/drape_node/skirt", "/drape_node/tshirt")

pytestmark = [
    pytest.mark.skipif(NODE is None, reason="needs node: apt-get install nodejs"),
    pytest.mark.skipif(not (PACKAGE / "physkin.wasm").exists(), reason="needs `make wasm`: emscripten and npm"),
]


@pytest.fixture(scope="module")
def played():
    """A node that drapes a T-shirt over a skirt."""
    models = [load_garment_model(name) for name in GARMENTS]
    return PlayedNode(Outfit(models, load_avatar(BUNDLED_AVATAR, models[0].rig)), TOPICS)


@pytest.fixture(scope="module")
def poses(played):
    return load_motion("walk").positions_for(played.outfit.rig).astype(np.float32)[:40:4]


def run(bridge, **case):
    """What run_ros.mjs says."""
    script = Path(__file__).with_name("run_ros.mjs")
    command = [NODE, script, PACKAGE, bridge, json.dumps(case)]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_vertices_are_those_that_python_skins(played, poses, monkeypatch):
    """0.1 mm from them at most, of every garment that is there, by CBOR."""
    monkeypatch.setenv("PHYSKIN_NATIVE_ISA", "baseline")
    with played_bridge(played, poses[:1]) as bridge:
        garments = run(bridge)
    assert [garment["topics"] for garment in garments] == list(TOPICS)
    (frame,) = [played.frame(poses[0])]
    for garment, layer in zip(garments, played.outfit.layers):
        nodes = frame[f"{garment['topics']}/garment_nodes"]
        expected = skinned(layer.bound_visible, nodes)
        cloud = np.frombuffer(base64.b64decode(garment["positions"]), np.float32).reshape(-1, 3) @ FROM_ROOT_FRAME
        normals = np.frombuffer(base64.b64decode(garment["normals"]), np.float32).reshape(-1, 3) @ FROM_ROOT_FRAME
        assert garment["name"] == layer.name and np.array_equal(garment["faces"], layer.faces.ravel())
        assert np.linalg.norm(cloud - expected[:, :3], axis=1).max() < 1e-4
        assert (normals * expected[:, 3:]).sum(axis=1).min() > 0.99


def skinned(data: SkinningData, nodes) -> np.ndarray:
    """(n, 6)"""
    out = np.empty((len(data.vertices), 6), dtype=np.float32)
    transforms = np.array(nodes["transforms"], np.float32).reshape(-1, 3, 4)
    Skinner(data).skin(transforms, out, np.array(nodes["detail_offsets"], np.float32).reshape(-1, 3))
    return out


def test_a_frame_takes_19_kb(played, poses):
    """A garment, where its cloud takes 24 bytes a vertex."""
    for topic, message in played.frame(poses[0]).items():
        if topic.endswith("garment_nodes"):
            assert len(encoded(topic, message, "cbor")) < 19000


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"mesh": {"faces": [0, 1, 99999]}}, 'garment mesh "skirt": faces[2] is 99999'),
        ({"mesh": {"node_rest": [0.0]}}, 'garment mesh "skirt": node_rest has 1 numbers; expected 384'),
        ({"mesh": {"detail_node_count": 9}}, 'garment mesh "skirt": detail_nodes'),
        ({"nodes": {"revision": 2}}, "garment nodes of revision 2; the mesh has revision 3"),
        ({"nodes": {"transforms": [1.0]}}, "garment nodes have 1 numbers of transforms; the mesh wants 1536"),
        ({"nodes": {"detail_offsets": [1.0]}}, "garment nodes have 1 numbers of detail_offsets; the mesh wants 3072"),
        ({"nodes": {"transforms": ["NaN"] * 1536}}, "node_transforms[0] is nan"),
    ],
)
def test_what_is_refused(change, said, played, poses):
    """In one sentence."""
    with played_bridge(played, poses[:1]) as bridge:
        told = run(bridge, **change)
    assert told["ours"] and said in told["message"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """The page of a walk."""
    folder = tmp_path_factory.mktemp("page")
    worn = [word for name in GARMENTS for word in ("-g", name)]
    assert main(["export", "walk", *worn, "--rate", "20", "--web", str(folder)]) == 0
    return folder


@pytest.fixture(scope="module")
def browser():
    if CHROMIUM is None:
        pytest.skip("needs chromium: apt-get install chromium")
    opened = Browser(size=(1000, 700))
    yield opened
    opened.close()


def test_the_page_shows_what_the_node_drapes(browser, folder, played, poses):
    """A red shirt on a person, moving, and a silent console."""
    image = pytest.importorskip("PIL.Image")
    with served(folder) as address, played_bridge(played, poses, rate=20) as bridge:
        browser.open(f"{address}?bridge={bridge}")
        browser.wait("window.shown?.frames > 40", seconds=120)
        pixels = np.array(image.open(io.BytesIO(browser.picture())).convert("RGB"))[:, :720].astype(int)
        assert 0.5 < (pixels.min(axis=2) < 200).any(axis=1).mean() < 0.95
        assert (pixels[..., 0] > pixels[..., 2] + 60).mean() > 0.02
        place = "Array.from(window.shown.worn.get('/drape_node/tshirt').positions.slice(0, 30))"
        first, end = browser.value(place), time.monotonic() + 30
        while first == browser.value(place):
            assert time.monotonic() < end, "nothing moves"
        assert browser.errors == []


def test_a_bridge_that_is_not_there(browser, folder):
    with served(folder) as address:
        browser.open(f"{address}?bridge=ws://127.0.0.1:1")
        said = "document.getElementById('wrong')?.textContent"
        browser.wait(f"{said} === 'no rosbridge answers at ws://127.0.0.1:1'", seconds=120)

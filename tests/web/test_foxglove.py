"""The converter of garment nodes for Foxglove's 3D panel, bundled and run in Node."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from import_graph import ROOT
from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model, load_motion
from physkin_core.runtime.evaluator import Skinner

pytest.importorskip("physkin_msgs", reason="needs physkin_msgs")

from rosbridge import MESH, NODES, PlayedNode

BUNDLER = ROOT / "build" / "web" / "node_modules" / ".bin" / "esbuild"
CONVERTER = ROOT / "native" / "web" / "foxglove" / "src" / "index.ts"
NODE = shutil.which("node")
GARMENTS = ("skirt", "tshirt")
HEADER = {"stamp": {"sec": 5, "nsec": 7}, "frame_id": "base_link"}

pytestmark = [
    pytest.mark.skipif(NODE is None, reason="needs node: apt-get install nodejs"),
    pytest.mark.skipif(not BUNDLER.exists(), reason="needs `make wasm`: emscripten and npm"),
]


@pytest.fixture(scope="module")
def converter(tmp_path_factory):
    """As Foxglove loads it."""
    bundle = tmp_path_factory.mktemp("foxglove") / "converter.mjs"
    command = [BUNDLER, CONVERTER, "--bundle", "--format=esm", "--log-level=warning", f"--outfile={bundle}"]
    subprocess.run(command, check=True)
    return bundle


def run(converter, *messages):
    """What run_foxglove.mjs says of (schema, topic, message) as they come."""
    path = Path(converter).with_name("case.json")
    path.write_text(json.dumps(messages, default=list))
    script = Path(__file__).with_name("run_foxglove.mjs")
    done = subprocess.run([NODE, script, converter, path], capture_output=True, text=True, check=False, timeout=120)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def test_a_scene_has_the_garments_as_python_skins_them(converter):
    """0.1 mm at most; nothing before the mesh has come, for the mesh itself, and of garment nodes of another mesh."""
    models = [load_garment_model(name) for name in GARMENTS]
    outfit = Outfit(models, load_avatar(BUNDLED_AVATAR, models[0].rig))
    node = PlayedNode(outfit, [f"/drape_node/{name}" for name in GARMENTS])
    pose = load_motion("walk").positions_for(outfit.rig).astype(np.float32)[12]
    frame = {topic: message | {"header": HEADER} for topic, message in node.frame(pose).items() if "nodes" in topic}
    meshes = [(MESH, topic, message) for topic, message in node.latched().items()]
    nodes = [(NODES, topic, message) for topic, message in frame.items()]
    stale = [(schema, topic, message | {"revision": 4}) for schema, topic, message in nodes]
    answers = run(converter, *nodes, *meshes, *stale, *nodes)
    assert {answer["toSchemaName"] for answer in answers} == {"foxglove.SceneUpdate"}
    assert all(answer["scene"] == {"deletions": [], "entities": []} for answer in answers[:6])
    for answer, (_, topic, message), layer in zip(answers[6:], nodes, outfit.layers):
        (entity,) = answer["scene"]["entities"]
        assert f"{entity['id']}/garment_nodes" == topic and entity["frame_id"] == "base_link"
        assert entity["timestamp"] == HEADER["stamp"]
        (triangles,) = entity["triangles"]
        assert np.array_equal(triangles["indices"], layer.faces.ravel())
        points = np.array([[point[axis] for axis in "xyz"] for point in triangles["points"]])
        expected = np.empty((len(points), 6), dtype=np.float32)
        transforms, offsets = (np.array(message[name], np.float32) for name in ("transforms", "detail_offsets"))
        Skinner(layer.bound_visible).skin(transforms.reshape(-1, 3, 4), expected, offsets.reshape(-1, 3))
        assert np.linalg.norm(points - expected[:, :3], axis=1).max() < 1e-4

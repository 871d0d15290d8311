"""The evaluator as a WebAssembly module, in Node: native clouds, poses of VRM avatars, refusals, the npm package."""

from __future__ import annotations

import base64
import gzip
import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from random_models import random_avatar, random_model
from scipy.spatial.transform import Rotation

from import_graph import ROOT
from physkin_core import (
    BUNDLED_AVATAR,
    FABRICS,
    Draper,
    Outfit,
    load_avatar,
    load_garment_model,
    load_motion,
    with_fabric,
)
from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME
from physkin_core.rig.bone_rotations import BoneRotations

PACKAGE = ROOT / "build" / "web"
NODE = shutil.which("node")

pytestmark = [
    pytest.mark.skipif(NODE is None, reason="needs node: apt-get install nodejs"),
    pytest.mark.skipif(not (PACKAGE / "physkin.wasm").exists(), reason="needs `make wasm`: emscripten and npm"),
]


@pytest.fixture(scope="module")
def outfit():
    """A T-shirt over a skirt on the bundled avatar."""
    models = [load_garment_model(name) for name in ("skirt", "tshirt")]
    return Outfit(models, load_avatar(BUNDLED_AVATAR, models[0].rig))


@pytest.fixture(scope="module")
def bound(outfit, tmp_path_factory):
    """Its file, as it lies on a server."""
    folder = tmp_path_factory.mktemp("web")
    outfit.save_bound(folder / "outfit")
    path = folder / "outfit.physkin.gz"
    path.write_bytes(gzip.compress((folder / "outfit").read_bytes()))
    return path


def run(folder, file, **case):
    """What run.mjs says of a case."""
    path = Path(folder) / "case.json"
    path.write_text(json.dumps({"file": str(file), **case}))
    script = Path(__file__).with_name("run.mjs")
    done = subprocess.run([NODE, script, PACKAGE, path], capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def clouds(frame):
    """(n, 6) of each garment in the root frame."""
    found = []
    for garment in frame["clouds"]:
        columns = [
            np.frombuffer(base64.b64decode(text), np.float32).reshape(-1, 3) @ FROM_ROOT_FRAME for text in garment
        ]
        found.append(np.concatenate(columns, axis=1))
    return found


def in_gltf_axes(root):
    """A root (7,) of ours."""
    return [*FROM_ROOT_FRAME @ root[:3], *FROM_ROOT_FRAME @ root[3:6], root[6]]


def test_clouds_are_the_native_ones(outfit, bound, tmp_path, monkeypatch):
    """0.1 mm from them at most, over a dance whose root moves and where wind comes up, and for a pose by itself.

    Joints are given by number and name.

    Of the instruction set whose arithmetic it has: others lay out bf16 differently, and are 0.13 mm off on average.
    """
    motion = load_motion("dance")
    poses = motion.positions_for(outfit.rig).astype(np.float32)[:40]
    moments = list(zip(poses.astype(float), motion.times, motion.root.astype(float)))
    frames = [[pose.tolist(), {"time": time, "root": in_gltf_axes(root)}] for pose, time, root in moments]
    tilted = np.array([0.3, -0.4, -np.sqrt(0.75)])
    bent = {"lowerarm01.L_z": -1.0, "upperleg01.R_y": -0.8}
    frames.append([bent, {"gravity": (FROM_ROOT_FRAME @ tilted).tolist()}])
    wind = np.array([-3.0, 1.0, 0.5])
    frames[20].append((FROM_ROOT_FRAME @ wind).tolist())
    told = run(tmp_path, bound, frames=frames)
    assert [joint["name"] for joint in told["joints"]] == list(outfit.joint_names) and told["kept"]
    for layer, garment in zip(outfit.layers, told["garments"]):
        assert garment["name"] == layer.name and np.array_equal(garment["faces"], layer.faces.reshape(-1))
    monkeypatch.setenv("PHYSKIN_NATIVE_ISA", "baseline")
    twin = outfit.twin()
    native = []
    for pose, time, root in moments:
        twin.wind = wind if len(native) >= 20 else np.zeros(3)
        native.append(twin.drape(pose, time=time, root=root))
    native.append(twin.drape(bent, tilted))
    for frame, expected in zip(told["frames"], native):
        for cloud, wanted in zip(clouds(frame), expected):
            assert np.linalg.norm(cloud[:, :3] - wanted[:, :3], axis=1).max() < 1e-4
            assert (cloud[:, 3:] * wanted[:, 3:]).sum(axis=1).min() > 0.99


def test_fabrics_hang_as_in_python(tmp_path, monkeypatch):
    """2 mm on average from a garment that is made of them: both are within a millimetre of the network as it was
    trained, by directions of their own; and back."""
    trained = load_garment_model("dress")
    avatar = load_avatar(BUNDLED_AVATAR, trained.rig)
    Draper(with_fabric(trained, "wool"), avatar).save_bound(tmp_path / "dress")
    pose = load_motion("dance").positions_for(trained.rig)[30].astype(np.float32)
    names = ("wool", "denim", "silk", "jersey", "wool")
    told = run(tmp_path, tmp_path / "dress", frames=[[pose.tolist(), {}, None, name] for name in names])
    assert told["garments"][0]["fabric"] == "wool" and set(told["garments"][0]["fabrics"]) == set(FABRICS)
    monkeypatch.setenv("PHYSKIN_NATIVE_ISA", "baseline")
    for name, frame in zip(names, told["frames"]):
        (cloud,), expected = clouds(frame), Draper(with_fabric(trained, name), avatar).drape(pose)
        away = np.linalg.norm(cloud[:, :3] - expected[:, :3], axis=1)
        assert away.max() < 2e-4 if name == "wool" else away.mean() < 2e-3


def test_bone_rotations_pose_the_avatar(outfit, bound, tmp_path):
    """As Python's bone transforms do."""
    pose = load_motion("dance").positions_for(outfit.rig)[30]
    bones = run(tmp_path, bound, frames=[[pose.astype(float).tolist(), {}]])["frames"][0]["bones"]
    transforms = outfit.bone_transforms(pose.astype(np.float32))[:, :, :3]
    for bone, parent, turn in zip(outfit.rig.bone_names, outfit.rig.parents, transforms):
        relative = turn if parent < 0 else transforms[parent].T @ turn
        found = Rotation.from_quat(bones.get(bone, [0, 0, 0, 1])).as_matrix()
        assert np.allclose(FROM_ROOT_FRAME.T @ found @ FROM_ROOT_FRAME, relative, atol=1e-5), bone


@pytest.mark.parametrize("version", ["1", "0"])
def test_normalised_bones_of_vrm(version, outfit, bound, tmp_path):
    """As Python takes them apart; models of VRM 0 face the other way. Bones that an avatar lacks are at rest."""
    rotations, rng = BoneRotations(outfit.rig, skeleton="vrm"), np.random.default_rng(70)
    names = [name for name in rotations.bone_names if name not in ("hips", "upperChest")]
    turns = {name: Rotation.from_rotvec(rng.normal(scale=0.6, size=3)).as_quat() for name in names}
    seen = {name: (turn * ([-1, 1, -1, 1] if version == "0" else 1)).tolist() for name, turn in turns.items()}
    (positions,) = run(tmp_path, bound, poses=[seen], vrm=version)["poses"]
    assert np.allclose(positions, rotations.joint_positions(turns), atol=1e-5)


def test_what_is_refused(bound, tmp_path):
    """In one sentence; a frame that is refused changes nothing."""
    cases = {
        "got 2 joint positions; expected 52": [[0.0, 0.0], {}],
        'there is no joint "elbow"; outfit.joints names all 52': [{"elbow": 1.0}, {}],
        'joint "head_x" is NaN; positions are finite numbers in radians': [{"head_x": "NaN"}, {}],
        "gravity is [0, -9.81, 0]; expected a unit direction": [{}, {"gravity": [0, -9.81, 0]}],
        "gravity is [0, -1]; expected 3 finite numbers": [{}, {"gravity": [0, -1]}],
        "gravity is of a root at rest; give either it or time and root": [{}, {"gravity": [0, -1, 0], "time": 1}],
        "time is undefined; it must be a finite number of seconds": [{}, {"root": [0, 0, 0, 0, 0, 0, 1]}],
        "wind is [1, 2]; expected 3 finite numbers": [{}, {}, [1, 2]],
        "wind must be (3,), finite, up to 13 m/s, got (0, 14, 0)": [{}, {}, [14, 0, 0]],
        "the file holds no fabric tweed of skirt; it holds jersey, silk, cotton, wool, rib, denim, leather": [
            *({}, {}, None, "tweed")
        ],
        "the quaternion of root must be of length 1": [{}, {"time": 1, "root": [0, 0, 0, 0, 0, 0, 2]}],
    }
    still = [{}, {}]
    frames = run(tmp_path, bound, frames=[still, *cases.values(), still])["frames"]
    assert [frame["message"] for frame in frames[1:-1]] == list(cases)
    assert all(frame["ours"] for frame in frames[1:-1])
    assert frames[0]["clouds"] == frames[-1]["clouds"]


def test_cloth_hangs_at_rest_before_the_first_frame(bound, tmp_path):
    """What three.js makes of it is found where it hangs, and where raised arms take it."""
    told = run(tmp_path, bound, frames=[[{}, {}]])
    assert told["rest"] == told["frames"][0]["clouds"]
    script = """
        import { readFileSync } from "node:fs";
        const [folder, file] = process.argv.slice(-2);
        const { loadOutfit } = await import(`file://${folder}/physkin.js`);
        const { garmentGeometry, refresh } = await import(`file://${folder}/three.js`);
        const { Mesh, MeshBasicMaterial, DoubleSide, Raycaster, Vector3 } = await import("three");
        const outfit = await loadOutfit(readFileSync(file), { wasm: readFileSync(`${folder}/physkin.wasm`) });
        const mesh = new Mesh(garmentGeometry(outfit.garments[1]), new MeshBasicMaterial({ side: DoubleSide }));
        const ray = new Raycaster(new Vector3(0, 0.2, 3), new Vector3(0, 0, -1));
        const hits = [ray.intersectObject(mesh).length];
        outfit.step({ "upperarm01.L_x": 1.5, "upperarm01.R_x": -1.5, spine03_x: 1.0 });
        refresh(mesh.geometry);
        const { boundingSphere, attributes } = mesh.geometry;
        const place = new Vector3();
        for (let k = 0; k < attributes.position.count; ++k) {
          hits.push(boundingSphere.containsPoint(place.fromBufferAttribute(attributes.position, k)));
        }
        console.log(JSON.stringify([hits[0], hits.slice(1).every(Boolean), boundingSphere.radius]));
    """
    command = [NODE, "--input-type=module", "-e", script, "--", PACKAGE, bound]
    done = subprocess.run(command, cwd=PACKAGE, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 0, done.stderr
    hits, inside, radius = json.loads(done.stdout)
    assert hits >= 2 and inside and 0.5 < radius < 2.0


@pytest.mark.parametrize("of", ["wasm", "outfit"])
def test_a_page_in_place_of_a_file_is_named(of, bound):
    """As a development server answers for what it does not know, with status 200."""
    script = """
        import { readFileSync } from "node:fs";
        const [folder, file, of] = process.argv.slice(-3);
        const { loadOutfit } = await import(`file://${folder}/physkin.js`);
        globalThis.fetch = async () => new Response("\\n<!DOCTYPE html><html></html>");
        const told = of === "wasm" ? loadOutfit(readFileSync(file)) : loadOutfit("https://example.org/me.physkin");
        console.log(await told.catch((error) => `${error.name}: ${error.message}`));
    """
    command = [NODE, "--input-type=module", "-e", script, "--", PACKAGE, bound, of]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    assert done.stdout.startswith("PhyskinError: ") and "is a page of HTML: the server has no such file" in done.stdout


@pytest.mark.parametrize(
    "damage, message",
    [
        (lambda data: data[:100], "the file of 100 bytes is cut off or damaged: it cannot be inflated"),
        (lambda data: gzip.decompress(data)[:-9], "the file is cut off or damaged: its checksum does not match"),
        (lambda data: b"", "the file of 0 bytes is no bound garment"),
        (lambda data: b"PhySkin\n\t\0\0\0" + bytes(90), "the file has version 9; this library reads 14"),
    ],
)
def test_other_files_are_refused(damage, message, bound, tmp_path):
    (tmp_path / "damaged").write_bytes(damage(bound.read_bytes()))
    told = run(tmp_path, tmp_path / "damaged")
    assert told["ours"] and message in told["message"]


def test_garments_of_another_rig_know_no_vrm(tmp_path):
    rng = np.random.default_rng(71)
    model = random_model(rng)
    with pytest.warns(match="inside the body"):
        Draper(model, random_avatar(rng, model.rig)).save_bound(tmp_path / "other")
    (told,) = run(tmp_path, tmp_path / "other", poses=[{}], vrm="1")["poses"]
    assert told["ours"] and told["message"].startswith("the file knows no bones of VRM")


def test_a_module_that_could_not_be_loaded_is_asked_for_again(bound):
    script = """
        import { readFileSync } from "node:fs";
        const [folder, file] = process.argv.slice(-2);
        const { loadOutfit } = await import(`file://${folder}/physkin.js`);
        const answers = [new Response(null, { status: 503 }), new Response(readFileSync(`${folder}/physkin.wasm`))];
        globalThis.fetch = async () => answers.shift();
        const load = () => loadOutfit(readFileSync(file), { wasm: "https://example.org/physkin.wasm" });
        const told = [];
        for (const _ of [1, 2, 3]) told.push(await load().then((o) => o.garments.length, (e) => e.message));
        console.log(JSON.stringify(told));
    """
    command = [NODE, "--input-type=module", "-e", script, "--", PACKAGE, bound]
    done = subprocess.run(command, capture_output=True, text=True, check=True, timeout=300)
    refused, *loaded = json.loads(done.stdout)
    assert "503" in refused and loaded == [2, 2]


def test_the_npm_package():
    """Holds what its exports name, a module of at most 300 KB and JavaScript of at most 400 lines."""
    packed = subprocess.run(
        ["npm", "pack", "--dry-run", "--json"], cwd=PACKAGE, capture_output=True, text=True, check=True
    )
    names = {file["path"] for file in json.loads(packed.stdout)[0]["files"]}
    exports = json.loads((PACKAGE / "package.json").read_text())["exports"].values()
    wanted = {path[2:] for each in exports for path in (each.values() if isinstance(each, dict) else [each])}
    assert wanted <= names and "LICENSE" in names and not any("node_modules" in name for name in names)
    assert (PACKAGE / "physkin.wasm").stat().st_size <= 300_000
    assert sum(len((PACKAGE / name).read_text().splitlines()) for name in ("physkin.js", "three.js")) <= 400

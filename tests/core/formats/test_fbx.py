"""FBX files are avatars and motion: each is compared with the figure it was written from."""

import io
import os
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from fbx_files import FbxFigure, write_fbx
from gltf_person import PERSON, RIG, distances
from PIL import Image
from scipy.spatial.transform import Rotation

from physkin_core import AvatarError, MotionError, load_avatar, load_motion
from physkin_core.formats import fbx_file
from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.formats.gltf_scene import drawn_primitives, in_scene
from physkin_core.loader.asset_loader import AssetLoader
from physkin_core.look.avatar_look import avatar_colours
from physkin_core.motion.gltf_clip import read_gltf_clip, the_clip

Z_UP = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
"""Rows: x left, y back, z up, as 3ds Max has them."""
MIRROR = np.diag([1.0, 1.0, -1.0])
FRAMES = 24


def figure(*, unit=0.01, frame=FROM_ROOT_FRAME, **changes):
    """The person, whose joints are turned anyhow when they are bound."""
    binds = np.tile(np.eye(4), (RIG.bone_count, 1, 1))
    binds[:, :3, :3] = Rotation.random(RIG.bone_count, rng=np.random.default_rng(1)).as_matrix()
    binds[:, :3, 3] = PERSON.bone_heads @ frame.T / unit
    influences = PERSON.influence_bones, PERSON.influence_weights
    vertices = PERSON.vertices.astype(np.float64) @ frame.T / unit
    given = vertices, PERSON.faces, list(RIG.bone_names), RIG.parents, binds, *influences
    return replace(FbxFigure(*given, unit_cm=100 * unit), **changes)


def kicking(fbx):
    """The figure's joints, turned by up to 40 degrees each, as its nodes stand."""
    local = fbx.locals_as_bound()
    turns = Rotation.from_euler("xyz", np.random.default_rng(2).uniform(-40, 40, (len(local), 3)), degrees=True)
    local[:, :3, :3] = local[:, :3, :3] @ turns.as_matrix()
    return replace(fbx, joint_locals=local)


def swinging(fbx, frames=FRAMES):
    """(T, j, 4, 4) local transforms: every joint swings, the root walks on."""
    local = np.tile(fbx.locals_as_bound(), (frames, 1, 1, 1))
    time = np.arange(frames) / frames
    for joint in range(len(fbx.joint_names)):
        swing = 25 * np.sin(2 * np.pi * time + joint)
        turns = Rotation.from_euler("xyz", np.stack([swing, swing / 2, -swing], axis=1), degrees=True)
        local[:, joint, :3, :3] = local[:, joint, :3, :3] @ turns.as_matrix()
    local[:, 0, 0, 3] += 100 * time
    return local


def places(fbx, local):
    """(T, j, 3) [m] of joints with local transforms (T, j, 4, 4)."""
    worlds = np.empty_like(local)
    for joint, parent in enumerate(fbx.joint_parents):
        worlds[:, joint] = local[:, joint] if parent < 0 else worlds[:, parent] @ local[:, joint]
    return worlds[..., :3, 3] * fbx.unit_cm / 100


def written(tmp_path, fbx, *, name="me.fbx", binary=True):
    write_fbx(tmp_path / name, fbx.records(), binary=binary)
    return tmp_path / name


def panel(**changes):
    """A quad and a pentagon of 10 cm on two joints."""
    vertices = [[0, 0, 0], [10, 0, 0], [10, 10, 0], [0, 10, 0], [12, 15, 0], [5, 20, 0], [-2, 15, 0]]
    binds = np.tile(np.eye(4), (2, 1, 1))
    binds[1, 1, 3] = 10
    influences = np.tile([0, 1], (7, 1)), np.full((7, 2), 0.5)
    polygons = [[0, 1, 2, 3], [3, 2, 4, 5, 6]]
    return replace(
        FbxFigure(np.array(vertices, dtype=float), polygons, ["Hips", "Spine"], np.array([-1, 0]), binds, *influences),
        **changes,
    )


def drawn(path):
    """Positions (V, 3) in the scene and faces (f, 3) of everything that is drawn."""
    file, points, faces = GltfFile(path), [], []
    for each in drawn_primitives(file):
        faces.append(each.faces + sum(map(len, points)))
        points.append(in_scene(file, each.node, each.positions))
    return np.concatenate(points), np.concatenate(faces)


def turned_mesh():
    """A mesh's node that is turned, moved and twice as large."""
    world = np.eye(4)
    world[:3, :3] = 2 * Rotation.from_euler("xyz", [90, 20, 0], degrees=True).as_matrix()
    world[:3, 3] = 1, 2, 3
    return world


FIGURES = {
    "text": lambda: figure(),
    "inches, Z up": lambda: figure(unit=0.0254, frame=Z_UP, axes=(2, 1, 1, -1, 0, 1)),
    "left-handed": lambda: figure(frame=MIRROR @ FROM_ROOT_FRAME, axes=(1, 1, 2, -1, 0, 1)),
    "its nodes are in another pose, and its mesh has transforms": lambda: kicking(
        figure(mesh_world=turned_mesh(), mesh_geometry=(5, 6, 7), pre_rotation=(10, 20, 30))
    ),
}


@pytest.mark.parametrize("case", FIGURES)
def test_a_figure_is_what_it_was_written_from(tmp_path, case):
    """Stored in single precision, and posed: a twentieth of a millimetre."""
    avatar = load_avatar(written(tmp_path, FIGURES[case](), binary=case != "text"), RIG)
    assert avatar.warnings == ()
    assert distances(avatar.vertices, PERSON.vertices).max() < 0.05
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < 0.05


@pytest.mark.parametrize("binary", [False, True])
def test_polygons_are_triangulated(tmp_path, binary):
    points, faces = drawn(written(tmp_path, panel(), binary=binary))
    a, b, c = np.moveaxis(points[faces], 1, 0)
    assert len(faces) == 2 + 3
    np.testing.assert_allclose(np.cross(b - a, c - a)[:, 2].sum() / 2, 0.01 + 0.0095, rtol=1e-5)


def test_blend_shapes_that_are_set_shape_the_mesh(tmp_path):
    shapes = {"tall": (np.tile([0.0, 2, 0], (7, 1)), 50.0), "wide": (np.tile([9.0, 0, 0], (7, 1)), 0.0)}
    plain, _ = drawn(written(tmp_path, panel()))
    shaped, _ = drawn(written(tmp_path, panel(shapes=shapes)))
    np.testing.assert_allclose(shaped - plain, np.tile([0, 0.01, 0], (len(plain), 1)), atol=1e-7)


def test_of_many_skinning_weights_the_largest_stay(tmp_path):
    binds = np.tile(np.eye(4), (20, 1, 1))
    given = {"joint_names": [f"joint {number}" for number in range(20)], "joint_parents": np.arange(-1, 19)}
    weights = np.tile(np.arange(1.0, 21.0), (7, 1))
    influences = {"influence_joints": np.tile(np.arange(20), (7, 1)), "influence_weights": weights / weights.sum()}
    file = GltfFile(written(tmp_path, panel(binds=binds, **given, **influences)))
    primitive = next(drawn_primitives(file)).primitive
    joints = np.concatenate([file.attribute(primitive, f"JOINTS_{four}") for four in range(4)], axis=1)
    names = [file.nodes[joint].text("name") for joint in file.document.item("skins", 0).indices("joints")]
    assert file.attribute(primitive, "JOINTS_4") is None
    assert [names[joint] for joint in joints[0]] == [f"joint {number}" for number in range(19, 3, -1)]


def test_hidden_meshes_and_skins_may_be_missing(tmp_path):
    """Without a skin it is a plain mesh where its node puts it; a hidden one is not there."""
    world = np.eye(4)
    world[:3, 3] = 0, 100, 0
    points, faces = drawn(written(tmp_path, panel(with_skin=False, mesh_world=world)))
    assert len(faces) == 5 and points[:, 1].max() == pytest.approx(0.2)
    with pytest.raises(AvatarError, match="it has no faces"):
        load_avatar(written(tmp_path, panel(visible=False)), RIG)


def test_what_has_no_skin_moves_with_its_joint_or_is_left_out(tmp_path):
    """Glasses stay on the nose though nodes are in another pose than the skin; the ground is no part of the figure."""
    fbx = figure()
    quad = 100 * np.array([[-0.05, 0.6, 0.1], [0.05, 0.6, 0.1], [0.05, 0.63, 0.1], [-0.05, 0.63, 0.1]])
    ground = 100 * np.array([[-1, -1, -1], [1, -1, -1], [1, -1, 1], [-1, -1, 1]])
    head = RIG.bone_index("head")
    props = {"glasses": (quad, [[0, 1, 2, 3]], head), "ground": (ground.astype(float), [[0, 1, 2, 3]], -1)}
    avatar = load_avatar(written(tmp_path, kicking(replace(fbx, props=props))), RIG)
    assert len(avatar.accessories.vertices) == 4
    assert distances(avatar.accessories.vertices @ FROM_ROOT_FRAME.T, quad / 100).max() < 0.05
    assert any("'ground' has no skin and hangs on no joint: left out" in each for each in avatar.warnings)


# --- Look


def png(colour):
    buffer = io.BytesIO()
    Image.new("RGB", (4, 4), colour).save(buffer, format="PNG")
    return buffer.getvalue()


@pytest.mark.parametrize("place", ["embedded", "beside", "text"])
def test_materials_and_pictures_are_the_figures_look(tmp_path, place):
    """Legs in a colour, the rest in a picture: within the file, or beside it in a folder."""
    is_leg = PERSON.vertices[PERSON.faces][..., 2].mean(axis=1) < -0.3
    content = png((200, 30, 20))
    (tmp_path / "me.fbm").mkdir()
    (tmp_path / "me.fbm" / "red skin.png").write_bytes(content)
    fbx = figure(
        colours={"body": (1, 1, 1), "body legs": (0, 0.2, 0.8)},
        materials=is_leg.astype(int),
        pictures={"body": ("me.fbm\\red skin.png", None if place == "beside" else content)},
        uv=np.tile([0.5, 0.5], (3 * len(PERSON.faces), 1)),
    )
    avatar = load_avatar(written(tmp_path, fbx, binary=place != "text"), RIG)
    colours = avatar_colours(avatar)
    centre = avatar.file_vertices[avatar.faces].mean(axis=1)[:, 1]
    np.testing.assert_allclose(colours[centre > -0.25].mean(axis=0), np.array([200, 30, 20]) / 255, atol=0.01)
    np.testing.assert_allclose(colours[centre < -0.35].mean(axis=0), np.array([0, 0.2, 0.8]) ** (1 / 2.2), atol=0.01)


def test_a_picture_that_is_not_there_is_said(tmp_path, caplog):
    fbx = figure(
        colours={"body": (1, 1, 1)},
        materials=np.zeros(len(PERSON.faces)),
        pictures={"body": ("..\\..\\skin.png", None)},
        uv=np.tile([0.5, 0.5], (3 * len(PERSON.faces), 1)),
    )
    assert avatar_colours(load_avatar(written(tmp_path, fbx), RIG)) is not None
    assert "'body' is shown without its picture: it names 'skin.png', which does not exist beside it" in caplog.text


# --- Motion


@pytest.mark.parametrize("case", ["with skin", "without skin", "text"])
def test_a_take_is_the_clip_that_it_was_written_from(tmp_path, case):
    """Angles are stored in single precision: joints lie within a hundredth of a millimetre."""
    fbx = kicking(figure(pre_rotation=(10, 20, 30)))
    local = swinging(fbx)
    fbx = replace(fbx, clips={"mixamo.com": local})
    if case == "without skin":
        fbx = replace(fbx, vertices=np.empty((0, 3)))
    file = GltfFile(written(tmp_path, fbx, binary=case != "text"))
    clip = read_gltf_clip(file, the_clip(file, ""))
    joints = [clip.names.index(name) for name in fbx.joint_names]
    assert clip.frame_count == FRAMES and clip.rate_hz == pytest.approx(30)
    assert distances(clip.places[:, joints], places(fbx, local)).max() < 0.01
    rest = np.tile(np.eye(4), (len(joints), 1, 1)) if case == "without skin" else fbx.binds
    if case != "without skin":
        assert distances(clip.rest[joints], rest[:, :3, 3] / 100).max() < 0.01


def test_takes_are_chosen_by_name_and_rest_is_the_bind_pose(tmp_path):
    """Two takes; the last does not say that it begins at 0, as tools leave out what is usual."""
    fbx = figure()
    local = swinging(fbx)
    path = written(tmp_path, replace(fbx, clips={"Idle": local[:6], "Walk on": local}, untimed={"Walk on"}))
    walked, again = load_motion(f"{path}#Walk on"), load_motion(f"{path}#2")
    assert np.array_equal(walked.positions, again.positions)
    assert walked.name == "Walk on" and len(walked.positions) == pytest.approx(2 * FRAMES, abs=2)
    assert len(load_motion(path).positions) == pytest.approx(2 * 6, abs=2)
    with pytest.raises(MotionError, match=r"no clip 'Run'; allowed are 'Idle', 'Walk on', or 1 to 2"):
        load_motion(f"{path}#Run")


def test_joints_may_have_mixamo_s_names(tmp_path):
    """mixamorig9:LeftArm and the like, as its own files have them."""
    called = {"root": "Hips", "spine03": "Spine", "spine01": "Spine2", "neck01": "Neck", "head": "Head"}
    parts = {"clavicle": "Shoulder", "upperarm01": "Arm", "lowerarm01": "ForeArm", "wrist": "Hand"}
    parts |= {"upperleg01": "UpLeg", "lowerleg01": "Leg", "foot": "Foot"}
    called |= {f"{ours}.{side[0]}": side + theirs for ours, theirs in parts.items() for side in ("Left", "Right")}
    fbx = figure()
    kept = [bone for bone, name in enumerate(RIG.bone_names) if name in called]
    local = places(fbx, swinging(fbx))
    nearest = [next(up for up in RIG.ancestors(bone) if up in kept) for bone in range(RIG.bone_count)]
    above = [next((kept.index(up) for up in RIG.ancestors(bone)[1:] if up in kept), -1) for bone in kept]
    fbx = replace(
        fbx,
        joint_names=[f"mixamorig9:{called[RIG.bone_names[bone]]}" for bone in kept],
        joint_parents=np.array(above),
        binds=fbx.binds[kept],
        influence_joints=np.array([kept.index(bone) for bone in nearest])[fbx.influence_joints],
    )
    path = written(tmp_path, replace(fbx, clips={"mixamo.com": swinging(fbx)}))
    assert len(local) == FRAMES
    assert load_avatar(path, RIG).warnings == ()
    assert load_motion(path).positions.shape[1] == len(RIG.joint_names)


# --- What cannot be read


def test_the_process_that_loads_reads_it(tmp_path):
    """Within the limits that it has itself."""
    fbx = figure()
    path = written(tmp_path, replace(fbx, clips={"Walk": swinging(fbx)}))
    loader = AssetLoader(seconds=60, memory=1024)
    try:
        assert distances(loader.avatar(path).avatar.vertices, PERSON.vertices).max() < 0.05
        assert len(loader.motion(path).positions) > FRAMES
        path.write_bytes(path.read_bytes()[:9000])
        with pytest.raises(ValueError, match="it is not FBX that can be read: Truncated file; export it again"):
            loader.avatar(path)
    finally:
        loader.close()


def lying(fbx, count):
    """A binary file's content whose vertices are so many, by what it says."""
    content = bytearray(fbx)
    at = content.index(b"Vertices") + len("Vertices") + 1
    content[at : at + 4] = count.to_bytes(4, "little")
    return bytes(content)


@pytest.mark.parametrize(
    "content, told",
    [
        (lambda whole: b"", "Empty file; export it again"),
        (lambda whole: b"solid no such file", "it is not FBX that can be read: "),
        (lambda whole: whole[: len(whole) // 2], "Truncated file; export it again"),
        (lambda whole: lying(whole, 2**32 - 16), "it takes more than 2048 MiB of memory; use a smaller file"),
        (lambda whole: lying(whole, 2**20), "Bad DEFLATE data; export it again"),
    ],
    ids=["empty", "no FBX", "cut off", "a huge array", "a false size"],
)
def test_a_damaged_file_is_refused(tmp_path, content, told):
    path = written(tmp_path, panel())
    path.write_bytes(content(path.read_bytes()))
    with pytest.raises(AvatarError, match=told):
        load_avatar(path, RIG)


def test_takes_that_are_too_long_are_refused(tmp_path):
    fbx = panel()
    path = written(tmp_path, replace(fbx, clips={"Take": fbx.locals_as_bound()[None].repeat(2, 0)}, lasts=1e8))
    with pytest.raises(MotionError, match="takes more than 2048 MiB of memory; use a smaller file"):
        load_motion(path)


@pytest.mark.parametrize(
    "program, told",
    [
        ("kill -SEGV $$", r"the process that read it was ended \(SIGSEGV\); it is damaged, export it again"),
        ("exec sleep 60", "it could not be read within 1 s; use a smaller file"),
    ],
)
def test_a_file_that_ends_the_process_or_holds_it_up_is_refused(tmp_path, monkeypatch, program, told):
    path, python = written(tmp_path, panel()), tmp_path / "python"
    python.write_text(f"#!/bin/sh\n{program}\n")
    python.chmod(0o755)
    monkeypatch.setattr(fbx_file.sys, "executable", str(python))
    monkeypatch.setattr(fbx_file, "WITHIN", 1)
    with pytest.raises(AvatarError, match=told):
        load_avatar(path, RIG)


def test_without_ufbx_it_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(fbx_file, "find_spec", lambda name: None)
    with pytest.raises(AvatarError, match="it is FBX; to read it: pip install ufbx"):
        load_avatar(written(tmp_path, panel()), RIG)


FUZZ = """
import sys, ufbx
from pathlib import Path
from fuzzing import damaged
from physkin_core.formats.fbx_conversion import converted
from physkin_core.worker.serving import limit_resources
limit_resources(2048)
refused = 0
for seed in range(int(sys.argv[2])):
    try:
        converted(damaged(Path(sys.argv[1]).read_bytes(), seed), clips=True)
    except (MemoryError, ufbx.UfbxError):
        refused += 1
print(refused, flush=True)
import os
os._exit(0)
"""


@pytest.mark.parametrize("binary", [False, True])
def test_no_damage_ends_the_process(tmp_path, binary):
    """200 damaged files, read by one process: each is read or refused."""
    clip = panel().locals_as_bound()[None].repeat(3, 0)
    fbx = panel(clips={"Take": clip}, shapes={"tall": (np.ones((7, 3)), 50.0)}, colours={"skin": (1, 0, 0)})
    path = written(tmp_path, fbx, binary=binary)
    command = [sys.executable, "-c", FUZZ, str(path), "200"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[2])}
    done = subprocess.run(command, capture_output=True, env=environment, text=True)
    assert done.returncode == 0, signal.Signals(-done.returncode).name if done.returncode < 0 else done.stderr
    assert int(done.stdout) > 100

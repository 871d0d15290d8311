"""Files that end early or are damaged: every reader takes what is left, or refuses it in a sentence that names it.

Files are as small as their kinds allow, and cut at every length; larger ones at every so many bytes.
"""

from __future__ import annotations

import json
import warnings
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from core.motion.test_mocap import JOINTS as BODY_JOINTS
from core.motion.test_mocap import write_amc, write_bvh
from core.points.splat_files import splat_ply
from fuzzing import damaged
from gltf_person import PERSON, RIG, person_document, rig_json, write_gltf
from motion_files import smpl_arrays, write_gltf_clips
from random_models import random_model

from physkin_core import MotionError, load_avatar, load_garment_model, load_motion, save_garment_model
from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.rig_file import read_rig_file
from physkin_core.file_reading import LONGEST_SENTENCE
from physkin_core.formats.gltf_builder import write_glb
from physkin_core.mesh.mesh_file import read_mesh
from physkin_core.model.garment import GarmentError
from physkin_core.model.model_file import ModelFileError
from physkin_core.motion.loading import save_motion
from physkin_core.points.point_files import PointFileError, read_points
from physkin_core.rig.bones_file import BonesFileError, read_bones_file
from physkin_ros.joints.joint_map import JointMapError, load_joint_map
from physkin_ros.node.config_file import load_config
from physkin_ros.node.settings import SettingsError

TRIANGLE = "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0.5 0.5\nf 1/1 2/1 3/1\nf 3 2 1\n"
GARMENT, POINTS, MOTION = (read_mesh, GarmentError), (read_points, PointFileError), (load_motion, MotionError)


def box(name, **kind):
    """Writes a cube. kind: for trimesh, where the name does not say it."""

    def write(folder):
        trimesh.creation.box().export(folder / name, **kind)
        return folder / name

    return write


def content(name, given):
    """Writes a text, bytes, or data as JSON."""

    def write(folder):
        whole = given if isinstance(given, (str, bytes)) else json.dumps(given)
        (folder / name).write_bytes(whole if isinstance(whole, bytes) else whole.encode())
        return folder / name

    return write


def obj(folder):
    (folder / "a.mtl").write_text("newmtl red\nKd 1 0 0\nmap_Kd -s 2 2 a.png\n")
    (folder / "a.png").write_bytes(b"\x89PNG")
    return content("a.obj", f"mtllib a.mtl\no a\nusemtl red\n{TRIANGLE}l 1 2\n")(folder)


def library(folder):
    return obj(folder).with_suffix(".mtl")


def model(folder):
    save_garment_model(random_model(np.random.default_rng(1), learnt_sway=True), folder / "a.safetensors")
    return folder / "a.safetensors"


def clip(folder):
    whole = load_motion("walk")
    fields = ("positions", "root_orientation", "root_position")
    save_motion(replace(whole, **{name: getattr(whole, name)[:2] for name in fields}), folder / "a.safetensors")
    return folder / "a.safetensors"


def bvh(folder):
    return write_bvh(folder / "a.bvh", [{}] * 2)


def amc(folder):
    path = write_amc(folder, [{}] * 2)
    (folder / "07.asf").rename(folder / "a.asf")
    return path.rename(folder / "a.amc")


def gltf_clip(folder):
    return write_gltf_clips(folder / "a.glb", BODY_JOINTS, {"Walk": [{}] * 2})


def smpl(folder):
    np.savez(folder / "a.npz", **smpl_arrays([{}] * 2, width=66))
    return folder / "a.npz"


def skeleton(folder):
    return amc(folder).with_suffix(".asf")


def bag(name):
    def write(folder):
        pytest.importorskip("rosbags", reason="needs rosbags: pip install 'physkin[replay]'")
        from bag_messages import write_bag

        return write_bag(folder / name)

    return write


def glb(folder):
    write_glb(folder / "a.glb", person_document())
    return folder / "a.glb"


def gltf(folder):
    builder = person_document()
    (folder / "a.bin").write_bytes(builder.binary)
    write_gltf(folder / "a.gltf", builder, buffer_uri="a.bin")
    return folder / "a.gltf"


def buffer(folder):
    return gltf(folder).with_suffix(".bin")


def body(path):
    return load_avatar(path, RIG)


def bones(path):
    return read_bones_file(path, path, ["hips"], ["root"])


def joint_map(path):
    return load_joint_map(path, ["hip", "knee"])


BONES = rig_json(PERSON.bone_heads[:3], PERSON.bone_tails[:3], weights=False)
JOINTS = {"hip_l": {"joint": "hip", "scale": -1}, "b": "knee"}
SETTINGS = "drape_node:\n  ros__parameters:\n    model: tshirt\n    hide_covered: false\n"
FILES = {
    "garment model": (model, load_garment_model, ModelFileError, 397),
    "clip": (clip, *MOTION, 7),
    "BVH": (bvh, *MOTION, 11),
    "AMC": (amc, *MOTION, 11),
    "clip, GLB": (gltf_clip, *MOTION, 97),
    "clip, SMPL": (smpl, *MOTION, 97),
    "bones": (content("a.json", {"hips": "root"}), bones, BonesFileError, 1),
    "ASF": (skeleton, *MOTION, 31),
    "bag, MCAP": (bag("a.mcap"), *MOTION, 97),
    "bag, SQLite": (bag("a.db3"), *MOTION, 997),
    "OBJ": (obj, *GARMENT, 1),
    "material library": (library, *GARMENT, 1),
    "garment, GLB": (box("a.glb"), *GARMENT, 5),
    "garment, glTF": (gltf, *GARMENT, 97),
    "garment, PLY": (box("a.ply"), *GARMENT, 5),
    "garment, PLY as text": (box("a.ply", encoding="ascii"), *GARMENT, 5),
    "garment, STL": (box("a.stl"), *GARMENT, 5),
    "garment, STL as text": (box("a.stl", file_type="stl_ascii"), *GARMENT, 7),
    "garment, OFF": (box("a.off"), *GARMENT, 5),
    "points, OBJ": (obj, *POINTS, 1),
    "points, GLB": (box("a.glb"), *POINTS, 7),
    "points, PLY": (box("a.ply"), *POINTS, 3),
    "points, PLY as text": (box("a.ply", encoding="ascii"), *POINTS, 3),
    "splats": (content("a.ply", splat_ply("binary_little_endian", count=2)), *POINTS, 3),
    "splats as text": (content("a.ply", splat_ply("ascii", count=2)), *POINTS, 3),
    "avatar, GLB": (glb, body, AvatarError, 9973),
    "avatar, glTF": (gltf, body, AvatarError, 97),
    "avatar, buffer": (buffer, body, AvatarError, 9973),
    "rig": (content("a.json", BONES), read_rig_file, AvatarError, 7),
    "joint map": (content("a.json", JOINTS), joint_map, JointMapError, 1),
    "settings": (content("a.yaml", SETTINGS), load_config, SettingsError, 1),
}
READ_BY = {".mtl": ".obj", ".bin": ".gltf", ".asf": ".amc"}


every_kind = pytest.mark.parametrize(("write", "read", "error", "step"), FILES.values(), ids=FILES)


def refusals(read, file, error, contents) -> int:
    """How many of the contents (name -> bytes) of a file are refused, each in one sentence that names what is read."""
    path, refused = file.with_suffix(READ_BY.get(file.suffix, file.suffix)), 0
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        read(path)
        for name, changed in contents:
            file.write_bytes(changed)
            try:
                read(path)
            except error as wrong:
                text, refused = str(wrong), refused + 1
                assert path.stem in text and len(text) <= LONGEST_SENTENCE and text.isprintable(), (name, text)
            except Exception as wrong:
                raise AssertionError(f"{name}: {type(wrong).__name__}: {wrong}") from wrong
    return refused


@every_kind
def test_files_that_end_early(tmp_path, write, read, error, step):
    """Libraries of materials may: what is missing there is left out."""
    file = write(tmp_path)
    whole = file.read_bytes()
    lengths = range(0, len(whole), step)
    assert refusals(read, file, error, ((f"cut at {k}", whole[:k]) for k in lengths)) > 0 or file.suffix == ".mtl"


@pytest.mark.slow
@pytest.mark.timeout(3600)
@every_kind
def test_a_thousand_damages(tmp_path, write, read, error, step):
    """At random; of avatars, which take long where they are read, a hundred."""
    file = write(tmp_path)
    whole, count = file.read_bytes(), 100 if error is AvatarError else 1000
    least = 0 if file.suffix == ".mtl" else count // 20  # else nothing was damaged
    assert refusals(read, file, error, ((f"seed {k}", damaged(whole, k)) for k in range(count))) >= least

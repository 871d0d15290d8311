"""A GLB goes in, a dressed GLB comes out: the file stays as it was, and cloth is where the drape is."""

import json
from copy import deepcopy
from pathlib import Path

import numpy as np
import pytest
from gltf_person import PERSON, RIG, dressed_document, faces_on, person_document, primitive_of, write_gltf, write_vrm
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from physkin_core.avatar.loading import load_avatar
from physkin_core.cli import main
from physkin_core.export import dressed_file
from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME, write_glb
from physkin_core.formats.gltf_document import GltfEntry, parse_gltf
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.gltf_clip import GltfClip
from physkin_core.motion.loading import load_motion
from physkin_core.motion.motion import Motion
from physkin_core.outfit.outfit import Outfit

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")
CLOSE, FOLDS = 0.001, 0.005
"""[m] Off the drape: where joints alone move cloth, pose and keys take some tenths; morph targets leave up to 4 mm of
folds at rest, which skinning may stretch."""
AT_REST = GltfEntry({}, "")
WALK = load_motion("walk")
SLOW = Motion(RIG.joint_names, WALK.positions[::4], WALK.root_orientation[::4], WALK.root_position[::4], 15.0)


def raised_arms(frames=7):
    """From the side to the front and up, at 15 Hz."""
    there = np.linspace(0, 1, frames)[:, None]
    pose = {f"upperarm01.{side}_x": way * 1.2 for side, way in (("L", 1), ("R", -1))}
    pose |= {f"lowerarm01.{side}_z": -way * 0.8 for side, way in (("L", 1), ("R", -1))}
    positions = RIG.rest + there * (RIG.joint_positions(pose) - RIG.rest)
    still = np.tile([0.0, 0, 0, 1], (frames, 1)), np.tile([0.0, 0, 1], (frames, 1))
    return Motion(RIG.joint_names, positions, *still, 15.0)


def add_clip(builder, name, motion, unit):
    """A clip of a document whose joints are the rig's bones. unit: of its armature, a metre."""
    bones = RIG.bone_transforms(motion.positions_for(RIG))[..., :3]
    times = builder.add_accessor((motion.times + 0.5).astype(np.float32))  # not every tool begins at 0
    animation = {"name": name, "channels": [], "samplers": []}
    for bone, parent in enumerate(RIG.parents):
        above = bones[:, parent].transpose(0, 2, 1) if parent >= 0 else Rotation.from_quat(motion.root_orientation)
        local = above @ bones[:, bone] if parent >= 0 else above.as_matrix() @ bones[:, bone]
        turned = Rotation.from_matrix(FROM_ROOT_FRAME @ local @ FROM_ROOT_FRAME.T).as_quat()
        paths = {"rotation": turned}
        if parent < 0:
            paths["translation"] = unit * motion.root_position @ FROM_ROOT_FRAME.T
        for path, values in paths.items():
            target = {"node": bone, "path": path}
            animation["channels"].append({"sampler": len(animation["samplers"]), "target": target})
            output = builder.add_accessor(np.ascontiguousarray(values, dtype=np.float32))
            animation["samplers"].append({"input": times, "output": output})
    builder.document.setdefault("animations", []).append(animation)


def person_in(unit):
    """The person under an armature of so many units a metre, which has extras."""
    builder = person_document(vertices=unit * PERSON.vertices, joint_heads=unit * PERSON.bone_heads.astype(float))
    document = builder.document
    document |= {"extensions": {"EXT_of_somebody": {"kept": [1, 2]}}, "extensionsUsed": ["EXT_of_somebody"]}
    document["nodes"].append({"name": "Armature", "scale": [1 / unit] * 3, "children": [0], "extras": {"kept": 1}})
    roots = document["scenes"][0]["nodes"]
    roots[roots.index(0)] = len(document["nodes"]) - 1
    return builder


def export(path, *options):
    return main(
        ["export", str(path), "-g", "tshirt", "-o", str(Path(str(path).split("#")[0]).parent / "out.glb"), *options]
    )


def skinned(file, name, animation=AT_REST, seconds=0.0):
    """(v, 3) points of all meshes of a name in the scene at a time of a clip, in float64, and their faces."""
    everything, clip = list(file.node_order), GltfClip(file, animation)
    worlds = dict(zip(everything, (each[0] for each in clip.worlds(everything, np.array([seconds])))))
    points, faces = [], []
    for number, node in enumerate(file.nodes):
        if node.text("name") != name or "mesh" not in node:
            continue
        skin, mesh = (
            file.document.item("skins", node.integer("skin")),
            file.document.item("meshes", node.integer("mesh")),
        )
        inverse = file.accessor(skin.integer("inverseBindMatrices")).reshape(-1, 4, 4).transpose(0, 2, 1)
        joints = np.stack([worlds[joint] for joint in skin.indices("joints")]) @ inverse
        amounts = weights_at(file, number, animation, seconds) or mesh.numbers("weights") or []
        part = mesh.entries("primitives")[0]
        at = file.attribute(part, "POSITION")
        for amount, target in zip(amounts, part.entries("targets")):
            at = at + amount * file.accessor(target.integer("POSITION"))
        influences = file.attribute(part, "WEIGHTS_0")
        moved = np.einsum(
            "vk,vkij->vij", influences / influences.sum(axis=1, keepdims=True), joints[file.attribute(part, "JOINTS_0")]
        )
        faces += [file.triangles(each) + sum(map(len, points)) for each in mesh.entries("primitives")]
        points.append(np.einsum("vij,vj->vi", moved[:, :3, :3], at) + moved[:, :3, 3])
    return np.concatenate(points), np.concatenate(faces)


def weights_at(file, number, animation, seconds):
    """Of a mesh's morph targets, at a key."""
    for channel in animation.entries("channels"):
        if channel.members["target"] == {"node": number, "path": "weights"}:
            sampler = animation.item("samplers", channel.integer("sampler"))
            times, values = (file.accessor(sampler.integer(key)) for key in ("input", "output"))
            return values.reshape(len(times), -1)[abs(times[:, 0] - seconds).argmin()].tolist()
    return None


@pytest.fixture(scope="module", params=[1.0, 100.0], ids=["metres", "centimetres"])
def dressed(request, tmp_path_factory):
    """Folder of `in.glb`, and of `out.glb` with clothes."""
    folder, builder = tmp_path_factory.mktemp("dressed"), person_in(request.param)
    add_clip(builder, "Walk", SLOW, request.param)
    add_clip(builder, "Raise", raised_arms(), request.param)
    write_glb(folder / "in.glb", builder)
    assert export(folder / "in.glb", "--rate", "15") == 0
    return folder


@pytest.mark.parametrize(("clip", "motion"), [(0, SLOW), (1, raised_arms())])
def test_cloth_is_where_the_drape_on_this_body_is(dressed, clip, motion):
    file = GltfFile(dressed / "out.glb")
    model = load_garment_model("tshirt")
    outfit = Outfit([model.for_engines() if model.detail is None else model], load_avatar(dressed / "in.glb", RIG))
    played = file.document.item("animations", clip)
    for frame, (positions, time, root) in enumerate(zip(motion.positions_for(RIG), motion.times, motion.root)):
        (cloud,) = outfit.drape(positions, time=time, root=root)
        if frame % 3 == 0:
            there = (Rotation.from_quat(root[3:]).apply(cloud[:, :3]) + root[:3]) @ FROM_ROOT_FRAME.T
            points, faces = skinned(file, "tshirt", played, 0.5 + time)
            off = cKDTree(there).query(points[np.unique(faces)])[0]
            assert off.max() < FOLDS and np.quantile(off, 0.99) < CLOSE


def test_the_file_stays_as_it_was(dressed):
    """Its joints bear those of garment nodes, too; triangles under cloth are gone; clips are as long."""
    (before, binary), (after, longer) = (parse_gltf((dressed / name).read_bytes()) for name in ("in.glb", "out.glb"))
    before, after = before.members, after.members
    assert longer.startswith(binary.rstrip(b"\0"))
    for key in ("asset", "extensions", "scene"):
        assert after[key] == before[key]
    assert set(before["extensionsUsed"]) <= set(after["extensionsUsed"])
    for key in ("bufferViews", "accessors", "skins"):
        assert after[key][: len(before[key])] == before[key]
    for old, new in zip(before["nodes"], after["nodes"]):
        assert new.get("children", [])[: len(old.get("children", []))] == old.get("children", [])
        assert {**new, "children": None} == {**old, "children": None}
    (mesh,), kept = before["meshes"], deepcopy(after["meshes"][0])
    assert kept["primitives"][0].pop("indices") != mesh["primitives"][0]["indices"]
    assert kept["primitives"][0].pop("mode") == 4
    kept["primitives"][0]["indices"] = mesh["primitives"][0]["indices"]
    assert kept == mesh
    file = GltfFile(dressed / "out.glb")
    assert (
        0.5 < len(file.triangles(file.document.item("meshes", 0).entries("primitives")[0])) / len(PERSON.faces) < 0.95
    )
    for old, new in zip(before["animations"], after["animations"]):
        assert new["name"] == old["name"]
        assert new["channels"][: len(old["channels"])] == old["channels"]
        assert new["samplers"][: len(old["samplers"])] == old["samplers"]
        ends = {file.accessor(sampler["input"])[-1, 0] for sampler in new["samplers"]}
        assert np.ptp(list(ends)) < 1e-6


def test_only_a_named_clip(dressed, tmp_path):
    write_glb(tmp_path / "in.glb", builder := person_in(1.0))
    add_clip(builder, "Walk", SLOW, 1.0)
    add_clip(builder, "Raise", raised_arms(3), 1.0)
    write_glb(tmp_path / "in.glb", builder)
    assert export(f"{tmp_path / 'in.glb'}#Raise", "--rate", "15") == 0
    (walk, raised) = GltfFile(tmp_path / "out.glb").document.members["animations"]
    assert len(raised["channels"]) > len(walk["channels"]) == RIG.bone_count + 1


def test_without_a_clip_cloth_lies_at_rest_and_goes_along(tmp_path, capsys):
    """A .gltf with its buffer beside it, one level up its joints turn: cloth does, too."""
    builder = person_in(100.0)
    (tmp_path / "in.bin").write_bytes(builder.binary)
    write_gltf(tmp_path / "in.gltf", builder, buffer_uri="in.bin")
    assert export(tmp_path / "in.gltf") == 0
    assert "no clip" in capsys.readouterr().out
    (tmp_path / "in.bin").unlink()
    file = GltfFile(tmp_path / "out.glb")
    assert "animations" not in file.document
    at_rest, _ = skinned(file, "tshirt")
    spine = file.nodes[RIG.bone_index("spine05")].members
    turn = Rotation.from_euler("y", 40, degrees=True)
    spine["rotation"] = turn.as_quat().tolist()
    turned, _ = skinned(file, "tshirt")
    assert np.abs(np.ptp(at_rest, axis=0) - [0.6, 0.65, 0.3]).max() < 0.25  # metres
    high = at_rest[:, 1] > np.quantile(at_rest[:, 1], 0.5)
    pivot = file.node_worlds[RIG.bone_index("spine05"), :3, 3]
    assert np.linalg.norm(turned - turn.apply(at_rest - pivot) - pivot, axis=1)[high].mean() < 0.002


def test_a_vrm_stays_one(tmp_path):
    write_vrm(tmp_path / "in.vrm", vrm_version="0.x")
    assert main(["export", str(tmp_path / "in.vrm"), "-g", "tshirt", "-o", str(tmp_path / "out.vrm")]) == 0
    before, after = (parse_gltf((tmp_path / name).read_bytes())[0].members for name in ("in.vrm", "out.vrm"))
    assert after["extensions"] == before["extensions"] and "VRM" in after["extensionsUsed"]
    there = load_avatar(tmp_path / "out.vrm", RIG)
    assert np.abs(there.bone_heads - load_avatar(tmp_path / "in.vrm", RIG).bone_heads).max() < 1e-5
    file = GltfFile(tmp_path / "out.vrm")
    cloth, faces = skinned(file, "tshirt")
    skin, _ = skinned(file, before["nodes"][-1]["name"])
    assert cKDTree(skin).query(cloth[np.unique(faces)])[0].max() < 0.1, "it is worn"


def test_clothes_that_are_replaced_are_gone(tmp_path):
    builder = dressed_document(sleeves="short", skin_beneath=True)
    write_glb(tmp_path / "in.glb", builder)
    assert export(tmp_path / "in.glb") == 0
    file = GltfFile(tmp_path / "out.glb")
    left = {
        each.text("name"): len(file.triangles(each.entries("primitives")[0]))
        for each in file.document.entries("meshes")
    }
    assert left["Wolf3D_Outfit_Top"] == 1  # that has no area: none is not allowed
    before = {
        mesh["name"]: builder.document["accessors"][mesh["primitives"][0]["indices"]]["count"] // 3
        for mesh in builder.document["meshes"]
    }
    assert 0.8 < left["Wolf3D_Outfit_Bottom"] / before["Wolf3D_Outfit_Bottom"] < 1, "but for its top, under the shirt"
    assert left["Wolf3D_Hair"] == before["Wolf3D_Hair"]


def test_skin_that_the_file_lacks_is_lent(tmp_path):
    """Under long sleeves that a T-shirt replaces."""
    write_glb(tmp_path / "in.glb", dressed_document(sleeves="long"))
    assert export(tmp_path / "in.glb") == 0
    file = GltfFile(tmp_path / "out.glb")
    skin, faces = skinned(file, "skin")
    arms = np.unique(faces_on("lowerarm"))
    there = PERSON.vertices[arms] @ FROM_ROOT_FRAME.T
    assert np.quantile(cKDTree(skin[np.unique(faces)]).query(there)[0], 0.9) < 0.02


def test_what_is_compressed_by_draco_stays(tmp_path, capsys, monkeypatch):
    """Indices of Draco are not the document's."""
    write_glb(tmp_path / "in.glb", builder := person_in(1.0))
    monkeypatch.setattr(dressed_file, "DRACO", "EXT_packed")
    primitive_of(builder)["extensions"] = {"EXT_packed": {}}
    write_glb(tmp_path / "in.glb", builder)
    assert export(tmp_path / "in.glb") == 0
    assert "triangles that cloth covers stay, as EXT_packed holds them" in capsys.readouterr().err
    assert GltfFile(tmp_path / "out.glb").document.members["meshes"][0] == builder.document["meshes"][0]


def test_refusals(tmp_path, monkeypatch, capsys):
    builder = person_in(1.0)
    add_clip(builder, "Raise", raised_arms(3), 1.0)
    write_glb(tmp_path / "in.glb", builder)
    assert export(f"{tmp_path / 'in.glb'}#Jump") == 2
    assert "no clip 'Jump'; allowed are 'Raise'" in capsys.readouterr().err
    monkeypatch.setattr(dressed_file, "MOST_FRAMES", 5)
    assert export(tmp_path / "in.glb") == 2
    assert "its clips have 9 frames at 60 Hz, allowed are 5; choose one with #NAME" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "in.glb"), "-g", "tshirt", "-o", str(tmp_path / "in.glb")]) == 2
    assert "it is the file that is read" in capsys.readouterr().err
    for options in (("--source-rate", "30"), ("--rate", "-1"), ("--rate", "nan")):
        assert export(tmp_path / "in.glb", *options) == 2
        assert "clips keep their own times" in capsys.readouterr().err
    assert main(["export", str(tmp_path / "in.glb"), "-g", "tshirt", "-o", str(tmp_path / "out.vrm")]) == 2
    assert "cannot write out.vrm" in capsys.readouterr().err


def test_on_another_avatar_a_clip_is_motion_alone(tmp_path):
    builder = person_in(1.0)
    add_clip(builder, "Raise", raised_arms(3), 1.0)
    write_glb(tmp_path / "in.glb", builder)
    write_glb(tmp_path / "other.glb", person_document())
    assert export(tmp_path / "in.glb", "--avatar", str(tmp_path / "other.glb"), "--rate", "10") == 0
    document, _ = parse_gltf((tmp_path / "out.glb").read_bytes())
    assert "extensions" not in document and "EXT_of" not in json.dumps(document.members)

"""`physkin export`: files read back by their own libraries, against what the outfit drapes."""

import re
from dataclasses import replace

import numpy as np
import pytest
from core.export.gltf_reader import Reader, in_gltf_world
from core.export.seen_pokes import count
from core.export.smooth_models import smooth_model
from random_models import random_detail
from scipy.spatial import cKDTree

from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model, load_motion, save_garment_model
from physkin_core.cli import main
from physkin_core.export import morph_targets
from physkin_core.export.gltf_motion import write_gltf_motion
from physkin_core.model.garment import vertex_normals
from physkin_core.model.skinning import unit
from physkin_core.outfit.coverage import faces_of
from physkin_core.runtime.evaluator import Skinner

RATE = 10.0


@pytest.fixture(scope="module")
def motion():
    return load_motion("walk").resampled(RATE)


@pytest.fixture(scope="module")
def worn():
    return [smooth_model(name) for name in ("trousers", "longsleeve")]


@pytest.fixture(scope="module")
def folded(worn, tmp_path_factory):
    """A T-shirt with folds of centimetres, and its file."""
    shirt = worn[1]
    rng, width = np.random.default_rng(1), len(shirt.node_deformer[-2][1])
    detail = random_detail(rng, shirt.garment, 60, width=width, features=20, offset=0.002)
    shirt, path = replace(shirt, name="folded", detail=detail), tmp_path_factory.mktemp("folded") / "folded.safetensors"
    save_garment_model(shirt, path)
    return load_garment_model(path), str(path)


@pytest.fixture(scope="module")
def trousers_file(worn, tmp_path_factory):
    path = tmp_path_factory.mktemp("trousers") / "trousers.safetensors"
    save_garment_model(worn[0], path)
    return str(path)


@pytest.fixture(scope="module")
def whole(worn):
    """The outfit that a .glb is made of."""
    return Outfit([model.for_engines() for model in worn], load_avatar(BUNDLED_AVATAR, worn[0].rig), hide_covered=False)


@pytest.fixture(scope="module")
def walking(tmp_path_factory, motion, whole):
    """The exported walk, read back, and its clouds."""
    path = tmp_path_factory.mktemp("walk") / "walk.glb"
    assert write_gltf_motion(path, whole, motion, looks=[None] * 3) == []
    whole.reset()
    frames = zip(motion.positions_for(whole.rig), motion.times, motion.root)
    return Reader(path), [whole.drape(positions, time=time, root=root) for positions, time, root in frames]


def test_an_engine_sees_what_is_draped(walking, motion, whole):
    """Garments and body of a .glb, skinned as engines do, are within 0.2 mm of the drape with 4 influences; where the
    order of layers moves cloth on average, and nowhere by more than 5 mm."""
    reader, clouds = walking
    np.testing.assert_allclose(np.diff(reader.times), 1 / RATE, atol=1e-6)
    assert len(reader.times) == motion.frame_count
    for frame in (0, motion.frame_count // 2):
        trousers, shirt = (in_gltf_world(cloud[:, :3], motion, frame) for cloud in clouds[frame])
        assert cKDTree(trousers).query(reader.skinned("trousers", frame))[0].max() < 2e-4
        apart = np.linalg.norm(reader.skinned("longsleeve", frame) - shirt, axis=1)
        assert apart.mean() < 2e-4 and apart.max() < 5e-3
        body = in_gltf_world(whole.posed_body(motion.positions_for(whole.rig)[frame]), motion, frame)
        assert cKDTree(body).query(reader.skinned("body", frame))[0].max() < 2e-4


def test_what_no_frame_shows_is_left_out(walking, motion, whole):
    """Trousers under the shirt and skin under both, more than everyday poses cover, as a walk moves less. That
    nothing is missed is tested below."""
    reader, _ = walking
    trousers, shirt = whole.layers
    assert len(reader.faces("longsleeve")) == len(shirt.faces)
    assert len(reader.faces("trousers")) < (~faces_of(trousers.faces, trousers.hidden)).sum()
    assert len(reader.faces("body")) < (~whole.body_mask).sum()


def test_layers_keep_their_order_in_the_file(walking, motion, whole):
    """No more than 0.1 % of the pixels that the shirt covers show trousers or nothing; a hundred times as many would
    without morph targets."""
    reader, clouds = walking
    frames = range(0, motion.frame_count, 3)
    over, beneath, missing = sum(count(reader, whole, motion, frame, clouds[frame]) for frame in frames)
    assert over > 10_000 and beneath + missing < 1e-3 * over
    for weights in (values for (_, path), values in reader.moved.items() if path == "weights"):
        assert 0 <= weights.min() and weights.max() <= 1, "Blender shows no others"


def test_what_is_in_the_file_has_names(walking):
    reader, _ = walking
    assert reader.file.animations[0].name == "walk"
    names = ["body", "trousers", "longsleeve"]
    for kind in ("meshes", "skins", "materials"):
        assert [each.name for each in getattr(reader.file, kind)] == names
    assert all(node.name for node in reader.file.nodes)
    shirt = reader.mesh("longsleeve")
    assert len(set(shirt.extras["targetNames"])) == len(shirt.primitives[0].targets) > 0


def test_what_a_glb_cannot_show_is_told(tmp_path, motion, whole, monkeypatch):
    """Without morph targets the shirt's order is not kept: how far off it is, and what to do."""
    monkeypatch.setattr(morph_targets, "MOST_TARGETS", 0)
    (told,) = write_gltf_motion(tmp_path / "walk.glb", whole, motion, looks=[None] * 3)
    off = rf"longsleeve is up to \d+ mm off in \d+ of {motion.frame_count} frames, .* a \.usdc has it exactly"
    assert re.match(off, told)


def test_joints_rest_where_meshes_are_bound(walking):
    """Else Blender, which skins to the joints at rest first, shows garments a centimetre off."""
    reader, _ = walking
    nodes = reader.file.nodes

    def place(node):
        if nodes[node].name == "root":
            return np.zeros(3)
        assert nodes[node].rotation is None and nodes[node].scale is None
        return place(reader.parents[node]) + np.array(nodes[node].translation)

    for skin in reader.file.skins:
        bind = reader.array(skin.inverseBindMatrices).reshape(-1, 4, 4).transpose(0, 2, 1)
        np.testing.assert_allclose(bind[:, :3, :3], np.tile(np.eye(3), (len(bind), 1, 1)))
        np.testing.assert_allclose([place(joint) for joint in skin.joints], -bind[:, :3, 3], atol=1e-6)


def test_usd_has_every_vertex(tmp_path, motion, worn, trousers_file, folded):
    """Points of body and garments, with detail, layers in order, swaying, in wind, to a float's rounding; the root
    moves; metres, Z up."""
    pytest.importorskip("pxr", reason="needs the extra [usd]")
    from pxr import Usd, UsdGeom

    shirt, path = folded
    options = [
        "--no-separate-limbs",
        "--rate",
        f"{RATE:g}",
        "--sway",
        "0.5",
        "--wind",
        "-4",
        "1",
        "0",
        "-o",
        str(tmp_path / "walk.usdc"),
    ]
    assert main(["export", "walk", "-g", trousers_file, "-g", path, *options]) == 0
    stage = Usd.Stage.Open(str(tmp_path / "walk.usdc"))
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert (stage.GetTimeCodesPerSecond(), stage.GetEndTimeCode()) == (RATE, motion.frame_count - 1)
    outfit = Outfit([worn[0], shirt], load_avatar(BUNDLED_AVATAR, shirt.rig))
    outfit.sway, outfit.wind = 0.5, (-4.0, 1.0, 0.0)
    for frame, positions in enumerate(motion.positions_for(worn[0].rig)):
        clouds = outfit.drape(positions, time=frame / RATE, root=motion.root[frame])
        for layer, cloud in zip(outfit.layers, clouds):
            mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/avatar/{layer.name}"))
            np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(frame)), cloud[:, :3], atol=1e-7)
            assert len(mesh.GetFaceVertexIndicesAttr().Get()) == layer.faces.size
        place = UsdGeom.Xformable(stage.GetPrimAtPath("/avatar")).ComputeLocalToWorldTransform(frame)
        np.testing.assert_allclose(place.ExtractTranslation(), motion.root_position[frame], atol=1e-6)
    assert usd_faults(stage) == []


def test_detail_is_in_morph_targets(tmp_path, folded, motion, monkeypatch, capsys):
    """The file is the drape of the model's own influences, to the millimetres that are told, which are more without
    targets; normals turn along, closer to those of the folds than skinning carries them."""
    model, path = folded
    outfit = Outfit([model], load_avatar(BUNDLED_AVATAR, model.rig), hide_covered=False)

    def exported(output):
        assert (
            main(["export", "walk", "-g", path, "--no-separate-limbs", "--rate", f"{RATE:g}", "-o", str(output)]) == 0
        )
        told = (
            r"folded is (\S+) mm off on average, (\S+) mm at most, because (\d+) morph targets hold its folds; a \.usdc"
        )
        return Reader(output), [float(number) for number in re.search(told, capsys.readouterr().err).groups()]

    reader, (mean, most, targets) = exported(tmp_path / "walk.glb")
    assert reader.mesh("folded").extras["targetNames"] == [f"fold_{k}" for k in range(int(targets))] and targets > 1
    given = outfit.layers[0].bound_visible
    apart, turned, unturned = [], [], Skinner(replace(given, faces=given.faces[:0]))  # rest normals know no folds
    rows = np.empty((len(given.vertices), 6), dtype=np.float32)
    for frame, positions in enumerate(motion.positions_for(outfit.rig)):
        (cloud,) = outfit.drape(positions, time=motion.times[frame], root=motion.root[frame])
        points = in_gltf_world(cloud[:, :3], motion, frame)
        apart.append(1000 * np.linalg.norm(reader.skinned("folded", frame) - points, axis=1))
        normals = vertex_normals(points, model.garment.faces)
        skinned = unit(reader.skinned("folded", frame, "NORMAL"))
        unturned.skin(outfit.node_transforms()[0], rows, outfit.detail_offsets()[0])
        carried = in_gltf_world(rows[:, 3:], replace(motion, root_position=np.zeros_like(motion.root_position)), frame)
        turned.append([np.arccos(np.clip((each * normals).sum(axis=1), -1, 1)).mean() for each in (skinned, carried)])
    assert np.mean(apart) == pytest.approx(mean, abs=0.02) and np.max(apart) == pytest.approx(most, abs=0.1)
    skinned, carried = np.degrees(np.mean(turned, axis=0))
    assert skinned < 4 and skinned < carried / 4
    monkeypatch.setattr(morph_targets, "MOST_TARGETS", 0)
    assert exported(tmp_path / "without.glb")[1][0] > 4 * mean


def usd_faults(stage):
    """What the validators that come with USD find wrong."""
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    return [fault.GetMessage() for fault in UsdValidation.ValidationContext(validators).Validate(stage)]


@pytest.mark.parametrize(
    "options, told",
    [
        (["walk", "-o", "walk.fbx"], "cannot write walk.fbx: allowed are .glb, .usd, .usdc"),
        (["walk", "-g", "tshirt", "--tucked", "skirt", "-o", "x.glb"], "--tucked skirt: none of the garments"),
        (["strut", "-o", "x.glb"], "strut"),
    ],
)
def test_what_cannot_be_exported_is_told(options, told, capsys):
    assert main(["export", *options]) == 2
    assert told in capsys.readouterr().err

"""`physkin export`: files read back by their own libraries, against what the outfit drapes."""

import numpy as np
import pytest
from core.export.gltf_reader import Reader, in_gltf_world, skinned_layers

from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model, load_motion
from physkin_core.cli import main

RATE = 10.0


@pytest.fixture(scope="module")
def motion():
    return load_motion("walk").resampled(RATE)


@pytest.fixture(scope="module")
def worn():
    return [load_garment_model(name) for name in ("trousers", "tshirt")]


def export(path, *options):
    assert (
        main(["export", "walk", "-g", "trousers", "-g", "tshirt", "--rate", f"{RATE:g}", *options, "-o", str(path)])
        == 0
    )


def test_an_engine_sees_what_is_draped(tmp_path, motion, worn):
    """Garments and body of a .glb, skinned as engines do, are within 0.2 mm of the drape with 4 influences."""
    export(tmp_path / "walk.glb")
    reader = Reader(tmp_path / "walk.glb")
    avatar = load_avatar(BUNDLED_AVATAR, worn[0].rig)
    outfit = Outfit([model.for_engines() for model in worn], avatar)
    positions = motion.positions_for(worn[0].rig)
    np.testing.assert_allclose(np.diff(reader.times), 1 / RATE, atol=1e-6)
    assert len(reader.times) == motion.frame_count
    for frame in range(motion.frame_count // 2 + 1):
        outfit.drape(positions[frame], time=frame / RATE, root=motion.root[frame])
        if frame not in (0, motion.frame_count // 2):
            continue
        for model, cloud in zip(worn, skinned_layers(outfit)):
            distance = reader.skinned(model.name, frame) - in_gltf_world(cloud, motion, frame)
            assert np.linalg.norm(distance, axis=1).max() < 2e-4, model.name
        body = outfit.posed_body(positions[frame])
        distance = reader.skinned("body", frame) - in_gltf_world(body, motion, frame)
        assert np.linalg.norm(distance, axis=1).max() < 2e-4
    faces = reader.array(reader.file.meshes[0].primitives[0].indices)
    assert len(faces) == 3 * (~outfit.body_mask).sum(), "skin under cloth is left out"


def test_joints_rest_where_meshes_are_bound(tmp_path):
    """Else Blender, which skins to the joints at rest first, shows garments a centimetre off."""
    export(tmp_path / "walk.glb")
    reader = Reader(tmp_path / "walk.glb")
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


def test_usd_has_every_vertex(tmp_path, motion, worn):
    """Points of body and garments, layers in order and swaying, to a float's rounding; the root moves; metres, Z up."""
    pytest.importorskip("pxr", reason="needs the extra [usd]")
    from pxr import Usd, UsdGeom

    export(tmp_path / "walk.usdc", "--sway", "0.5")
    stage = Usd.Stage.Open(str(tmp_path / "walk.usdc"))
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 1
    assert (stage.GetTimeCodesPerSecond(), stage.GetEndTimeCode()) == (RATE, motion.frame_count - 1)
    outfit = Outfit(worn, load_avatar(BUNDLED_AVATAR, worn[0].rig))
    outfit.sway = 0.5
    for frame, positions in enumerate(motion.positions_for(worn[0].rig)):
        clouds = outfit.drape(positions, time=frame / RATE, root=motion.root[frame])
        for layer, cloud in zip(outfit.layers, clouds):
            mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/avatar/{layer.name}"))
            np.testing.assert_allclose(np.array(mesh.GetPointsAttr().Get(frame)), cloud[:, :3], atol=1e-7)
            assert len(mesh.GetFaceVertexIndicesAttr().Get()) == layer.faces.size
        place = UsdGeom.Xformable(stage.GetPrimAtPath("/avatar")).ComputeLocalToWorldTransform(frame)
        np.testing.assert_allclose(place.ExtractTranslation(), motion.root_position[frame], atol=1e-6)
    assert usd_faults(stage) == []


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

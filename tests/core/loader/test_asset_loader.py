"""Outfits that another process has bound: the same bits as here, and files that end that process end nothing else."""

from __future__ import annotations

import dataclasses
import os
import signal
import time
from threading import Thread

import numpy as np
import pytest
from core.points.splat_files import splat_ply
from threadpoolctl import threadpool_limits

from physkin_core import (
    BUNDLED_AVATAR,
    LimbSeparator,
    Outfit,
    WornGarment,
    load_avatar,
    load_body_model,
    load_garment_model,
    load_motion,
)
from physkin_core.loader.asset_loader import AssetLoader
from physkin_core.loader.requests import GarmentRequest, OutfitRequest
from physkin_core.look.avatar_look import avatar_colours
from physkin_core.points.point_files import read_splat_file
from physkin_core.points.splat_draper import SplatSkinner, bind_splats

pytestmark = pytest.mark.filterwarnings("ignore::physkin_core.AvatarWarning")

BODY = str(BUNDLED_AVATAR)


def request(*garments, body=BODY, **more):
    """For garments or names of models on a body."""
    worn = [GarmentRequest(each) if isinstance(each, str) else each for each in garments]
    return OutfitRequest(tuple(worn), str(body), **more)


@pytest.fixture(scope="module", autouse=True)
def one_thread():
    """As in the process that loads: with more, BLAS adds up in another order, and the last bits differ."""
    with threadpool_limits(1):
        yield


@pytest.fixture(scope="module")
def avatar():
    return load_avatar(BUNDLED_AVATAR, load_body_model().rig)


@pytest.fixture(scope="module")
def frames():
    """Poses, times and places of a dance."""
    motion = load_motion("dance").resampled(30.0)
    positions = motion.positions_for(load_body_model().rig)[:30]
    roots = np.concatenate([motion.root_position, motion.root_orientation], axis=1)[:30]
    return [(pose, k / 30, root) for k, (pose, root) in enumerate(zip(positions, roots))]


def test_frames_are_the_same_bits_as_of_this_process(asset_loader, avatar, frames):
    """With sway, garment nodes, what is hidden, and what is said of it; the networks stay where they were folded in."""
    worn = GarmentRequest("tanktop", tucked=True), GarmentRequest("skirt:denim", fit=0.5)
    here = Outfit([WornGarment(load_garment_model(g.model), tucked=g.tucked, fit=g.fit) for g in worn], avatar)
    there, _ = asset_loader.outfit(request(*worn))
    for pose, time_of, root in frames:
        expected = here.drape(pose, time=time_of, root=root)
        for cloud, wanted in zip(there.drape(pose, time=time_of, root=root), expected, strict=True):
            np.testing.assert_array_equal(cloud, wanted)
        for nodes, wanted in zip(there.node_transforms(), here.node_transforms()):
            np.testing.assert_array_equal(nodes, wanted)
    assert there.warnings == here.warnings and there.joint_names == here.joint_names
    np.testing.assert_array_equal(there.body_mask, here.body_mask)
    np.testing.assert_array_equal(there.body_to_draw.vertices, here.body_to_draw.vertices)
    for layer, wanted in zip(there.layers, here.layers):
        assert (layer.name, layer.at_rest, layer.moved) == (wanted.name, wanted.at_rest, wanted.moved)
        np.testing.assert_array_equal(layer.visible, wanted.visible)
        np.testing.assert_array_equal(layer.rest_garment.edge_lengths, wanted.rest_garment.edge_lengths)
        assert not hasattr(layer.model, "pose_modulator")


def test_precision_is_of_this_process(asset_loader, avatar, frames, model_path):
    here = Outfit([load_garment_model(model_path)], avatar, precision="fp32")
    there, _ = asset_loader.outfit(request(str(model_path)), precision="fp32")
    np.testing.assert_array_equal(there.drape(frames[9][0])[0], here.drape(frames[9][0])[0])
    assert there.precision == "fp32"
    with pytest.raises(ValueError, match="fp8"):
        asset_loader.outfit(request(str(model_path)), precision="fp8")


def test_limbs_colours_and_motion(asset_loader, avatar, frames, model_path):
    """As this process would have them; none that were not asked for. A body alone has its accessories."""
    _, loaded = asset_loader.outfit(request(str(model_path), limbs=True, colours=True))
    separator, expected = LimbSeparator.from_bound(loaded.limbs), LimbSeparator(load_body_model().rig, avatar)
    assert separator.warnings == expected.warnings and separator.joint_names == expected.joint_names
    for pose, _, _ in frames[:5]:
        folded = 1.5 * pose
        np.testing.assert_array_equal(separator.separate(folded)[0], expected.separate(folded)[0])
    loaded_colours = loaded.colours
    np.testing.assert_array_equal(loaded_colours, avatar_colours(avatar.with_accessories()))
    _, loaded = asset_loader.outfit(request(str(model_path)))
    assert loaded.limbs is loaded.colours is loaded.splats is None
    motion, wanted = asset_loader.motion("dance"), load_motion("dance")
    assert motion.joint_names == wanted.joint_names and motion.rate_hz == wanted.rate_hz
    np.testing.assert_array_equal(motion.positions, wanted.positions)
    alone = asset_loader.avatar(BUNDLED_AVATAR)
    np.testing.assert_array_equal(alone.avatar.vertices, avatar.with_accessories().vertices)
    np.testing.assert_array_equal(alone.colours, loaded_colours)


def test_splats_and_why_they_cannot_be_used(asset_loader, tmp_path, garment_model, model_path):
    near, far = tmp_path / "near.ply", tmp_path / "far.ply"
    near.write_bytes(splat_ply("binary_little_endian", garment_model.garment.vertices[:300]))
    far.write_bytes(splat_ply("ascii", garment_model.garment.vertices[:300] + [0, 0, 1]))
    outfit, loaded = asset_loader.outfit(request("shorts", str(model_path), points=str(near)))
    assert loaded.splats.garment == 1 and not loaded.splats_refused
    outfit.drape(outfit.rig.rest)
    told = outfit.node_transforms()[1], outfit.detail_offsets()[1]
    file = read_splat_file(near)
    expected = SplatSkinner(bind_splats(outfit.layers[1], file.splats)).skin(*told)
    found = SplatSkinner(loaded.splats.bound).skin(*told)
    np.testing.assert_array_equal(found.centres, expected.centres)
    np.testing.assert_array_equal(found.rotations, expected.rotations)
    assert loaded.splats.look.tolist() == file.look.tolist() and loaded.splats.look.dtype.names == file.look.dtype.names
    _, loaded = asset_loader.outfit(request(str(model_path), points=str(far)))
    assert loaded.splats is None and "far.ply: point" in loaded.splats_refused


def test_outfits_are_known_by_content(asset_loader, tmp_path, model_path):
    """The same body under another name is known; a changed file under the same name is not what was known."""
    body, copy = tmp_path / "body.glb", tmp_path / "copy.glb"
    content = BUNDLED_AVATAR.read_bytes() + b"\0" * 8  # of this test's own
    for path in (body, copy):
        path.write_bytes(content)
    wanted = [request(str(model_path), body=path) for path in (body, body, copy)]
    (first, one), (again, two), (renamed, three) = map(asset_loader.outfit, wanted)
    assert (one.cached, two.cached, three.cached) == (False, True, True)
    assert [each.avatar.source for each in (first, again, renamed)] == [str(body), str(body), str(copy)]
    rest = first.rig.rest
    for each in (again, renamed):
        assert each is not first and each.layers[0] is first.layers[0], "arrays must be shared"
        np.testing.assert_array_equal(each.drape(rest), first.drape(rest))
    body.write_bytes(BUNDLED_AVATAR.read_bytes() + b"\0" * 4)
    assert not asset_loader.outfit(wanted[0])[1].cached
    del first, again, renamed, each  # what nobody wears any more is kept by the process that loads, and sent again
    again, loaded = asset_loader.outfit(wanted[2])
    assert loaded.cached and loaded.bound is not None and len(again.drape(rest)[0])
    for others in ({"hide_covered": False}, {"garments": (GarmentRequest(str(model_path), fit=0.0),)}):
        assert not asset_loader.outfit(dataclasses.replace(wanted[2], **others))[1].cached


@pytest.mark.parametrize(
    ("wanted", "told"),
    [
        (request("kilt"), "no garment model 'kilt'"),
        (request("tshirt", body="/nowhere/body.glb"), "avatar /nowhere/body.glb: no such file"),
        (request("tshirt", "tshirt"), "'tshirt' is there 2 times"),
        (request(GarmentRequest("tshirt", tucked=True)), "'tshirt' is tucked, but no layer after it"),
        (request(GarmentRequest("tshirt", fit=2.0)), "fit must be 0"),
    ],
)
def test_what_cannot_be_worn_is_refused_in_a_sentence(asset_loader, wanted, told):
    before = asset_loader.pid
    with pytest.raises(ValueError, match=told):
        asset_loader.outfit(wanted)
    assert asset_loader.pid == before


def test_too_large_for_the_memory(tmp_path):
    """One sentence; what fits is loaded all the same."""
    loader, count = AssetLoader(memory=128), 3_000_000
    header = f"ply\nformat binary_little_endian 1.0\nelement vertex {count}\n"
    header += "property float x\nproperty float y\nproperty float z\n"
    header += "element face 1\nproperty list uchar int vertex_indices\nend_header\n"
    path = tmp_path / "large.ply"
    path.write_bytes(header.encode() + bytes(12 * count) + b"\3" + bytes(12))
    try:
        with pytest.raises(ValueError, match="large.ply .*(?i:memory)"):
            loader.avatar(path)
        assert loader.motion("walk").frame_count == 77
    finally:
        loader.close()


def test_a_process_that_is_killed_while_it_loads(tmp_path):
    """Whoever has asked is told, and asks again."""
    loader, told = AssetLoader(), []

    def load() -> None:
        try:
            loader.avatar(BODY)
        except ValueError as error:
            told.append(str(error))

    try:
        loader.motion("walk")
        before = loader.pid
        os.kill(before, signal.SIGSTOP)
        loading = Thread(target=load)
        loading.start()
        time.sleep(0.2)
        os.kill(before, signal.SIGKILL)
        loading.join(10)
        assert len(told) == 1 and f"{BODY} could not be loaded" in told[0] and "(SIGKILL)" in told[0]
        assert loader.motion("walk").frame_count == 77 and loader.pid != before
    finally:
        loader.close()

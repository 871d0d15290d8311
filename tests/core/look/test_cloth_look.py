"""What cloth looks like: tiles in the garment's colour, in looks, pictures and exports."""

import io
import json
import struct

import numpy as np
import pytest

from physkin_core import FABRICS, save_garment_model
from physkin_core.avatar.body_model import load_body_model
from physkin_core.cli import main
from physkin_core.look.cloth_look import CLOTHS, FABRICS_PATH, cloth_colour, cloth_look, dyed
from physkin_core.mesh.surfaces import surfaces_of
from physkin_core.mesh.tiles_seen import colours_seen, normals_seen
from physkin_core.pictures.picture import Mesh, render
from tests.random_models import random_model, sewn_tube

Image = pytest.importorskip("PIL.Image", reason="needs pillow: pip install 'physkin[view]'")

TEAL = (0.12, 0.44, 0.46)
LARGEST = 400_000
"""[bytes] Of all tiles together."""


def test_every_fabric_has_a_look_and_tiles_are_small():
    assert CLOTHS.keys() == FABRICS.keys()
    assert sum(file.stat().st_size for file in FABRICS_PATH.iterdir()) < LARGEST


@pytest.mark.parametrize("fabric", CLOTHS)
def test_a_tile_in_a_colour_is_about_that_colour(fabric):
    """From afar: the mean of the tile, in light. Threads that are not dyed make it greyer, most of all denim's weft."""
    cloth = CLOTHS[fabric]
    content = dyed((FABRICS_PATH / f"{cloth.tile}.png").read_bytes(), cloth, TEAL)
    image = Image.open(io.BytesIO(content))
    image.verify()
    pixels = np.asarray(Image.open(io.BytesIO(content)).convert("RGB")) / 255
    mean = (pixels**2.2).mean(axis=(0, 1)) ** (1 / 2.2)
    np.testing.assert_allclose(mean[1:], TEAL[1:], atol=0.09)
    assert TEAL[0] - 0.05 < mean[0] < mean[1] - 0.1
    assert pixels.std(axis=(0, 1)).max() > 0.01


@pytest.mark.parametrize(
    ("fabric", "expected"),
    [("", TEAL), ("jersey", TEAL), ("denim", (42 / 255, 66 / 255, 114 / 255)), ("denim:#000", (0, 0, 0))],
)
def test_the_colour_named_wins_over_the_fabrics_own_and_the_layers(fabric, expected):
    assert cloth_colour(fabric, TEAL) == pytest.approx(expected)


@pytest.fixture(scope="module")
def denim():
    """Its surface, on half of the faces of a tube."""
    tube = sewn_tube()
    chosen = np.arange(len(tube.faces)) % 2 == 0
    look = cloth_look(tube, "denim:teal", chosen, TEAL)
    np.testing.assert_array_equal(look.uv, tube.panel_places[tube.panel_faces[chosen]])
    (surface,) = surfaces_of(look, "skirt", TEAL, len(look.uv))
    return surface


def test_the_look_lies_along_the_grain_in_metres(denim):
    assert denim.name == "denim" and denim.roughness == 0.9
    assert denim.repeats == denim.normal_repeats == pytest.approx((1 / 0.0176,) * 2, rel=1e-5)
    assert denim.picture.name == "denim.png" and denim.normals.name == "denim_normal.png"


def test_cloth_that_was_not_cut_flat_has_no_grain():
    garment = random_model(np.random.default_rng(0)).garment
    assert cloth_look(garment, "denim", np.ones(len(garment.faces), dtype=bool), TEAL) is None


def test_from_afar_a_tile_is_its_mean_and_flat(denim):
    near, far = (colours_seen(denim.picture, denim.repeats, pixel) for pixel in (1e-5, 0.05))
    assert near.shape == (256, 256, 4) and far.shape == (1, 1, 4)
    np.testing.assert_allclose(far[0, 0], near.mean(axis=(0, 1)), atol=1e-3)
    np.testing.assert_allclose(normals_seen(denim.normals, denim.normal_repeats, 0.05)[0, 0, :2], 0.5, atol=0.02)


def test_a_picture_shows_the_weave_and_afar_the_colour(denim):
    """A flat square metre and a square centimetre of denim, as far away as fits."""
    pytest.importorskip("mitsuba", reason="needs mitsuba: pip install 'physkin[view]'")
    unevenness = {}
    for size in (1.0, 0.01):
        corners = size * np.array([[0.0, -0.5, 0.0], [0, 0.5, 0], [0, 0.5, 1], [0, -0.5, 1]])
        faces = np.array([[0, 1, 2], [0, 2, 3]])
        square = Mesh(corners, faces, TEAL, denim, corners[faces][..., 1:])
        picture = render([square], size=(96, 96), azimuth=0, elevation=0, floor=None)[20:-20, 20:-20].astype(float)
        unevenness[size] = picture.std(axis=(0, 1)).max()
        assert picture[..., 2].mean() > picture[..., 0].mean() + 20
    assert unevenness[0.01] > 20 > 6 > unevenness[1.0]


def exported(folder, fabric, name):
    """A file of a sewn tube made of a fabric, walking."""
    tube = sewn_tube(columns=16, rings=17, shrunk=0.95)
    model = random_model(np.random.default_rng(0), rig=load_body_model().rig, garment=tube)
    save_garment_model(model, folder / "tube.safetensors")
    garment = f"{folder / 'tube.safetensors'}:{fabric}"
    assert main(["export", "walk", "-g", garment, "--rate", "5", "-o", str(folder / name)]) == 0
    return folder / name


def test_gltf_has_both_pictures_in_metres(tmp_path):
    """Embedded, with the repeats of the tile and the sheen of the cloth."""
    written = exported(tmp_path, "wool:navy", "w.glb")
    content = written.read_bytes()
    (length,) = struct.unpack("<I", content[12:16])
    document = json.loads(content[20 : 20 + length])
    materials = {material["name"]: material for material in document["materials"]}
    assert materials.keys() >= {"wool", "seam", "hem"} and materials["hem"]["alphaMode"] == "BLEND"
    assert len(materials) == len(document["materials"])
    material = materials["wool"]
    scale = pytest.approx([50, 50])
    for texture in (material["pbrMetallicRoughness"]["baseColorTexture"], material["normalTexture"]):
        assert texture["extensions"]["KHR_texture_transform"]["scale"] == scale
    assert {image["name"] for image in document["images"]} >= {"wool.png", "wool_normal.png", "seam.png", "hem.png"}
    assert material["pbrMetallicRoughness"]["roughnessFactor"] == 1.0
    assert document["extensionsUsed"] == ["KHR_materials_sheen", "KHR_texture_transform"]


def test_usd_has_both_pictures_beside_it(tmp_path):
    usd = pytest.importorskip("pxr.Usd", reason="needs the extra [usd]")
    written = exported(tmp_path, "denim", "w.usdc")
    stage = usd.Stage.Open(str(written))
    prims = {prim.GetName(): prim for prim in stage.Traverse() if prim.GetPath().GetParentPath().name == "denim"}
    for name, space in (("UsdUVTexture", "sRGB"), ("UsdUVTexture_normals", "raw")):
        assert prims[name].GetAttribute("inputs:sourceColorSpace").Get() == space
        file = prims[name].GetAttribute("inputs:file").Get().path
        assert Image.open(tmp_path / file).size == (256, 256)
    assert prims["UsdPreviewSurface"].GetAttribute("inputs:normal").GetConnections()
    stitches = [prim for prim in stage.Traverse() if prim.GetName() == "thick_hem"]
    (shader,) = (prim for prim in stitches[0].GetChildren() if prim.GetName() == "UsdPreviewSurface")
    assert shader.GetAttribute("inputs:opacity").GetConnections()

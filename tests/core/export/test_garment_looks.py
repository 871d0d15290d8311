"""`physkin export --materials`: texture coordinates and materials of a mesh are in the files, and cloth stays whole."""

import io
import sys
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from core.export.gltf_reader import Reader, in_gltf_world, skinned_layers
from core.export.smooth_models import smooth_model
from PIL import Image
from random_models import random_model, sewn_tube
from scipy.spatial import cKDTree

from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_motion, save_garment_model
from physkin_core.cli import main
from physkin_core.export.export import LIES_ON, garment_looks
from physkin_core.export.usd_motion import _as_identifiers
from physkin_core.mesh.look import LIBRARY, Look
from physkin_core.mesh.mesh_file import read_mesh, write_obj
from physkin_core.mesh.surfaces import surfaces_of

RATE = 5.0
RED = (0.8, 0.05, 0.1)


@pytest.fixture(scope="module")
def shirt():
    return smooth_model("longsleeve")


@pytest.fixture(scope="module")
def export(shirt, tmp_path_factory):
    """`physkin export` of the shirt in a walk, to a file with options."""
    model = tmp_path_factory.mktemp("model") / "longsleeve.safetensors"
    save_garment_model(shirt, model)

    def run(path, *options):
        garment = ["export", "walk", "-g", str(model), "--no-separate-limbs", "--rate", f"{RATE:g}"]
        return main([*garment, *map(str, options), "-o", str(path)])

    return run


@pytest.fixture(scope="module")
def worn(shirt):
    return Outfit([shirt.for_engines()], load_avatar(BUNDLED_AVATAR, shirt.rig))


def unrolled(vertices, faces):
    """(f, 3, 2) texture coordinates: unrolled about the upright axis, cut at the back."""
    turn = (np.arctan2(vertices[:, 1], vertices[:, 0]) / (2 * np.pi))[faces]
    turn -= np.round(turn - turn[:, :1])
    return np.stack([turn, vertices[faces][..., 2]], axis=-1)


def picture(kind="PNG"):
    buffer = io.BytesIO()
    Image.new("RGB", (8, 8), "green").save(buffer, format=kind)
    return buffer.getvalue()


REPEATED = f"newmtl knit\nmap_Kd -s 20 40 1 knit.png\nnewmtl red\nKd {' '.join(map(str, RED))}\n"


def write_look(folder, model, *, library=None, files=None, vertices=None):
    """`garment.obj` of a model as fit-garment writes it: the left half is knit, with a picture, the right half red."""
    folder.mkdir(exist_ok=True)
    vertices, faces = model.garment.vertices if vertices is None else vertices, model.garment.faces
    right = (vertices[faces][..., 1].mean(axis=1) < 0).astype(int)
    text = library or f"newmtl knit\nmap_Kd knit.png\nnewmtl red\nKd {' '.join(map(str, RED))}\n"
    files = {LIBRARY: text.encode()} | ({"knit.png": picture()} if files is None else files)
    look = Look(unrolled(vertices, faces), right, np.full(len(faces), -1), ("knit", "red"), (), files)
    write_obj(folder / "garment.obj", vertices, faces, look, header="test")
    return folder / "garment.obj"


def test_gltf_has_the_look_and_no_seam_opens(tmp_path, shirt, worn, export):
    """Every vertex has the place of its point of the garment, twice at the seam, where both move alike; the picture is
    as large as its material says."""
    look = write_look(tmp_path / "look", shirt, library=REPEATED)
    assert export(tmp_path / "walk.glb", "--materials", look) == 0
    reader, motion = Reader(tmp_path / "walk.glb"), load_motion("walk").resampled(RATE)
    frame = 2
    for k in range(frame + 1):
        worn.drape(motion.positions_for(shirt.rig)[k], time=motion.times[k], root=motion.root[k])
    (cloud,) = skinned_layers(worn)
    skinned = reader.skinned("longsleeve", frame)
    distance, closest = cKDTree(in_gltf_world(cloud, motion, frame)).query(skinned)
    which = worn.layers[0].visible[closest]
    assert distance.max() < 2e-4
    assert len(cloud) + 10 < len(skinned) < 1.1 * len(cloud) and len(np.unique(which)) == len(cloud)
    rest = shirt.garment.vertices[which]
    u, v = reader.array(reader.attributes("longsleeve").TEXCOORD_0).T
    np.testing.assert_allclose(1 - v, rest[:, 2], atol=1e-5)
    turn = np.arctan2(rest[:, 1], rest[:, 0]) / (2 * np.pi)
    np.testing.assert_allclose(u - turn, np.round(u - turn), atol=1e-4)
    mesh = next(mesh for mesh in reader.file.meshes if mesh.name == "longsleeve")
    knit, red = (reader.file.materials[primitive.material] for primitive in mesh.primitives)
    counts = [len(reader.array(primitive.indices)) // 3 for primitive in mesh.primitives]
    assert sum(counts) == len(worn.layers[0].faces) and min(counts) > 0.4 * sum(counts)
    np.testing.assert_allclose(red.pbrMetallicRoughness.baseColorFactor[:3], RED)
    image = reader.file.images[reader.file.textures[knit.pbrMetallicRoughness.baseColorTexture.index].source]
    view = reader.file.bufferViews[image.bufferView]
    assert image.mimeType == "image/png"
    transform = knit.pbrMetallicRoughness.baseColorTexture.extensions["KHR_texture_transform"]
    assert transform["scale"] == [20, 40]
    back, first = read_mesh(tmp_path / "walk.glb").look, read_mesh(look).look
    scaled = back.uv[back.material == back.materials.index("knit")].reshape(-1, 2)
    wanted = (first.uv[first.material == 0] * [20, 40]).reshape(-1, 2)
    np.testing.assert_allclose(np.sort(scaled, axis=0), np.sort(wanted, axis=0), atol=1e-3)
    assert reader.binary[view.byteOffset : view.byteOffset + view.byteLength] == picture()


def test_usd_has_the_look(tmp_path, shirt, export):
    """Places by corner, materials by faces, the picture beside the file, as large as its material says."""
    pytest.importorskip("pxr", reason="needs the extra [usd]")
    from pxr import Usd, UsdGeom, UsdShade

    look = write_look(tmp_path / "look", shirt, library=REPEATED)
    assert export(tmp_path / "walk.usdc", "--materials", look) == 0
    stage = Usd.Stage.Open(str(tmp_path / "walk.usdc"))
    mesh = UsdGeom.Mesh(stage.GetPrimAtPath("/avatar/longsleeve"))
    places = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    assert places.GetInterpolation() == "faceVarying"
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    expected = unrolled(shirt.garment.vertices, faces)
    found = np.array(places.Get()).reshape(-1, 3, 2)
    np.testing.assert_allclose(found - expected, np.round(found - expected), atol=1e-4)
    subsets = UsdShade.MaterialBindingAPI(mesh).GetMaterialBindSubsets()
    assert sum(len(subset.GetIndicesAttr().Get()) for subset in subsets) == len(faces)
    files = [prim.GetAttribute("inputs:file").Get() for prim in stage.Traverse() if prim.GetName() == "UsdUVTexture"]
    assert [file.path for file in files] == ["./walk_pictures/longsleeve_knit.png"]
    assert (tmp_path / files[0].path).read_bytes() == picture()
    (scaled,) = (prim for prim in stage.Traverse() if prim.GetName() == "UsdTransform2d")
    assert tuple(scaled.GetAttribute("inputs:scale").Get()) == (20, 40)


def test_usd_names_are_unique():
    assert _as_identifiers(["a b", "a-b", "a_b_2", "a.b", "2d", ""]) == ["a_b", "a_b_2", "a_b_2_2", "a_b_3", "_2d", "_"]


@pytest.mark.parametrize("options", ["", "-s 1 1 1 ", "-o 0.5 -0.5 0 -clamp on\t", "-mm 0 1 -blendu off "])
def test_a_picture_is_found_after_any_options(tmp_path, shirt, options):
    """Under the longest name that is a file, here one with a space; a file named by its last word alone is not it."""
    library = f"newmtl knit\n  map_Kd\t{options}my knit.png\n"
    path = write_look(tmp_path / "look", shirt, library=library, files={"my knit.png": picture(), "knit.png": b"no"})
    look = read_mesh(path).look
    assert sorted(look.files) == [LIBRARY, "my knit.png"]
    knit = next(each for each in surfaces_of(look, "longsleeve", RED, len(look.material)) if each.name == "knit")
    assert knit.picture.content == picture()


@pytest.mark.parametrize(
    "library, expected",
    [
        ("newmtl knit\nmap_Kd -s 20 40 1 knit.png\n", {"repeats": (20, 40)}),
        ("newmtl knit\nmap_Kd -mm 0 1 -s 8 knit.png\n", {"repeats": (8, 1)}),
        ("newmtl knit\nmap_Kd -s -4 .5 knit.png\n", {"repeats": (-4, 0.5)}),
        ("newmtl knit\nmap_Kd knit.png\n", {"repeats": (1, 1), "colour": (1, 1, 1)}),
        ("\tnewmtl\tknit\nKd\t0.5\t0.25 0\n", {"colour": (0.5, 0.25, 0.0)}),
        ("newmtl red\nKd 1 0 0\n", {"colour": (1, 1, 1), "picture": None}),
    ],
)
def test_a_material_is_what_its_library_says(library, expected):
    """How large its picture is, its colour; words may stand after tabs; what is not named is white."""
    files = {LIBRARY: library.encode(), "knit.png": picture()}
    look = Look(np.zeros((1, 3, 2)), np.zeros(1, dtype=int), np.full(1, -1), ("knit",), (), files)
    (knit,) = surfaces_of(look, "longsleeve", RED, 1)
    assert {key: getattr(knit, key) for key in expected} == expected


def test_cloth_that_was_cut_flat_has_its_texture_places(tmp_path, worn):
    """In metres, on the faces that are given; a look of materials alone keeps them, one with places of its own not."""
    sewn = sewn_tube(columns=16, rings=17, shrunk=0.95)
    model = random_model(np.random.default_rng(0), rig=worn.rig, garment=sewn)
    outfit = Outfit([model], worn.avatar)
    (look,) = garment_looks([], outfit)
    np.testing.assert_array_equal(look.uv, sewn.panel_places[sewn.panel_faces])
    assert look.materials == ("jersey",) and garment_looks([], worn) == [None]
    material = np.zeros(len(sewn.faces), int)
    red = Look(
        np.full_like(look.uv, np.nan), material, material - 1, ("red",), (), {LIBRARY: b"newmtl red\nKd 1 0 0\n"}
    )
    for uv, kept in ((red.uv, look.uv), (0.1 * look.uv, 0.1 * look.uv)):
        write_obj(tmp_path / "red.obj", sewn.vertices, sewn.faces, replace(red, uv=uv), header="test")
        (found,) = garment_looks([tmp_path / "red.obj"], outfit)
        np.testing.assert_allclose(found.uv, kept, atol=1e-5)
        assert found.materials == ("red",)
    save_garment_model(model, tmp_path / "sewn.safetensors")
    arguments = ["export", "walk", "-g", str(tmp_path / "sewn.safetensors"), "--rate", "5"]
    assert main([*arguments, "-o", str(tmp_path / "walk.glb")]) == 0
    reader = Reader(tmp_path / "walk.glb")
    places = reader.array(reader.attributes("random").TEXCOORD_0) * [1, -1] + [0, 1]
    assert len(places) == len(sewn.panel_places)
    assert cKDTree(sewn.panel_places).query(places)[0].max() < 1e-5


LACKS_ONE = "newmtl knit\nmap_Kd nit.png\nnewmtl red\nmap_Kd red knit.png\n"


def far_off(folder, model):
    return write_look(folder, model, vertices=model.garment.vertices + [0, 0, 0.1])


def plain(folder, model):
    bare = write_look(folder, replace(model), library="", files={})
    lines = [line for line in bare.read_text().splitlines() if line[:2] in ("v ", "f ")]
    bare.write_text("\n".join(" ".join(word.split("/")[0] for word in line.split()) for line in lines))
    return bare


@pytest.mark.parametrize(
    "write, told",
    [
        (
            far_off,
            r"lies on no garment that is worn: longsleeve is the closest, \d\d mm off on average; allowed are 2 mm",
        ),
        (plain, "has neither texture coordinates nor materials"),
        (lambda *to: write_look(*to, files={}), "the picture of material 'knit' is missing: 'knit.png'"),
        (
            lambda *to: write_look(*to, files={"knit.png": b"GIF89a"}),
            "the picture of material 'knit', 'knit.png', must be",
        ),
        (
            lambda *to: write_look(*to, library=LACKS_ONE, files={"nit.png": picture()}),
            "look/garment.obj: the picture of material 'red' is missing: 'red knit.png'",
        ),
        *(
            (
                lambda *to, colour=colour: write_look(*to, library=f"newmtl red\nKd {colour}\n"),
                f"look/garment.obj: the colour Kd of material 'red' must be three numbers from 0 to 1, got '{colour}'",
            )
            for colour in ("0.5", "2 -1 0", "red", "0 nan 0")
        ),
        *(
            (
                lambda *to, scale=scale: write_look(*to, library=f"newmtl knit\nmap_Kd -s {scale} knit.png\n"),
                f"the scale -s of material 'knit' must be one to three numbers other than 0, got '{told}'",
            )
            for scale, told in (("0 1 1", "0 1 1"), ("-blendu on", ""), ("2 1e999", "2 1e999"), ("2 3x", "2 3x"))
        ),
    ],
)
def test_looks_that_cannot_be_used_are_told(tmp_path, shirt, worn, write, told):
    path = write(tmp_path / "look", shirt)
    with pytest.raises(ValueError, match=told):
        garment_looks([path], worn)


def test_a_garment_has_one_look(tmp_path, shirt, worn):
    path = write_look(tmp_path / "look", shirt, vertices=shirt.garment.vertices + [0, 0, LIES_ON / 2])
    with pytest.raises(ValueError, match="is a second mesh of materials for longsleeve"):
        garment_looks([path, path], worn)


def test_pictures_are_kept_without_pillow(tmp_path, shirt, monkeypatch, export):
    """As they are in a GLB."""
    trimesh.load(write_look(tmp_path / "look", shirt), process=False).export(tmp_path / "look.glb")
    monkeypatch.setitem(sys.modules, "PIL", None)
    monkeypatch.setitem(sys.modules, "PIL.Image", None)
    assert export(tmp_path / "walk.glb", "--materials", tmp_path / "look.glb") == 0
    assert b"\x89PNG" in (tmp_path / "walk.glb").read_bytes()

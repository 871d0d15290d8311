"""An avatar's own materials: each face keeps its own through loading, in exported files and as a colour."""

import base64
import io
import json
import re

import numpy as np
import pytest
from core.export.gltf_reader import Reader
from gltf_person import PERSON, RIG, add_part, faces_on, load_document, person_document, rig_json
from PIL import Image

from physkin_core import BUNDLED_AVATAR, load_avatar
from physkin_core.cli import main
from physkin_core.look.avatar_look import avatar_colours, avatar_look
from physkin_core.mesh.look import LIBRARY, Look, few_colours
from physkin_core.mesh.mesh_file import write_obj
from physkin_core.view.scene.heat_map import MOST_COLOURS, own_bands

pytestmark = pytest.mark.filterwarnings("ignore:.*taken")

BLUE = (0.05, 0.1, 0.8)
LEFT, RIGHT = (200, 30, 20), (20, 160, 40)


def picture(kind="PNG"):
    """Red on the left, green on the right."""
    image, buffer = Image.new("RGB", (64, 16), RIGHT), io.BytesIO()
    image.paste(LEFT, (0, 0, 32, 16))
    image.save(buffer, format=kind, quality=95)
    return buffer.getvalue()


def places(vertices):
    """(..., 2) texture coordinates of vertices in the root frame: their left half is in the picture's left one."""
    return np.stack([0.5 - 0.8 * vertices[..., 1], 0.3 * vertices[..., 2] + 0.5], axis=-1)


def textured(*, content=None, image=None, legs=True, inside_out=False, textures=None, transform=None):
    """The person as a file cut at every edge: skin with a picture, legs in one colour, hair."""
    faces = PERSON.faces[:, ::-1] if inside_out else PERSON.faces
    corners = faces.reshape(-1)
    alone = np.arange(len(corners)).reshape(-1, 3)
    builder = person_document(
        vertices=PERSON.vertices[corners],
        faces=alone,
        influence_joints=PERSON.influence_bones[corners],
        influence_weights=PERSON.influence_weights[corners],
    )
    document, mesh = builder.document, builder.document["meshes"][0]
    uv = places(PERSON.vertices[corners]) * [1, -1] + [0, 1]
    mesh["primitives"][0]["attributes"]["TEXCOORD_0"] = builder.add_accessor(uv.astype(np.float32))
    is_leg = legs & (PERSON.vertices[faces][..., 2].mean(axis=1) < -0.3)

    def primitive(chosen, material):
        indices = builder.add_accessor(alone[chosen].astype(np.uint32).reshape(-1))
        return {**mesh["primitives"][0], "indices": indices, "material": material}

    hair = PERSON.vertices[faces][..., 2].mean(axis=1) > 0.6
    given = [(hair, 2), (~is_leg, 0), *([(is_leg, 1)] if legs else [])]
    mesh["primitives"] = [primitive(*each) for each in given]
    shading = {"baseColorTexture": {"index": 0} | ({"extensions": transform} if transform else {})}
    document["materials"] = [
        {"name": "body skin", "pbrMetallicRoughness": shading},
        {"name": "body skin", "pbrMetallicRoughness": {"baseColorFactor": [*BLUE, 1.0]}},
        {"name": "hair", "pbrMetallicRoughness": {"baseColorFactor": [0, 0, 0, 1]}},
    ]
    content = picture() if content is None else content
    view = builder.add_view(np.frombuffer(content, dtype=np.uint8))
    document["images"] = [image or {"bufferView": view, "mimeType": "image/png"}]
    document["textures"] = [{"source": 0}] if textures is None else textures
    return builder


def expected(avatar):
    """(f, 3) sRGB of the faces of the person, by where they are in the file; and the faces that are on one side."""
    centre = avatar.file_vertices[avatar.faces].mean(axis=1)  # glTF: x left, y up
    colours = np.where(centre[:, :1] > 0, LEFT, RIGHT) / 255
    leg = centre[:, 1] < -0.3
    colours[leg] = np.array(BLUE) ** (1 / 2.2)
    return colours, leg | (np.abs(centre[:, 0]) > 0.03)


@pytest.mark.parametrize("inside_out", [False, True])
def test_each_face_keeps_its_place_and_material(tmp_path, inside_out):
    """Through welding, hair left out before it and faces that are turned over."""
    avatar = load_document(tmp_path, textured(inside_out=inside_out))
    assert len(avatar.vertices) < len(PERSON.vertices) + 10 and len(avatar.faces) == len(PERSON.faces)
    look = avatar_look(avatar)
    x, y, _ = np.moveaxis(avatar.file_vertices[avatar.faces], 2, 0)
    skin = look.material == 0
    np.testing.assert_allclose(look.uv[skin], np.stack([0.5 - 0.8 * x, 0.3 * y + 0.5], axis=-1)[skin], atol=1e-5)
    assert sorted(look.materials) == ["body_skin", "body_skin_1", "hair"]
    colours, clear = expected(avatar)
    np.testing.assert_allclose(avatar_colours(avatar)[clear], colours[clear], atol=0.02)
    half = np.arange(len(avatar.faces)) % 2 == 0
    np.testing.assert_array_equal(avatar_look(avatar, half).uv, look.uv[half])
    bands, index = own_bands(avatar_colours(avatar), half)
    assert len(bands.colours) <= MOST_COLOURS
    drawn = np.array(bands.colours)[bands.band(index)]
    np.testing.assert_allclose(drawn[clear[half]], colours[half][clear[half]], atol=0.02)


def test_pictures_are_read_wherever_they_are(tmp_path):
    """In a data URI, beside the file, as WebP; and places may be scaled and shifted."""
    scaled = {"KHR_texture_transform": {"scale": [0.5, 1], "offset": [0.5, 0]}}
    webp = [{"extensions": {"EXT_texture_webp": {"source": 0}}}]
    inline = {"uri": "data:image/png;base64," + base64.b64encode(picture()).decode()}
    (tmp_path / "my skin.jpg").write_bytes(picture("JPEG"))
    for number, arguments in enumerate(
        (
            {"image": inline},
            {"image": {"uri": "my%20skin.jpg"}},
            {"content": picture("WEBP"), "textures": webp},
            {"transform": scaled},
        )
    ):
        avatar = load_document(tmp_path, textured(legs=False, **arguments), name=f"{number}.glb")
        left = avatar.file_vertices[avatar.faces].mean(axis=1)[:, 0] > 0.03
        found = avatar_colours(avatar)[left]
        wanted = RIGHT if "transform" in arguments else LEFT
        np.testing.assert_allclose(found, np.tile(np.array(wanted) / 255, (len(found), 1)), atol=0.04)


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ({"content": b"\xabKTX 20\xbb"}, "neither PNG nor JPEG, nor WebP"),
        ({"image": {"uri": "../skin.png"}}, "it names '../skin.png', outside the folder"),
        ({"image": {"uri": "gone.png"}}, "it names 'gone.png', which does not exist"),
        ({"image": {"uri": "https://example.org/skin.png"}}, "image 0 is at 'https://example.org/skin.png'"),
        ({"image": {"bufferView": 99}}, r"it names bufferViews\[99\]"),
    ],
)
def test_a_picture_that_cannot_be_read_is_told(tmp_path, caplog, arguments, told):
    """The avatar's colours stay."""
    avatar = load_document(tmp_path, textured(**arguments))
    look = avatar_look(avatar)
    assert re.search(f"material 'body_skin' is shown without its picture: .*{told}", caplog.text)
    assert "body_skin" in look.materials and sorted(look.files) == [LIBRARY]


def test_materials_that_cannot_be_read_are_told(tmp_path, caplog):
    """Draping goes on, in one colour."""
    avatar = load_document(tmp_path, textured(textures=[]))
    assert avatar_look(avatar) is None
    assert "materials cannot be read: avatar" in caplog.text
    (tmp_path / "person.glb").unlink()
    assert avatar_look(avatar) is None
    assert "no such file" in caplog.text


@pytest.mark.parametrize("harm", ["truncated", "broken chunk"])
def test_a_damaged_picture_is_told(tmp_path, caplog, harm):
    content, length = bytearray(picture()), picture().index(b"IDAT") - 1
    if harm == "truncated":
        del content[60:]
    else:
        content[length] //= 2  # pillow finds no next chunk there, which is a SyntaxError
    avatar = load_document(tmp_path, textured(content=bytes(content)))
    colours = avatar_colours(avatar)
    assert "picture body_skin.png is left out" in caplog.text
    assert (colours.max(axis=1) > 0.99).any() and np.isfinite(colours).all()


def test_bodies_without_materials_have_no_look(tmp_path):
    avatar = load_avatar(BUNDLED_AVATAR, RIG)
    assert avatar_look(avatar) is None and avatar_colours(avatar) is None and own_bands(None) == (None, None)
    assert avatar_look(PERSON) is None


def obj(folder, library):
    """The person as an OBJ in one material, `skin`."""
    count = len(PERSON.faces)
    places_of = places(PERSON.vertices[PERSON.faces]), np.zeros(count, dtype=int), np.full(count, -1)
    write_obj(folder / "me.obj", PERSON.vertices, PERSON.faces, Look(*places_of, ("skin",), (), library), header="test")
    (folder / "me.rig.json").write_text(json.dumps(rig_json(PERSON.bone_heads, PERSON.bone_tails)))
    return load_avatar(folder / "me.obj", RIG)


def test_an_obj_has_its_own_materials(tmp_path):
    avatar = obj(tmp_path, {LIBRARY: b"newmtl skin\nmap_Kd skin.png\n", "skin.png": picture()})
    centre = avatar.file_vertices[avatar.faces].mean(axis=1)
    clear = np.abs(centre[:, 1]) > 0.03
    wanted = np.where(centre[:, 1:2] > 0, LEFT, RIGHT) / 255
    np.testing.assert_allclose(avatar_colours(avatar)[clear], wanted[clear], atol=0.02)


@pytest.mark.parametrize(
    ("line", "told"),
    [
        ("map_Kd gone.png", "the picture of material 'skin' is missing: 'gone.png'"),
        ("map_Kd skin.tga", "'skin', 'skin.tga', must be PNG or JPEG"),
        ("Kd 1.5 1 1", "must be three numbers from 0 to 1, got '1.5 1 1'"),
    ],
)
def test_what_an_obj_says_that_cannot_be_read_is_told(tmp_path, caplog, line, told):
    """And the rest of its materials stays."""
    blue = " ".join(map(str, BLUE))
    avatar = obj(tmp_path, {LIBRARY: f"newmtl skin\nKd {blue}\n{line}\n".encode(), "skin.tga": b"\0\0\2"})
    np.testing.assert_allclose(avatar_colours(avatar), np.tile(np.array(BLUE) ** (1 / 2.2), (len(avatar.faces), 1)))
    assert told in caplog.text and caplog.text.count("left out of its materials") == 1


def painted(builder, colours, *, material=None):
    """The person with colours (V, 3 or 4) of vertices, float or bytes."""
    primitive = builder.document["meshes"][0]["primitives"][0]
    bytewise = colours.dtype == np.uint8
    primitive["attributes"]["COLOR_0"] = builder.add_accessor(colours, normalized=bytewise)
    if material is not None:
        builder.document["materials"] = [material]
        primitive["material"] = 0
    return builder


@pytest.mark.parametrize("kind", [np.float32, np.uint8])
def test_colours_of_vertices(tmp_path, kind):
    """Each half of the person has its own, times the material's; a face on the seam has the mean of its corners."""
    left = PERSON.vertices[:, 1] > 0
    colours = np.where(left[:, None], [1.0, 0.2, 0.0, 1.0], [0.0, 0.4, 1.0, 1.0])
    colours = (255 * colours).astype(np.uint8) if kind == np.uint8 else colours.astype(np.float32)
    material = {"name": "skin", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1.0]}}
    avatar = load_document(tmp_path, painted(person_document(), colours, material=material))
    found = avatar_colours(avatar)
    across = avatar.vertices[avatar.faces, 1].mean(axis=1)
    for side, colour in ((across > 0.05, (0.5, 0.1, 0.0)), (across < -0.05, (0.0, 0.2, 0.5))):
        np.testing.assert_allclose(found[side], np.tile(np.array(colour) ** (1 / 2.2), (side.sum(), 1)), atol=0.01)
    assert len(avatar_look(avatar).materials) <= 8


def test_many_colours_of_vertices_are_few_materials(tmp_path):
    colours = np.random.default_rng(0).uniform(size=(len(PERSON.vertices), 3)).astype(np.float32)
    look = avatar_look(load_document(tmp_path, painted(person_document(), colours)))
    assert len(look.materials) == len(np.unique(look.material)) == 32


def test_white_vertices_leave_the_material_as_it_is(tmp_path):
    white = np.ones((len(PERSON.vertices), 3), dtype=np.float32)
    avatar = load_document(tmp_path, painted(person_document(), white, material={"name": "skin"}))
    assert avatar_look(avatar).materials == ("skin",)


def test_few_colours_stand_for_many():
    """Exact where there are few; else each is the closest there is."""
    colours = np.array([[0.1, 0.2, 0.3], [0.9, 0.8, 0.7], [0.1, 0.2, 0.3]])
    palette, index = few_colours(colours, 5)
    np.testing.assert_array_equal(palette[index], colours)
    shades = np.random.default_rng(0).uniform(size=(500, 3))
    palette, index = few_colours(shades, 8)
    distance = np.linalg.norm(shades[:, None] - palette, axis=2)
    assert len(palette) == 8 and (distance.argmin(axis=1) == index).mean() > 0.95


def test_exported_files_have_the_avatars_own_look(tmp_path):
    """The picture as it was, the places of the vertices, and colours; in USD the same."""
    load_document(tmp_path, textured())
    arguments = ["export", "walk", "--avatar", str(tmp_path / "person.glb"), "-g", "skirt", "--rate", "2", "-o"]
    assert main([*arguments, str(tmp_path / "walk.glb")]) == 0
    reader = Reader(tmp_path / "walk.glb")
    body = next(mesh for mesh in reader.file.meshes if mesh.name == "body")
    hair, skin, legs = (reader.file.materials[primitive.material] for primitive in body.primitives)
    np.testing.assert_array_equal(hair.pbrMetallicRoughness.baseColorFactor[:3], [0, 0, 0])
    np.testing.assert_allclose(legs.pbrMetallicRoughness.baseColorFactor[:3], BLUE)
    image = reader.file.images[reader.file.textures[skin.pbrMetallicRoughness.baseColorTexture.index].source]
    view = reader.file.bufferViews[image.bufferView]
    assert reader.binary[view.byteOffset : view.byteOffset + view.byteLength] == picture()
    u, v = reader.array(reader.attributes("body").TEXCOORD_0).T
    height = reader.array(reader.attributes("body").POSITION)[:, 1]
    assert np.corrcoef(1 - v, height)[0, 1] > 0.99  # posed otherwise than in the file
    pytest.importorskip("pxr", reason="needs the extra [usd]")
    from pxr import Usd

    assert main([*arguments, str(tmp_path / "walk.usdc")]) == 0
    stage = Usd.Stage.Open(str(tmp_path / "walk.usdc"))
    shaders = [prim for prim in stage.Traverse() if prim.GetName() == "UsdUVTexture"]
    files = [each.GetAttribute("inputs:file").Get().path for each in shaders if "skin" in str(each.GetPath())]
    assert [(tmp_path / file).read_bytes() for file in files] == [picture()]


def half_clear(length=None):
    """Brown on the left, clear on the right; the first `length` bytes of the file."""
    image, buffer = Image.new("RGBA", (64, 16), (*RIGHT, 0)), io.BytesIO()
    image.paste((90, 60, 30, 255), (0, 0, 32, 16))
    image.save(buffer, format="PNG")
    return buffer.getvalue()[:length]


def with_eyes(content, mode):
    """The person with a sheet before the face that has a picture, as `places` has it, and what faces are on it."""
    builder, head = person_document(), faces_on("head")
    view = builder.add_view(np.frombuffer(content, dtype=np.uint8))
    builder.document["images"] = [{"bufferView": view, "mimeType": "image/png"}]
    builder.document["textures"] = [{"source": 0}]
    iris = {"alphaMode": mode, "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}
    add_part(builder, "N00_000_00_EyeIris_00_EYE", head, offset=0.002, material=iris)
    uv = (places(PERSON.vertices) * [1, -1] + [0, 1]).astype(np.float32)
    builder.document["meshes"][-1]["primitives"][0]["attributes"]["TEXCOORD_0"] = builder.add_accessor(uv)
    return builder, head


@pytest.mark.parametrize("mode", ["BLEND", "MASK"])
def test_irises_are_shown_where_they_are_not_clear(tmp_path, mode):
    """A sheet that is clear on one side is shown on the other; a lens that is clear all over is left out."""
    builder, head = with_eyes(half_clear(), mode)
    lens = {"name": "lens", "alphaMode": mode, "pbrMetallicRoughness": {"baseColorFactor": [1, 1, 1, 0.2]}}
    add_part(builder, "Glasses", head, offset=0.02, material=lens)
    avatar = load_document(tmp_path, builder)
    shown, left = avatar.accessories, PERSON.vertices[head][..., 1].mean(axis=1) > 0
    assert abs(len(shown.faces) - left.sum()) < 0.1 * len(head)
    assert (shown.vertices[shown.faces][..., 1].mean(axis=1) > -0.005).mean() > 0.97
    brown = np.isclose(avatar_colours(shown), np.array((90, 60, 30)) / 255, atol=0.05).all(axis=1)
    assert brown.mean() > 0.9 and "left out: 'Glasses/lens'" in avatar.warnings[0]


@pytest.mark.parametrize(("content", "mode"), [(half_clear(40), "BLEND"), (half_clear(), "OPAQUE")])
def test_what_cannot_be_read_or_is_opaque_is_shown(tmp_path, content, mode):
    """A damaged picture hides no eyes and hinders nobody from draping."""
    builder, head = with_eyes(content, mode)
    assert len(load_document(tmp_path, builder).accessories.faces) == len(head)

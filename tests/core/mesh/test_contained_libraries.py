"""Material libraries and pictures of an OBJ are read from its folder alone."""

from __future__ import annotations

import logging

import numpy as np
import pytest

from physkin_core.formats.gltf_builder import GltfBuilder, write_glb
from physkin_core.mesh.mesh_file import read_mesh
from physkin_core.model.garment import GarmentError

SHAPE = "usemtl red\nv 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n"


@pytest.fixture
def folder(tmp_path):
    """A folder with a garment, and a secret beside it."""
    (tmp_path / "secret.mtl").write_text("newmtl red\nKd 1 0 0\n")
    (tmp_path / "secret.png").write_bytes(b"\x89PNG secret")
    (tmp_path / "garment" / "maps").mkdir(parents=True)
    (tmp_path / "garment" / "maps" / "own cloth.png").write_bytes(b"\x89PNG own")
    return tmp_path / "garment"


def _read(folder, library=None, name="own.mtl"):
    if library is not None:
        (folder / "own.mtl").write_text(library)
    (folder / "own.obj").write_text(f"mtllib {name}\n{SHAPE}")
    return read_mesh(folder / "own.obj")


@pytest.mark.parametrize(
    "name", ["../secret.mtl", "../../../../../../../../../../etc/passwd", "linked.mtl", "/etc/passwd"]
)
def test_libraries_are_in_the_folder(folder, name):
    (folder / "linked.mtl").symlink_to(folder.parent / "secret.mtl")
    with pytest.raises(GarmentError, match="own.obj: it names .*, outside the folder that it is in"):
        _read(folder, name=name)


@pytest.mark.parametrize("name", ["../secret.png", "linked.png", "-s 1 1 1 ../secret.png"])
def test_pictures_are_in_the_folder(folder, name):
    (folder / "linked.png").symlink_to(folder.parent / "secret.png")
    with pytest.raises(GarmentError, match="it names .*, outside the folder that it is in"):
        _read(folder, f"newmtl red\nmap_Kd {name}\n")


def test_what_is_there_is_kept(folder):
    """A picture below the folder, after options; what is missing, and names that no file can have, are left out."""
    endless = "a " * 100_000
    look = _read(folder, f"newmtl red\nmap_Kd -s 1 1 1 maps/own cloth.png\nmap_Ka gone.png\nbump {endless}\n").look
    assert look.files["own cloth.png"] == b"\x89PNG own" and len(look.files) == 2
    assert _read(folder, name="gone.mtl").look.files == {}
    assert _read(folder, name="a" * 100_000).look.files == {}


def test_a_picture_of_a_glb_is_never_decoded(folder, caplog):
    """A bomb of pixels stays a file; one that must be made a PNG is left out."""
    builder = GltfBuilder({})
    position = builder.add_accessor(np.eye(3, dtype=np.float32))
    place = builder.add_accessor(np.eye(3, 2, dtype=np.float32))
    bomb = b"\x89PNG\r\n\x1a\n" + b"\0\0\0\rIHDR" + b"\x7f\xff\xff\xff" * 2
    builder.document |= {
        "images": [{"bufferView": builder.add_view(np.frombuffer(bomb, np.uint8))}],
        "textures": [{"source": 0}],
        "materials": [{"name": "red", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}}}],
        "nodes": [{"mesh": 0}],
    }
    primitive = {"attributes": {"POSITION": position, "TEXCOORD_0": place}, "material": 0}
    builder.document["meshes"] = [{"primitives": [primitive]}]
    write_glb(folder / "own.glb", builder)
    assert read_mesh(folder / "own.glb").look.files["red.png"] == bomb
    builder.document["images"] = [{"bufferView": builder.add_view(np.frombuffer(b"GIF89a" + b"\xff" * 100, np.uint8))}]
    write_glb(folder / "own.glb", builder)
    with caplog.at_level(logging.WARNING):
        assert "red.png" not in read_mesh(folder / "own.glb").look.files
    assert "material 'red' is shown without its picture" in caplog.text

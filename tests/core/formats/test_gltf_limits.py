"""glTF files that would take memory or time out of all proportion are refused before they do."""

from __future__ import annotations

import json
import struct
import sys
import tracemalloc
from types import SimpleNamespace

import numpy as np
import pytest
from gltf_person import PERSON, RIG, load_document, person_document, primitive_of, write_gltf

from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.loading import load_avatar
from physkin_core.export.gltf_builder import write_glb
from physkin_core.formats import gltf_compression, gltf_file, mesh_limits
from physkin_core.formats.gltf_file import GltfFile
from physkin_core.mesh.mesh_file import read_mesh
from physkin_core.model.garment import GarmentError
from physkin_core.points.point_files import PointFileError, read_points

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, tested with plain meshes


def _refused(tmp_path, builder, message, *, most=60e6):
    """Refused with a message, and in memory of `most` bytes."""
    write_glb(tmp_path / "person.glb", builder)
    tracemalloc.start()
    try:
        with pytest.raises(AvatarError, match=message) as told:
            load_avatar(tmp_path / "person.glb", RIG)
        assert tracemalloc.get_traced_memory()[1] < most
    finally:
        tracemalloc.stop()
    assert len(str(told.value)) <= 300


def _bytes(builder, size):
    """A view of so many zeros."""
    return builder.add_view(np.zeros(size, np.uint8))


def _accessor(builder, **entries):
    accessor = {"componentType": 5126, "count": 3, "type": "VEC3", **entries}
    builder.document["accessors"].append(accessor)
    return len(builder.document["accessors"]) - 1


def test_elements_do_not_overlap(tmp_path):
    """A stride of one byte would make 64 bytes of each."""
    builder = person_document()
    view = _bytes(builder, 1 << 20)
    builder.document["bufferViews"][view]["byteStride"] = 1
    accessor = _accessor(builder, bufferView=view, count=(1 << 20) - 64, type="MAT4")
    primitive_of(builder)["attributes"]["POSITION"] = accessor
    _refused(tmp_path, builder, r"bufferViews\[5\] has a stride of 1 bytes, accessors\[5\] needs 64 or more")


def test_one_budget_for_all_buffers(tmp_path):
    """Twelve times the same file of holes, 6 GB."""
    builder = person_document()
    with open(tmp_path / "holes.bin", "wb") as file:
        file.truncate(1 << 29)
    (tmp_path / "person.bin").write_bytes(builder.binary)
    write_gltf(tmp_path / "person.gltf", builder, buffer_uri="person.bin")
    document = json.loads((tmp_path / "person.gltf").read_text())
    document["buffers"] += 12 * [{"uri": "holes.bin", "byteLength": 1 << 29}]
    (tmp_path / "person.gltf").write_text(json.dumps(document))
    with pytest.raises(AvatarError, match="'holes.bin' has 536870912 bytes, allowed are"):
        load_avatar(tmp_path / "person.gltf", RIG)


@pytest.mark.parametrize("repeated", ["nodes", "primitives", "accessors"])
def test_one_budget_for_what_a_scene_expands_to(tmp_path, monkeypatch, repeated):
    """A mesh that is drawn a thousand times, by nodes or by primitives; and the bytes of its accessors."""
    builder = person_document()
    nodes, mesh = builder.document["nodes"], builder.document["meshes"][0]
    drawn = next(node for node in nodes if "mesh" in node)
    if repeated == "nodes":
        builder.document["scenes"][0]["nodes"] += range(len(nodes), len(nodes) + 1000)
        nodes += 1000 * [{key: drawn[key] for key in ("mesh", "skin")}]
    else:
        mesh["primitives"] *= 1000
    message = r"it has 54872 vertices or more, allowed are 50000"
    monkeypatch.setattr(mesh_limits, "MOST_VERTICES", 50_000)
    if repeated == "accessors":
        monkeypatch.setattr(mesh_limits, "MOST_VERTICES", 10**9)
        monkeypatch.setattr(gltf_file, "LARGEST_CONTENT", 10_000_000)
        message = r"accessors\[[0-9]\] takes [0-9]+ bytes after [0-9]+, allowed are 10000000 for all of the file"
    _refused(tmp_path, builder, message)


def _meshopt_view(builder, rows, **said):
    """A compressed view of a fallback buffer."""
    meshopt = pytest.importorskip("meshopt")
    data = meshopt.encode_gltf_buffer(rows, "ATTRIBUTES")
    start, document = len(builder.binary), builder.document
    builder.binary += data
    document["buffers"][0]["byteLength"] = len(builder.binary)
    if len(document["buffers"]) == 1:
        document["buffers"].append({"byteLength": 0, "extensions": {"EXT_meshopt_compression": {"fallback": True}}})
    extension = {"buffer": 0, "byteOffset": start, "byteLength": len(data), "byteStride": rows.shape[1]}
    extension |= {"count": len(rows), "mode": "ATTRIBUTES", **said}
    view = {"buffer": 1, "byteLength": rows.size, "extensions": {"EXT_meshopt_compression": extension}}
    document["bufferViews"].append(view)
    return len(document["bufferViews"]) - 1


def test_decompressed_views_are_in_the_budget(tmp_path, monkeypatch):
    """Many views of few bytes."""
    monkeypatch.setattr(gltf_file, "LARGEST_CONTENT", 10_000_000)
    builder = person_document()
    views = [_meshopt_view(builder, np.zeros((1 << 18, 16), np.uint8)) for _ in range(4)]
    accessors = [_accessor(builder, bufferView=view) for view in views]
    builder.document["meshes"][0]["primitives"] = [{"attributes": {"POSITION": each}} for each in accessors]
    del builder.document["skins"]
    _refused(tmp_path, builder, "a compressed buffer view takes 4194304 bytes after [0-9]+, allowed are 10000000")


def test_a_compressed_view_is_compared_with_what_uses_it(tmp_path, monkeypatch):
    """Before it is decoded: its own length, and that of what reads it."""
    monkeypatch.setattr(gltf_compression, "_binding", lambda *names: SimpleNamespace())  # has nothing to decode with
    builder = person_document()
    view = _meshopt_view(builder, np.zeros((1 << 12, 16), np.uint8), count=1 << 26)
    primitive_of(builder)["attributes"]["POSITION"] = _accessor(builder, bufferView=view)
    _refused(tmp_path, builder, "a compressed buffer view of 67108864 times 16 bytes is at .* 65536 when decoded")
    builder = person_document()
    view = _meshopt_view(builder, np.zeros((1 << 12, 16), np.uint8))
    accessor = _accessor(builder, bufferView=view, count=10_000)
    primitive_of(builder)["attributes"]["POSITION"] = accessor
    _refused(tmp_path, builder, r"accessors\[5\] of 10000 elements needs 120000 bytes of bufferViews\[5\]")


def _draco(header):
    """A person whose primitive is compressed, so its header says."""
    builder = person_document()
    view = builder.add_view(np.frombuffer(header + bytes(100), np.uint8))
    attributes = {name: number for number, name in enumerate(primitive_of(builder)["attributes"])}
    extension = {"bufferView": view, "attributes": attributes}
    primitive_of(builder)["extensions"] = {gltf_compression.DRACO: extension}
    return builder


def _varint(value):
    """In groups of seven bits, the lowest first."""
    groups = [value >> shift & 0x7F for shift in range(0, max(1, value.bit_length()), 7)]
    return bytes([*(group | 0x80 for group in groups[:-1]), groups[-1]])


VERTICES, FACES = len(PERSON.vertices), len(PERSON.faces)
EDGEBREAKER, SEQUENTIAL = b"DRACO\2\2\1\1\0\0\0", b"DRACO\2\2\1\0\0\0"
GOOD = _varint(VERTICES) + _varint(FACES)


@pytest.mark.parametrize(
    ("header", "message"),
    [
        (EDGEBREAKER + _varint(2**31) + _varint(FACES), f"has 2147483648 vertices .* {VERTICES} and {FACES}; these"),
        (EDGEBREAKER + _varint(VERTICES) + _varint(2**31), "and 2147483648 faces, its accessors"),
        (SEQUENTIAL + _varint(FACES) + _varint(VERTICES - 1), "these must agree"),
        (EDGEBREAKER + b"\xff" * 100, "its header ends early"),
        (b"DRACO\1\1" + EDGEBREAKER[7:] + GOOD, "begins with 445241434f0101"),
        (b"DRACO\2\2\0" + EDGEBREAKER[8:] + GOOD, "it must be a triangle mesh"),
        (b"DRACO\2\2\1\1\0\x80\0" + GOOD, "without metadata"),
        (b"DRACO\2\2\1\7\0\0\0" + GOOD, "has encoding 7, allowed are 0 and 1"),
    ],
)
def test_draco_headers_are_compared_before_decoding(tmp_path, monkeypatch, header, message):
    monkeypatch.setitem(sys.modules, "DracoPy", SimpleNamespace())  # has nothing to decode with
    _refused(tmp_path, _draco(header), message)
    for good in (EDGEBREAKER + GOOD, SEQUENTIAL + _varint(FACES) + _varint(VERTICES)):
        _refused(tmp_path, _draco(good), "KHR_draco_mesh_compression is malformed: .*has no attribute 'decode'")


def _many_nodes(builder):
    builder.document["nodes"] += 20_000 * [{}]


def _deep_nodes(builder):
    first = len(builder.document["nodes"])
    builder.document["nodes"] += [{"children": [first + k + 1]} for k in range(1_100)] + [{}]


def _many_bones(builder):
    first = len(builder.document["nodes"])
    builder.document["nodes"] += [{"name": "b" * 1000} for _ in range(2_100)]
    builder.document["skins"][0]["joints"] += range(first, first + 2_100)


def _many_influences(builder):
    attributes = primitive_of(builder)["attributes"]
    for number in range(1, 5):
        attributes |= {f"{what}_{number}": attributes[f"{what}_0"] for what in ("JOINTS", "WEIGHTS")}


def _sparse_beyond(builder):
    view = builder.add_view(np.array([99_999], np.uint32))
    accessor = builder.document["accessors"][primitive_of(builder)["attributes"]["POSITION"]]
    at = {"bufferView": view, "componentType": 5125}
    accessor["sparse"] = {"count": 1, "indices": at, "values": {"bufferView": accessor["bufferView"]}}


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_many_nodes, r"it has 20[0-9]+ nodes, allowed are 16384"),
        (_deep_nodes, r"its nodes are 1100 levels deep, allowed are 1024"),
        (_many_bones, r"its skeleton has 21[0-9]+ bones, allowed are 2048"),
        (_many_influences, r"a vertex has 20 skinning weights, allowed are 16"),
        (_sparse_beyond, r"accessors\[0\].sparse replaces element 99999, allowed are 0 to 13717"),
        (lambda builder: builder.document.update(nodes={}), r"nodes is \{\}, it must be a list"),
        (lambda builder: builder.document["nodes"][0].update(name=7), r"nodes\[0\].name is 7, it must be a text"),
        (lambda builder: primitive_of(builder).update(mode=True), r"primitives\[0\].mode is True, it must be a whole"),
        (lambda builder: primitive_of(builder).update(indices=10**400), r"indices is an integer of 1329 bits"),
        (lambda builder: builder.document["skins"][0].update(joints=[]), r"joints of skins\[0\] are \[\], allowed are"),
        (lambda builder: builder.document["accessors"][0].update(type="VEC9"), "it must be one of SCALAR, VEC2"),
    ],
)
def test_counts_and_kinds_are_checked(tmp_path, damage, message):
    builder = person_document()
    damage(builder)
    _refused(tmp_path, builder, message)


def test_deep_and_endless_documents(tmp_path):
    """Lists in lists end no interpreter; a text of four million empty ones is not parsed."""
    for text, message in (
        ('{"a":' * 200_000, "nested too deeply"),
        ("{" + '"nodes":[' + "[]," * 2_000_001, "JSON items"),
    ):
        (tmp_path / "deep.gltf").write_text(text)
        with pytest.raises(AvatarError, match=message):
            load_avatar(tmp_path / "deep.gltf", RIG)


def test_names_are_shown_short_and_escaped(tmp_path):
    """In errors and in warnings."""
    builder = person_document()
    mesh = next(node for node in builder.document["nodes"] if "mesh" in node)
    mesh["name"] = "\x1b[2J\n" + "a" * 100_000
    primitive_of(builder)["attributes"].pop("JOINTS_0")
    with pytest.raises(AvatarError, match=r"mesh '\\x1b\[2J\\naaa[a.]*' has a skin but no JOINTS_0") as told:
        load_document(tmp_path, builder)
    assert str(told.value).isprintable() and len(str(told.value)) <= 300


def test_chunks_of_a_glb(tmp_path):
    """The first must be JSON, and none may end beyond the file."""
    for chunk, message in (
        (struct.pack("<I4s", 4, b"BIN\0") + bytes(4), r"its first chunk is b'BIN\\x00', it must be b'JSON'"),
        (struct.pack("<I4s", 2**31, b"JSON"), "truncated: its chunk b'JSON' ends at byte 2147483668 of 20"),
        (b"", "its first chunk is None"),
    ):
        (tmp_path / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk)
        with pytest.raises(AvatarError, match=message):
            load_avatar(tmp_path / "a.glb", RIG)


def test_garments_and_points_have_the_same_limits(tmp_path):
    """And the same reader's sentences."""
    builder = person_document()
    view = _bytes(builder, 1 << 20)
    builder.document["bufferViews"][view]["byteStride"] = 1
    accessor = _accessor(builder, bufferView=view, count=(1 << 20) - 64, type="MAT4")
    write_glb(tmp_path / "unused.glb", builder)
    with pytest.raises(PointFileError, match=r"points file .*unused.glb: bufferViews\[5\] has a stride of 1 bytes"):
        read_points(tmp_path / "unused.glb")  # which is read by others as well, so whole
    primitive_of(builder)["attributes"]["POSITION"] = accessor
    write_glb(tmp_path / "used.glb", builder)
    with pytest.raises(GarmentError, match=r"garment .*used.glb: bufferViews\[5\] has a stride of 1 bytes"):
        read_mesh(tmp_path / "used.glb")


def test_large_documents_are_quick(tmp_path):
    """Linear time for names and accessors that nobody uses."""
    builder = person_document()
    builder.document["nodes"] += [{"name": f"n{k}"} for k in range(16_000)]
    builder.document["accessors"] += 60_000 * [{"componentType": 5126, "count": 3, "type": "VEC3"}]
    write_glb(tmp_path / "large.glb", builder)
    assert len(GltfFile(tmp_path / "large.glb").nodes) > 16_000

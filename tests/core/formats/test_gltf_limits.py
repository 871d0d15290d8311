"""glTF files that say more than they hold, or something else than what is meant, are refused before memory is taken."""

from __future__ import annotations

import struct
import tracemalloc

import numpy as np
import pytest
from gltf_person import RIG, load_document, person_document, primitive_of

from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.loading import load_avatar
from physkin_core.export.gltf_builder import write_glb
from physkin_core.formats.gltf_file import GltfFile

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
        (b"", "its first chunk is b''"),
    ):
        (tmp_path / "a.glb").write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunk)) + chunk)
        with pytest.raises(AvatarError, match=message):
            load_avatar(tmp_path / "a.glb", RIG)


def test_deep_documents(tmp_path):
    """Lists in lists end no interpreter."""
    (tmp_path / "deep.gltf").write_text('{"a":' * 200_000)
    with pytest.raises(AvatarError, match="nested too deeply"):
        load_avatar(tmp_path / "deep.gltf", RIG)


def test_large_documents_are_quick(tmp_path):
    """Linear time for names and accessors that nobody uses."""
    builder = person_document()
    builder.document["nodes"] += [{"name": f"n{k}"} for k in range(16_000)]
    builder.document["accessors"] += 60_000 * [{"componentType": 5126, "count": 3, "type": "VEC3"}]
    write_glb(tmp_path / "large.glb", builder)
    assert len(GltfFile(tmp_path / "large.glb").nodes) > 16_000

"""Damaged GLB and glTF files are refused, and the error names what is wrong."""

import re
import struct
import tracemalloc

import numpy as np
import pytest
from gltf_person import PERSON, RIG, load_document, person_document, primitive_of

from physkin_core.avatar.avatar import AvatarError
from physkin_core.avatar.loading import load_avatar
from physkin_core.formats.gltf_builder import write_glb
from physkin_core.formats.gltf_file import GltfFile

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, tested with plain meshes


def _attribute(name, make):
    """Replaces an attribute of the vertices by a row of `make(count)` each."""

    def damage(builder):
        primitive = primitive_of(builder)
        primitive["attributes"][name] = builder.add_accessor(make(len(PERSON.vertices)))

    return damage


def _positions(builder):
    """The accessor of the vertices."""
    return builder.document["accessors"][primitive_of(builder)["attributes"]["POSITION"]]


def _node(builder, bone):
    return builder.document["nodes"][RIG.bone_index(bone)]


def _buffer(**entries):
    return lambda builder: builder.document["buffers"][0].update(entries)


def _child(node, child):
    return lambda builder: builder.document["nodes"][node].setdefault("children", []).append(child)


def _nan(count):
    rows = PERSON.vertices.copy()
    rows[12, 1] = np.nan
    return rows


def _index_too_large(builder):
    faces = PERSON.faces.astype(np.uint32).reshape(-1).copy()
    faces[7] = 20000
    primitive_of(builder)["indices"] = builder.add_accessor(faces)


def _no_elbows(builder):
    for side in "LR":
        _node(builder, f"lowerarm01.{side}")["name"] = f"Head.{side}"


def _loop(builder):
    builder.document["scenes"][0]["nodes"] = [len(builder.document["nodes"]) - 1]
    _child(5, 0)(builder)


def _five_metres(builder):
    builder.document["nodes"].append({"name": "Armature", "scale": [3, 3, 3], "children": [0]})


def _without_data(count):
    def damage(builder):
        _positions(builder)["count"] = count
        del _positions(builder)["bufferView"]

    return damage


def _endless_without_indices(builder):
    _positions(builder)["count"] = 9_999_999
    del primitive_of(builder)["indices"]


def _long_accessor(builder):
    _positions(builder)["count"] += 1


def _negative_view(builder):
    _positions(builder)["bufferView"] -= len(builder.document["bufferViews"])


def _flat_limb(builder):
    for bone in ("lowerleg02.L", "foot.L"):
        _node(builder, bone)["translation"] = [0, 0, 0]


def _overlap(builder):
    """A stride of one byte would make 64 bytes of each."""
    view = builder.add_view(np.zeros(1 << 20, np.uint8))
    builder.document["bufferViews"][view]["byteStride"] = 1
    _positions(builder).update(bufferView=view, count=(1 << 20) - 64, type="MAT4")


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
    accessor = _positions(builder)
    at = {"bufferView": view, "componentType": 5125}
    accessor["sparse"] = {"count": 1, "indices": at, "values": {"bufferView": accessor["bufferView"]}}


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_overlap, r"bufferViews\[5\] has a stride of 1 bytes, accessors\[0\] needs 64 or more"),
        (_many_bones, r"its skeleton has 21[0-9]+ bones, allowed are 2048"),
        (_many_influences, r"a vertex has 20 skinning weights, allowed are 16"),
        (_sparse_beyond, r"accessors\[0\].sparse replaces element 99999, allowed are 0 to 13717"),
        (lambda builder: builder.document.update(nodes={}), r"nodes is \{\}, it must be a list"),
        (lambda builder: builder.document["nodes"][0].update(name=7), r"nodes\[0\].name is 7, it must be a text"),
        (lambda builder: primitive_of(builder).update(mode=True), r"primitives\[0\].mode is True, it must be a whole"),
        (lambda builder: primitive_of(builder).update(indices=10**400), r"indices is an integer of 1329 bits"),
        (lambda builder: builder.document["skins"][0].update(joints=[]), r"joints of skins\[0\] are \[\], allowed are"),
        (lambda builder: builder.document["accessors"][0].update(type="VEC9"), "it must be one of SCALAR, VEC2"),
        (_attribute("POSITION", _nan), "1 vertices are not finite, the first is 12"),
        (_index_too_large, "face indices span 0 to 20000, allowed are 0 to 13717"),
        (_attribute("JOINTS_0", lambda count: np.full((count, 4), 99, np.uint8)), "names joint 99, allowed 0 to 35"),
        (_attribute("WEIGHTS_0", lambda count: np.full((count, 4), -1, np.float32)), "finite and not negative"),
        (_attribute("WEIGHTS_0", lambda count: np.ones((10, 4), np.float32)), "must agree"),
        (lambda builder: primitive_of(builder)["attributes"].pop("JOINTS_0"), "a skin but no JOINTS_0"),
        (lambda builder: primitive_of(builder).update(mode=0), "no faces"),
        (
            _no_elbows,
            r"no joint for 6 of the 12 .* upperarm01.L, lowerarm01.L, wrist.L and 3 more; taken: ",
        ),
        (_child(5, 3), "has two parents"),
        (_loop, "form a loop"),
        (_five_metres, r"m high, allowed 0.5 to 3.0 m"),
        (_buffer(uri="https://example.org/body.bin"), "only files beside it are read"),
        (_buffer(uri="gone.bin"), "it names 'gone.bin', which does not exist beside it"),
        (_buffer(uri="../person.glb"), "it names '../person.glb', outside the folder that it is in"),
        (_buffer(uri="/etc/passwd"), "it names '/etc/passwd', outside the folder"),
        (_buffer(uri="linked.bin"), "it names 'linked.bin', outside the folder"),
        (_buffer(uri="person.glb", byteLength=2**31), "is truncated: buffer 0 has [0-9]* of 2147483648 bytes"),
        (_buffer(byteLength=2_000_000), "is truncated: buffer 0 has"),
        (_without_data(10**12), "1000000000000 elements without data, allowed are 1 to"),
        (_without_data(9_999_999), "9999999 elements without data, allowed are 1 to"),
        (_endless_without_indices, "accessors\\[0\\] of 9999999 elements needs 119999988 bytes"),
        (_long_accessor, "truncated or malformed"),
        (lambda builder: primitive_of(builder)["attributes"].update(POSITION=77), r"accessors\[77\], allowed are 0 to"),
        (_negative_view, r"accessors\[0\].bufferView is -5, it must be a whole number from 0"),
        (_child(5, -1), r"nodes\[5\].children is \[6, -1\], it must be whole numbers from 0"),
        (lambda builder: _node(builder, "neck01").update(translation=[np.nan, 0, 0]), r"\[nan, 0, 0\], .* 3 finite"),
        (_flat_limb, "has no length"),
    ],
)
def test_damaged_files_are_refused(tmp_path, damage, message):
    """Each damage is refused with an AvatarError that says what was found and what is allowed, before much is
    allocated."""
    builder = person_document()
    damage(builder)
    (tmp_path / "linked.bin").symlink_to("/etc/passwd")
    tracemalloc.start()
    try:
        with pytest.raises(AvatarError, match=message):
            load_document(tmp_path, builder)
        assert tracemalloc.get_traced_memory()[1] < 60e6  # bytes
    finally:
        tracemalloc.stop()


def test_foreign_files_are_refused(tmp_path):
    """Of another version, or not glTF at all."""
    write_glb(tmp_path / "whole.glb", person_document())
    data = (tmp_path / "whole.glb").read_bytes()
    (tmp_path / "old.glb").write_bytes(data[:4] + b"\1" + data[5:])
    with pytest.raises(AvatarError, match="version 1, allowed is 2"):
        load_avatar(tmp_path / "old.glb", RIG)
    for text in ("solid", "<html>404</html>", "version https://git-lfs", "[]"):
        (tmp_path / "page.glb").write_text(text)
        with pytest.raises(AvatarError, match=re.escape(f"is not a glTF file: it begins with b'{text[:16]}'")):
            load_avatar(tmp_path / "page.glb", RIG)
    for text in ("{", "{}", '\ufeff {"asset": {"version": "2.0"}, "nodes": 3}'):
        (tmp_path / "other.gltf").write_text(text)
        with pytest.raises(AvatarError, match="it is not JSON|no faces|nodes is 3, it must be a list"):
            load_avatar(tmp_path / "other.gltf", RIG)


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

"""Compressed and quantised glTF: the same person as from the file that nothing was done to."""

import sys

import numpy as np
import pytest
from gltf_person import PERSON, distances, load_document, person_document, primitive_of

from physkin_core.avatar.avatar import AvatarError

pytestmark = pytest.mark.filterwarnings("ignore::UserWarning")  # AvatarWarning, tested with plain meshes
DRACO = "KHR_draco_mesh_compression"
JOINTS_ID, WEIGHTS_ID, POSITION_ID = 7, 9, 10  # positions come after the generic attributes


def _stored(builder, index):
    """An accessor and its rows."""
    accessor = builder.document["accessors"][index]
    view = builder.document["bufferViews"][accessor["bufferView"]]
    dtype = {5121: np.uint8, 5123: np.uint16, 5125: np.uint32, 5126: np.float32}[accessor["componentType"]]
    data = np.frombuffer(bytes(builder.binary[view["byteOffset"] :][: view["byteLength"]]), dtype)
    return accessor, data.reshape(accessor["count"], -1)


def _compress_view(builder, index, rows, mode, *, name="EXT_meshopt_compression", **filtered):
    """Give an accessor a view that is compressed in buffer 0 and would, decompressed, lie in a second buffer."""
    meshopt = pytest.importorskip("meshopt")
    document, accessor = builder.document, builder.document["accessors"][index]
    stride = rows.itemsize * rows.shape[1]
    start = len(builder.binary)
    builder.binary += meshopt.encode_gltf_buffer(filtered.pop("encoded", rows), mode)
    document["buffers"][0]["byteLength"] = len(builder.binary)
    if len(document["buffers"]) == 1:
        document["buffers"].append({"byteLength": 0, "extensions": {name: {"fallback": True}}})
    extension = {"buffer": 0, "byteOffset": start, "byteLength": len(builder.binary) - start, "byteStride": stride}
    extension |= {"count": len(rows), "mode": mode, **filtered}
    length = stride * len(rows)
    document["bufferViews"].append({"buffer": 1, "byteLength": length, "extensions": {name: extension}})
    if mode == "ATTRIBUTES":
        document["bufferViews"][-1]["byteStride"] = stride
    document["buffers"][1]["byteLength"] += length
    accessor["bufferView"] = len(document["bufferViews"]) - 1
    document["extensionsRequired"] = [name]
    return extension


@pytest.mark.parametrize("name", ["EXT_meshopt_compression", "KHR_meshopt_compression"])
def test_meshopt(tmp_path, name):
    """Positions through the exponential filter, joints, weights and triangles, each in a view of its own."""
    meshopt = pytest.importorskip("meshopt")
    builder = person_document()
    primitive = primitive_of(builder)
    for attribute, index in primitive["attributes"].items():
        _, rows = _stored(builder, index)
        filtered = {}
        if attribute == "POSITION":
            filtered = {"encoded": meshopt.encode_filter_exp(rows, 20), "filter": "EXPONENTIAL"}
        _compress_view(builder, index, rows, "ATTRIBUTES", name=name, **filtered)
    _, corners = _stored(builder, primitive["indices"])
    _compress_view(builder, primitive["indices"], corners, "TRIANGLES", name=name)
    avatar = load_document(tmp_path, builder)
    assert distances(avatar.vertices, PERSON.vertices).max() < 0.1
    assert len(avatar.faces) == len(PERSON.faces)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"byteLength": 10**7}, "a compressed buffer view of 13718 times 12 bytes is at bytes .* allowed are"),
        ({"count": 10**9}, "1000000000 times 12 bytes .* and 164616 when decoded"),
        ({"byteLength": 40}, "a compressed buffer view is malformed"),
        ({"mode": "HEXAGONS"}, "mode is 'HEXAGONS', it must be one of ATTRIBUTES"),
        ({"buffer": 5}, "it names buffers\\[5\\], allowed are 0 to 1"),
    ],
)
def test_damaged_meshopt_views_are_refused(tmp_path, change, message):
    """Sizes are checked before anything is decoded."""
    builder = person_document()
    index = primitive_of(builder)["attributes"]["POSITION"]
    _compress_view(builder, index, _stored(builder, index)[1], "ATTRIBUTES").update(change)
    with pytest.raises(AvatarError, match=message):
        load_document(tmp_path, builder)


def _draco_document():
    draco = pytest.importorskip("DracoPy")
    builder = person_document()
    primitive = primitive_of(builder)
    rows = {name: _stored(builder, index)[1] for name, index in primitive["attributes"].items()}
    data = draco.encode(
        rows["POSITION"],
        PERSON.faces.astype(np.uint32),
        quantization_bits=18,
        preserve_order=True,
        generic_attributes={JOINTS_ID: rows["JOINTS_0"], WEIGHTS_ID: rows["WEIGHTS_0"]},
    )
    decoded = draco.decode(data)
    for index in primitive["attributes"].values():
        accessor = builder.document["accessors"][index]
        del accessor["bufferView"]
        accessor["count"] = len(decoded.points)
    view = builder.add_view(np.frombuffer(data, np.uint8))
    named = {"POSITION": POSITION_ID, "JOINTS_0": JOINTS_ID, "WEIGHTS_0": WEIGHTS_ID}
    primitive["extensions"] = {DRACO: {"bufferView": view, "attributes": named}}
    builder.document["extensionsRequired"] = [DRACO]
    return builder


def test_draco(tmp_path):
    """Positions, joints, normalised weights and triangles of a primitive."""
    avatar = load_document(tmp_path, _draco_document())
    assert avatar.faces.shape == PERSON.faces.shape
    assert distances(avatar.vertices, PERSON.vertices).max() < 0.1
    assert distances(avatar.bone_heads, PERSON.bone_heads).max() < 0.1


def test_damaged_draco_is_refused(tmp_path):
    """Garbage, and attributes that are not what the accessors say."""
    builder = _draco_document()
    view = builder.document["bufferViews"][-1]
    builder.binary[view["byteOffset"] : view["byteOffset"] + 100] = bytes(100)
    with pytest.raises(AvatarError, match=f"a primitive's {DRACO} is malformed"):
        load_document(tmp_path, builder)
    builder = _draco_document()
    primitive_of(builder)["extensions"][DRACO]["attributes"]["JOINTS_0"] = 77
    with pytest.raises(AvatarError, match="JOINTS_0 as .*these must agree"):
        load_document(tmp_path, builder)


@pytest.mark.parametrize(("package", "extension"), [("meshopt", "EXT_meshopt_compression"), ("DracoPy", DRACO)])
def test_what_is_missing_is_named(tmp_path, monkeypatch, package, extension):
    """Without the extra, the error says how to get it."""
    if package == "meshopt":
        builder = person_document()
        index = primitive_of(builder)["attributes"]["POSITION"]
        _compress_view(builder, index, _stored(builder, index)[1], "ATTRIBUTES")
    else:
        builder = _draco_document()
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(AvatarError, match=rf"with {extension}; .*pip install .*\[compressed\]' \({package}\)"):
        load_document(tmp_path, builder)


def test_quantised_positions(tmp_path):
    """KHR_mesh_quantization: positions as 16-bit integers, which the inverse bind matrices undo."""
    builder = person_document()
    document, primitive = builder.document, primitive_of(builder)
    _, rows = _stored(builder, primitive["attributes"]["POSITION"])
    low, span = rows.min(axis=0), float(np.ptp(rows, axis=0).max())
    whole = np.round((rows - low) / span * 65535).astype(np.uint16)
    primitive["attributes"]["POSITION"] = builder.add_accessor(whole, normalized=True)
    _, bind = _stored(builder, document["skins"][0]["inverseBindMatrices"])
    undo = np.diag([span, span, span, 1.0])
    undo[:3, 3] = low
    stored = bind.reshape(-1, 4, 4).transpose(0, 2, 1) @ undo
    changed = stored.transpose(0, 2, 1).reshape(-1, 16).astype(np.float32)
    document["skins"][0]["inverseBindMatrices"] = builder.add_accessor(changed)
    document["extensionsRequired"] = ["KHR_mesh_quantization"]
    assert distances(load_document(tmp_path, builder).vertices, PERSON.vertices).max() < 0.1

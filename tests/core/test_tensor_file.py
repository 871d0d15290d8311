"""Safetensors files from anywhere: what is written comes back, what cannot be read is told in a sentence."""

import numpy as np
import pytest
from model_files import edited_header
from safetensors.numpy import save

from physkin_core.file_reading import ContentError
from physkin_core.tensor_file import DIGEST, LARGEST_HEADER, content_digest, read_tensors, write_tensors

TENSORS = {"a": np.arange(6, dtype=np.float32).reshape(2, 3), "none": np.empty((0, 3), np.int8)}


def test_round_trip(tmp_path):
    """Metadata, tensors and a digest that fits; nothing else is left in the folder."""
    write_tensors(tmp_path / "x.safetensors", {"name": "x"}, TENSORS)
    metadata, tensors = read_tensors((tmp_path / "x.safetensors").read_bytes())
    assert metadata == {"name": "x", DIGEST: content_digest({"name": "x"}, TENSORS)}
    assert tensors.keys() == TENSORS.keys()
    for name, tensor in tensors.items():
        np.testing.assert_array_equal(tensor, TENSORS[name], strict=True)
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.parametrize(
    "change",
    [
        lambda metadata, tensors: metadata.update(name="y"),
        lambda metadata, tensors: tensors.update(b=tensors.pop("a")),
        lambda metadata, tensors: tensors.update(a=tensors["a"].reshape(3, 2)),
        lambda metadata, tensors: tensors.update(a=tensors["a"].view(np.int32)),
        lambda metadata, tensors: tensors.update(a=tensors["a"] + np.float32(1e-7)),
    ],
)
def test_the_digest_covers_everything(change):
    metadata, tensors = {"name": "x"}, dict(TENSORS)
    before = content_digest(metadata, tensors)
    change(metadata, tensors)
    assert content_digest(metadata, tensors) != before


def test_types_that_numpy_lacks_are_told():
    content = save({"a": np.zeros(4, np.float16)})
    content = edited_header(content, lambda header: header["a"].update(dtype="BF16"))
    with pytest.raises(ContentError, match="holds an array of type BF16, which NumPy lacks"):
        read_tensors(content)


def test_large_headers_are_not_parsed():
    content = save(TENSORS, metadata={"notes": "x" * LARGEST_HEADER})
    with pytest.raises(ContentError, match=f"header has 4194[0-9]* bytes; at most {LARGEST_HEADER} are read"):
        read_tensors(content)


@pytest.mark.parametrize("content", [b"", b"1234567", b"\xff" * 100, save(TENSORS)[:-1], save(TENSORS) + b"\0"])
def test_other_content_is_told(content):
    with pytest.raises(ContentError, match="it cannot be read as safetensors"):
        read_tensors(content)

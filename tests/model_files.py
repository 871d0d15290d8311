"""Garment model files taken apart and sealed again, as someone would who knows the format."""

import json
from pathlib import Path

import pytest
from safetensors.numpy import save

from physkin_core.model import model_file
from physkin_core.tensor_file import DIGEST, content_digest


def contents(path) -> tuple[dict, dict]:
    """Metadata and tensors of a file, inflated, with its texts and faces: as a file may hold them, too."""
    return model_file._contents(Path(path), Path(path).read_bytes())


def save_packed(model, path) -> None:
    """Save a garment model with all its network weights packed, as those of shipped models are, however small."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(model_file, "LEAST_PACKED", 1)
        model_file.save_garment_model(model, path)


def sealed(metadata, tensors) -> bytes:
    """The file with a digest that fits."""
    return save(tensors, metadata={**metadata, DIGEST: content_digest(metadata, tensors)})


def written(path: Path, content: bytes) -> Path:
    path.write_bytes(content)
    return path


def edited_header(content: bytes, change) -> bytes:
    """A safetensors file whose header, as plain data, was changed."""
    size = int.from_bytes(content[:8], "little")
    header = json.loads(content[8 : 8 + size])
    change(header)
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + content[8 + size :]

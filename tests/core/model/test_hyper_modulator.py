"""The hyper modulator on the same person in two poses. Values: tests/native/test_native_body_encoder.py."""

from __future__ import annotations

import numpy as np
import pytest

from physkin_core import avatar_from_body, load_avatar, load_body_model, load_garment_model
from physkin_core.model.model_file import MODELS_PATH
from physkin_core.runtime.binding import encode_body

SHIPPED = [
    pytest.param(path, marks=() if path.stem == "tshirt" else pytest.mark.slow, id=path.stem)
    for path in sorted(MODELS_PATH.glob("*.safetensors"))
]


@pytest.fixture(scope="module")
def people(tmp_path_factory):
    """Six A-posed bodies; the first three again as T-posed VRMs, loaded into the canonical pose."""
    from gltf_person import write_vrm

    body = load_body_model()
    folder = tmp_path_factory.mktemp("people")
    vrms = []
    for index, version in enumerate(("1.0", "0.x", "1.0")):
        write_vrm(folder / f"{index}.vrm", body_index=index, vrm_version=version)
        vrms.append(load_avatar(folder / f"{index}.vrm", body.rig))
    return [avatar_from_body(body, coefficients) for coefficients in body.held_out_bodies[:6]], vrms


@pytest.mark.parametrize("source", SHIPPED)
def test_a_person_encodes_alike_from_either_pose(people, source):
    """T-posed VRM and A-posed body of one person: nearest to each other, and a third as far apart as strangers are."""
    model = load_garment_model(source)
    bodies, vrms = people
    encoded = np.array([encode_body(model, body, fit=1.0) for body in bodies])
    assert encoded.dtype == np.float32
    strangers = np.linalg.norm(encoded[:, None] - encoded, axis=-1)[np.triu_indices(6, 1)].mean()
    for index, vrm in enumerate(vrms):
        distance = np.linalg.norm(encoded - encode_body(model, vrm, fit=1.0), axis=1)
        assert distance.argmin() == index
        assert distance[index] < strangers / 3

"""The body that garments are checked and trained on."""

import pytest

from physkin_core import load_body_model
from physkin_core.avatar.avatar import avatar_from_body


@pytest.fixture(scope="module")
def template():
    body_model = load_body_model()
    return avatar_from_body(body_model, body_model.garment_body)

"""Drape nodes in the tests' own process, and what they should compute."""

from __future__ import annotations

import pytest

from physkin_core import BUNDLED_AVATAR, Draper, load_avatar, load_garment_model


@pytest.fixture(scope="module")
def other_body(tmp_path_factory):
    """A body a tenth larger than the bundled one, in a folder of its own."""
    from drape_site import scaled_body

    path = tmp_path_factory.mktemp("bodies") / "other.glb"
    path.write_bytes(scaled_body(1.1))
    return path


@pytest.fixture(scope="session")
def leaning_draper(leaning_model_path) -> Draper:
    """The same of the garment that gravity moves."""
    model = load_garment_model(leaning_model_path)
    return Draper(model, load_avatar(BUNDLED_AVATAR, model.rig))

"""A sway network taken over by a model that was trained on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from physkin_core import load_body_model, load_garment_model
from physkin_training.networks.export import drape_from_model, encode_bodies
from physkin_training.sampling.posed_bodies import BodySet
from physkin_training.transfer.sway_transfer import transferred_sway

CPU = torch.device("cpu")


@pytest.fixture(scope="module")
def skirt():
    return load_garment_model("skirt")


def codes(model, sway, body_model, count=6):
    """Of held-out bodies (count, c), made to measure."""
    bodies = BodySet(body_model, body_model.held_out_bodies[:count], CPU).vertices.numpy()
    modulations = encode_bodies(drape_from_model(model), bodies, body_model.faces, fit=1.0).numpy()
    return np.stack([sway.body_code(modulation) for modulation in modulations])


def test_bodies_keep_their_codes_where_training_has_changed_modulations(skirt):
    """The encoder's last layer mixes its outputs otherwise; read as before, codes would be others."""
    body_model, random = load_body_model(), np.random.default_rng(0)
    encoder = dict(skirt.hyper_modulator)
    size = len(encoder["output.bias"])
    mixed = np.eye(size) + random.standard_normal((size, size)) / np.sqrt(size)
    for name in ("output.weight", "output.bias"):
        encoder[name] = (mixed @ encoder[name]).astype(np.float32)
    trained = replace(skirt, hyper_modulator=encoder)
    sway = transferred_sway(skirt, trained, body_model, CPU)
    had, kept, lost = (
        codes(model, network, body_model)
        for model, network in ((skirt, skirt.sway), (trained, sway), (trained, skirt.sway))
    )
    wrong, without = (np.sqrt(np.mean((other - had) ** 2)) for other in (kept, lost))
    assert wrong < 0.3 and without > 3 * wrong and had.std() > 0.7
    assert all(np.array_equal(a, b) for a, b in zip(sway.out, skirt.sway.out))

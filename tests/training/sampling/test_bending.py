"""How stiffly the cloth of a step's bodies bends."""

from __future__ import annotations

import pytest
import torch

from physkin_core.model.hyper_modulator import BENDING_OCTAVES, bending_code
from physkin_training.sampling.bending import drawn_bending


def test_codes_are_those_of_the_run_time_and_a_share_bends_as_trained():
    torch.manual_seed(0)
    codes, stiffer = drawn_bending(4000, 0.5, torch.device("cpu"))
    for code, times in zip(codes[:50].tolist(), stiffer[:50].tolist()):
        assert code == pytest.approx(bending_code(times), abs=1e-5)
    assert (stiffer == 1).float().mean().item() == pytest.approx(0.5, abs=0.03)
    softest, stiffest = (2.0**octave for octave in BENDING_OCTAVES)
    assert softest <= stiffer.min().item() < 1.1 * softest and 0.9 * stiffest < stiffer.max().item() <= stiffest

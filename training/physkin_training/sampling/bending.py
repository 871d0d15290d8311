"""How stiffly the cloth of a step's bodies bends: one network learns all fabrics (`physkin_core.model.fabric`)."""

from __future__ import annotations

import torch

from physkin_core.model.hyper_modulator import BENDING_OCTAVES, OCTAVES_OF_A_CODE

__all__ = ["drawn_bending"]


def drawn_bending(bodies: int, share: float, device: torch.device) -> tuple[torch.Tensor, torch.Tensor]:
    """Codes (bodies,) for the hyper modulator (see `bending_code`), and how many times as stiffly as the trained cloth
    each one bends (bodies,): `share` of them otherwise, evenly over octaves."""
    softest, stiffest = BENDING_OCTAVES
    drawn, chosen = torch.rand(2, bodies, device=device)
    octaves = (softest + (stiffest - softest) * drawn) * (chosen < share)
    return octaves / OCTAVES_OF_A_CODE, torch.exp2(octaves)

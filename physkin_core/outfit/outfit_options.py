"""The option `--tucked` of every command that puts on an outfit, and the garments that it asks for."""

from __future__ import annotations

import argparse
from collections.abc import Sequence

from physkin_core.model.model_file import load_garment_model
from physkin_core.outfit.layers import OutfitGarment

__all__ = ["add_tucked_option", "chosen_garments"]


def add_tucked_option(parser: argparse.ArgumentParser) -> None:
    """Add `--tucked`, a list of what `--garment` names."""
    parser.add_argument(
        "--tucked",
        action="append",
        default=[],
        metavar="MODEL",
        help="garment whose hem is under the next one's waistband",
    )


def chosen_garments(names: Sequence[str], tucked: Sequence[str]) -> list[OutfitGarment]:
    """Garments by file or shipped name, from the skin outwards. Raises ValueError when one is tucked that is not worn,
    or a file is no model."""
    for name in tucked:
        if name not in names:
            raise ValueError(f"--tucked {name}: none of the garments, which are {', '.join(names)}")
    return [OutfitGarment(load_garment_model(name), tucked=name in tucked) for name in names]

"""The option `--fit` of every command that binds a garment to a body."""

from __future__ import annotations

import argparse

__all__ = ["add_fit_option"]


def add_fit_option(parser: argparse.ArgumentParser) -> None:
    """Add `--fit`, a number that is left to `checked_fit` of `physkin_core.runtime.worn_garment`; None where it is not
    given."""
    parser.add_argument(
        "--fit",
        type=float,
        metavar="F",
        help="1: made to measure, 0: one size, or between (default: 1; 0 for another rig than the body model's)",
    )

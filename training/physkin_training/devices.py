"""Choice of the device to train and evaluate on."""

from __future__ import annotations

import torch

__all__ = ["DEFAULT_DEVICE", "DEVICE_HELP", "resolve_device"]

DEFAULT_DEVICE = "cuda" if torch.cuda.is_available() else "cpu"
DEVICE_HELP = "cpu, cuda or cuda:1 (default: cuda if there is a GPU)"


def resolve_device(name: str) -> torch.device:
    """A torch device with its index, as Warp needs it. Raises ValueError for one that is not there."""
    try:
        device = torch.device(name)
    except RuntimeError as error:
        raise ValueError(f"unknown device {name!r}: {error}") from error
    if device.type == "cpu":
        return torch.device("cpu")
    if device.type != "cuda" or not torch.cuda.is_available():
        raise ValueError(
            f"device {name!r} is not available; use cpu" + (" or cuda" if torch.cuda.is_available() else "")
        )
    return torch.device("cuda", device.index if device.index is not None else torch.cuda.current_device())

"""Simulated walkers in a file, so that what took a GPU minutes is learnt from more than once."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, fields
from pathlib import Path

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save_file

from physkin_training.sway.shapes import Shapes
from physkin_training.sway.walkers import Walkers

__all__ = ["load_walkers", "save_walkers"]

FORMAT = "physkin-walkers-4"
SHAPES = "shapes."
"""What the names of their arrays begin with."""


def save_walkers(walkers: Walkers, plan: Mapping[str, object], path: Path) -> None:
    """Write walkers, and the plan that they were simulated by, as plain data (.safetensors)."""
    tensors = {entry.name: getattr(walkers, entry.name) for entry in fields(walkers) if entry.name != "shapes"}
    tensors["bodies"] = torch.as_tensor(walkers.bodies)
    tensors |= {SHAPES + name: tensor for name, tensor in asdict(walkers.shapes).items()}
    tensors = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    partial = path.with_name(path.name + ".partial")
    save_file(tensors, partial, {"format": FORMAT, "plan": json.dumps(dict(plan))})
    partial.replace(path)


def load_walkers(plan: Mapping[str, object], path: Path, device: torch.device) -> Walkers:
    """Read walkers of a plan. Raises ValueError where a file is none of walkers, or of another plan."""
    try:
        with safe_open(path, "pt", device=str(device)) as file:
            metadata = file.metadata() or {}
            if metadata.get("format") != FORMAT:
                raise ValueError(f"{path} holds no simulated walkers")
            known = json.loads(metadata["plan"])
            wrong = [name for name, value in plan.items() if known.get(name) != value]
            if wrong:
                other = "; ".join(f"{name} {known.get(name)}, not {plan[name]}" for name in wrong)
                raise ValueError(f"walkers of {path} were simulated with {other}: name another file")
            tensors = {name: file.get_tensor(name) for name in file.keys()}
    except SafetensorError as error:
        raise ValueError(f"{path} cannot be read: {error}") from error
    shapes = Shapes(*(tensors.pop(SHAPES + entry.name) for entry in fields(Shapes)))
    return Walkers(bodies=tensors.pop("bodies").cpu().numpy(), shapes=shapes, **tensors)

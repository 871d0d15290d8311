"""Checkpoints: a folder of safetensors files and one JSON file, enough to go on exactly where a run stopped.

Networks, first moments and second moments lie in files of their own, so that none grows large.
"""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from physkin_training.config import TrainingConfig
from physkin_training.draping import Drape

__all__ = ["CheckpointError", "load_checkpoint", "load_drape", "save_checkpoint"]

MOMENTS = ("exp_avg", "exp_avg_sq")


class CheckpointError(ValueError):
    """A checkpoint is missing, damaged, or of another configuration."""


def save_checkpoint(
    folder: Path, drape: Drape, optimiser: torch.optim.Optimizer, *, step: int, config: TrainingConfig
) -> None:
    """Write drape, optimiser and random state into `folder`. The state file is written last and makes it valid."""
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "state.json").unlink(missing_ok=True)
    names = {id(parameter): name for name, parameter in drape.named_parameters()}
    save_file({name: tensor.contiguous() for name, tensor in drape.state_dict().items()}, folder / "drape.safetensors")
    for moment in MOMENTS:
        tensors = {names[id(p)]: state[moment].contiguous() for p, state in optimiser.state.items()}
        save_file(tensors, folder / f"{moment}.safetensors")
    random = {"cpu": torch.get_rng_state()}
    if torch.cuda.is_available():
        random["cuda"] = torch.cuda.get_rng_state()
    save_file(random, folder / "random.safetensors")
    state = {"step": step, "config": _plain(config)}
    (folder / "state.json").write_text(json.dumps(state, indent=1))


def load_checkpoint(folder: Path, drape: Drape, optimiser: torch.optim.Optimizer, *, config: TrainingConfig) -> int:
    """Restore what `save_checkpoint` wrote; returns the number of finished steps.

    Raises CheckpointError when files are missing or do not fit, or the configuration differs (naming the entry).
    """
    try:
        state = json.loads((folder / "state.json").read_text())
        tensors = load_file(folder / "drape.safetensors")
        moments = {moment: load_file(folder / f"{moment}.safetensors") for moment in MOMENTS}
        random = load_file(folder / "random.safetensors")
    except Exception as error:
        raise CheckpointError(f"cannot read checkpoint {folder}: {error}") from error
    _check_same_config(state["config"], _plain(config))
    try:
        drape.load_state_dict(tensors)
    except RuntimeError as error:
        raise CheckpointError(f"checkpoint {folder} does not fit the model: {error}") from error
    step = int(state["step"])
    for name, parameter in drape.named_parameters():
        entry = {moment: moments[moment][name].to(parameter.device) for moment in MOMENTS if name in moments[moment]}
        if entry:
            on_device = parameter.device if parameter.is_cuda else "cpu"
            entry["step"] = torch.tensor(float(step), device=on_device)
            optimiser.state[parameter] = entry
    torch.set_rng_state(random["cpu"])
    if "cuda" in random and torch.cuda.is_available():
        torch.cuda.set_rng_state(random["cuda"])
    return step


def load_drape(folder: Path, drape: Drape) -> None:
    """Take over networks and skinning weights alone, whatever the configuration of the run that made them.

    Raises CheckpointError when the file cannot be read or is of another garment or other sizes.
    """
    try:
        drape.load_state_dict(load_file(folder / "drape.safetensors"))
    except Exception as error:
        raise CheckpointError(f"cannot start from checkpoint {folder}: {error}") from error


def _plain(config: TrainingConfig) -> dict:
    plain = asdict(config)
    plain["garment"] = config.garment.name
    return plain


def _check_same_config(saved: dict, current: dict) -> None:
    for key in sorted(set(saved) | set(current)):
        before, now = saved.get(key), current.get(key)
        if isinstance(before, dict) and isinstance(now, dict):
            _check_same_config(before, now)
        elif before != now:
            raise CheckpointError(f"checkpoint was made with {key} = {before!r}, the configuration says {now!r}")

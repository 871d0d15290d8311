"""Checkpoints: one file each, enough to go on exactly where a run stopped.

A checkpoint is written beside the one it replaces and takes its place once complete: an interrupted save loses nothing.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

from physkin_training.config import TrainingConfig
from physkin_training.networks.draping import Drape
from physkin_training.soap import Soap
from physkin_training.train.validation import BestModel

__all__ = [
    "CHECKPOINT_SUFFIX",
    "CheckpointError",
    "Progress",
    "checkpoint_step",
    "load_checkpoint",
    "load_drape",
    "save_checkpoint",
    "saved_steps",
]

CHECKPOINT_SUFFIX = ".pt"
OWN_BUFFERS = ("influence_bias", "engine_bias", "networks.node_mean", "networks.node_scale")
"""What a run sets for itself, beside what it trains."""
SAME = 1e-6
"""Rest positions [m] and joint limits [rad] that differ by less are the same: another processor rounds differently."""


class CheckpointError(ValueError):
    """A checkpoint is missing, damaged, or of another configuration, garment or body."""


@dataclass(frozen=True)
class Progress:
    """How far a run is: finished steps, the best model yet, and plain data on the run that this one began from."""

    step: int
    best: BestModel | None = None
    started_from: dict | None = None


def save_checkpoint(
    path: Path, drape: Drape, averaged: Drape, optimiser: Soap, *, progress: Progress, config: TrainingConfig
) -> None:
    """Write drape, moving average, optimiser and random states as `path`, replacing a checkpoint that is there."""
    random = {"cpu": torch.get_rng_state()}
    if torch.cuda.is_available():
        random["cuda"] = torch.cuda.get_rng_state()
    content = {
        "step": progress.step,
        "best": vars(progress.best) if progress.best else None,
        "started_from": progress.started_from,
        "config": config.as_plain_data(),
        "drape": drape.state_dict(),
        "average": {name: parameter.detach() for name, parameter in averaged.named_parameters()},
        "optimiser": _optimiser_tensors(optimiser, drape),
        "random": random,
    }
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(f"{path.name}.partial")
    torch.save(content, partial)
    partial.replace(path)


def load_checkpoint(path: Path, drape: Drape, averaged: Drape, optimiser: Soap, *, config: TrainingConfig) -> Progress:
    """Restore what `save_checkpoint` wrote.

    Raises CheckpointError when the file cannot be read or does not fit, or the configuration, the garment or the body
    differs (naming the entry).
    """
    content = _read(path)
    _check_same_config(content["config"], config.as_plain_data())
    own, best = _optimiser_tensors(optimiser, drape), content["best"]
    parameters = dict(drape.named_parameters())
    try:
        _check_same_model(content["drape"], drape)
        _check_fit(content["average"], parameters, "average")
        _check_fit(best["parameters"] if best else {}, parameters if best else {}, "best")
        _check_fit(content["optimiser"], own, "optimiser")
        _set_random_state(content["random"])
    except CheckpointError as error:
        raise CheckpointError(f"checkpoint {path} {error}") from error
    drape.load_state_dict(content["drape"])
    averaged.load_state_dict(content["drape"] | content["average"])
    for name, tensor in own.items():
        tensor.copy_(content["optimiser"][name])
    optimiser.steps.fill_(content["step"])
    if best:
        best["parameters"] = {name: each.to(parameters[name].device) for name, each in best["parameters"].items()}
    return Progress(content["step"], BestModel(**best) if best else None, content["started_from"])


def load_drape(path: Path, drape: Drape) -> dict:
    """Take over networks and skinning weights alone, whatever the run's configuration was: the best that the run kept,
    or where it kept none yet the moving average.

    Returns plain data on that run: its configuration, the `step` they are of and `started_from`. Raises CheckpointError
    when the file cannot be read or is of another garment, another body or other sizes.
    """
    try:
        content = _read(path)
        best = content["best"]
        learnt = best["parameters"] if best else content["average"]
        _check_same_model(content["drape"], drape)
        _check_fit(learnt, dict(drape.named_parameters()), "best" if best else "average")
    except CheckpointError as error:
        raise CheckpointError(f"cannot start from checkpoint {path}: {error}") from error
    drape.load_state_dict(content["drape"] | learnt)
    run = content["config"] | {"step": best["step"] if best else content["step"]}
    return run | ({"started_from": content["started_from"]} if content["started_from"] else {})


def checkpoint_step(path: Path) -> int | None:
    """The step a checkpoint is of; None where there is none that can be read."""
    try:
        return _read(path)["step"]
    except CheckpointError:
        return None


def saved_steps(path: Path) -> int:
    """How many steps the run of a checkpoint takes in all. Raises CheckpointError when the file cannot be read."""
    steps = (_read(path)["config"].get("optimisation") or {}).get("steps")
    if type(steps) is not int or steps < 1:
        raise CheckpointError(f"cannot read checkpoint {path}: its configuration has {steps!r} optimisation.steps")
    return steps


def _optimiser_tensors(optimiser: Soap, drape: Drape) -> dict[str, torch.Tensor]:
    """The optimiser's state, by the parameter's name and the kind of state."""
    states = {name: optimiser.state[parameter] for name, parameter in drape.named_parameters()}
    return {f"{name} {kind}": tensor for name, state in states.items() for kind, tensor in state.items()}


KINDS = {
    "step": int,
    "best": dict | None,
    "started_from": dict | None,
    "config": dict,
    **dict.fromkeys(("drape", "average", "optimiser", "random"), dict),
}
"""What a checkpoint has to hold."""


def _read(path: Path) -> dict[str, Any]:
    """Tensors on the CPU and plain data; nothing that a file holds is executed."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # torch raises errors of many kinds for damaged files
        raise CheckpointError(f"cannot read checkpoint {path}: {' '.join(str(error).split())}") from error
    content = content if isinstance(content, dict) else {}
    for name, kind in KINDS.items():
        if name not in content or not isinstance(content[name], kind):
            raise CheckpointError(f"cannot read checkpoint {path}: it needs an entry {name!r} of {kind}")
    best = content["best"]
    if content["step"] < 0 or best is not None and best.keys() != {"step", "energy", "parameters"}:
        raise CheckpointError(f"cannot read checkpoint {path}: its step or its best model cannot be")
    return content


def _check_same_model(tensors: dict, drape: Drape) -> None:
    """Sizes must fit, and what is given (mesh, garment nodes, body, joint limits) must be the drape's own."""
    _check_fit(tensors, drape.state_dict(), "drape")
    fixed = {name: buffer.cpu() for name, buffer in drape.named_buffers() if name not in OWN_BUFFERS}
    differing = [
        name for name, own in fixed.items() if not torch.allclose(tensors[name].to(own.dtype), own, rtol=0, atol=SAME)
    ]
    if differing:
        raise CheckpointError(f"is of another garment, body or garment nodes: {', '.join(differing)} differ")


def _check_fit(tensors: Mapping, expected: Mapping, entry: str) -> None:
    if odd := sorted(set(tensors) ^ set(expected)):
        raise CheckpointError(f"does not fit the model: its {entry} has too much or lacks {', '.join(odd)}")
    for name, tensor in tensors.items():
        if tensor.shape != expected[name].shape:
            raise CheckpointError(
                f"does not fit the model: its {entry} has {name} of shape {tuple(tensor.shape)}, "
                f"expected {tuple(expected[name].shape)}"
            )


def _set_random_state(random: Mapping[str, torch.Tensor]) -> None:
    try:
        torch.set_rng_state(random["cpu"])
        if "cuda" in random and torch.cuda.is_available():
            torch.cuda.set_rng_state(random["cuda"])
    except (KeyError, TypeError, RuntimeError) as error:
        raise CheckpointError(f"has no usable random state: {error!r}") from error


def _check_same_config(saved: dict, current: dict) -> None:
    for key in sorted(set(saved) | set(current)):
        before, now = saved.get(key), current.get(key)
        if isinstance(before, dict) and isinstance(now, dict):
            _check_same_config(before, now)
        elif before != now:
            raise CheckpointError(
                f"checkpoint was made with {key} = {before!r}, the configuration says {now!r}; "
                "a new run from its networks is --start-from"
            )

"""Checkpoints: a folder of safetensors files and one JSON file, enough to go on exactly where a run stopped.

Networks, their moving average, the best average so far, and each kind of the optimiser's state lie in files of their
own, so that none grows large.
A checkpoint is written beside the one it replaces and takes its place once complete: an interrupted save loses nothing.
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import torch
from safetensors.torch import load_file, save_file

from physkin_training.config import TrainingConfig
from physkin_training.networks.draping import Drape
from physkin_training.soap import SIDES, Soap
from physkin_training.train.validation import BestModel

__all__ = [
    "CheckpointError",
    "Progress",
    "checkpoint_step",
    "load_checkpoint",
    "load_drape",
    "save_checkpoint",
    "saved_steps",
]

OPTIMISER_FILES = ("exp_avg", "exp_avg_sq", *(f"{kind}_{side}" for kind in ("covariance", "basis") for side in SIDES))
TENSOR_FILES = ("drape", "average", "best", *OPTIMISER_FILES, "random")
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
    folder: Path,
    drape: Drape,
    averaged: Drape,
    optimiser: Soap,
    *,
    progress: Progress,
    config: TrainingConfig,
) -> None:
    """Write drape, moving average, optimiser and random states as `folder`, replacing a checkpoint that is there.

    Raises CheckpointError when other files lie in `folder`.
    """
    random = {"cpu": torch.get_rng_state()}
    if torch.cuda.is_available():
        random["cuda"] = torch.cuda.get_rng_state()
    folder = folder.resolve()
    _refuse_other_files(folder)
    partial, previous = _sibling(folder, "partial"), _sibling(folder, "previous")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    best = progress.best
    _save(drape.state_dict(), partial / "drape.safetensors")
    _save(dict(averaged.named_parameters()), partial / "average.safetensors")
    _save(best.parameters if best else {}, partial / "best.safetensors")
    for kind, tensors in _optimiser_tensors(optimiser, drape).items():
        _save(tensors, partial / f"{kind}.safetensors")
    _save(random, partial / "random.safetensors")
    state = {
        "step": progress.step,
        "best": {"step": best.step, "energy_j": best.energy} if best else None,
        "config": config.as_plain_data(),
        "started_from": progress.started_from,
    }
    (partial / "state.json").write_text(json.dumps(state, indent=1))
    if folder.exists():
        shutil.rmtree(previous, ignore_errors=True)
        folder.rename(previous)
    partial.rename(folder)
    shutil.rmtree(previous, ignore_errors=True)


def load_checkpoint(
    folder: Path, drape: Drape, averaged: Drape, optimiser: Soap, *, config: TrainingConfig
) -> Progress:
    """Restore what `save_checkpoint` wrote.

    Raises CheckpointError when files are missing or do not fit, or the configuration, the garment or the body differs
    (naming the entry).
    """
    state = _read_state(folder)
    files = {name: _read_tensors(folder, name) for name in TENSOR_FILES}
    _check_same_config(state["config"], config.as_plain_data())
    parameters = dict(drape.named_parameters())
    try:
        _check_same_model(files["drape"], drape)
        _check_fit(files["average"], parameters, "average")
        _check_fit(files["best"], parameters if state["best"] else {}, "best")
        own = _optimiser_tensors(optimiser, drape)
        for kind, tensors in own.items():
            _check_fit(files[kind], tensors, kind)
        _set_random_state(files["random"])
    except CheckpointError as error:
        raise CheckpointError(f"checkpoint {folder} {error}") from error
    drape.load_state_dict(files["drape"])
    averaged.load_state_dict(files["drape"] | files["average"])
    for kind, tensors in own.items():
        for name, tensor in tensors.items():
            tensor.copy_(files[kind][name])
    optimiser.steps.fill_(state["step"])
    best = None
    if state["best"]:
        tensors = {name: tensor.to(parameters[name].device) for name, tensor in files["best"].items()}
        best = BestModel(state["best"]["step"], state["best"]["energy_j"], tensors)
    return Progress(state["step"], best, state.get("started_from"))


def load_drape(folder: Path, drape: Drape) -> dict:
    """Take over networks and skinning weights alone, whatever the run's configuration was: the best that the run kept,
    or where it kept none yet the moving average.

    Returns plain data on that run: its configuration, the `step` they are of and `started_from`. Raises CheckpointError
    when the files cannot be read or are of another garment, another body or other sizes.
    """
    try:
        state = _read_state(folder)
        tensors = _read_tensors(folder, "drape")
        _check_same_model(tensors, drape)
        file = "best" if state["best"] else "average"
        learnt = _read_tensors(folder, file)
        _check_fit(learnt, dict(drape.named_parameters()), file)
    except CheckpointError as error:
        raise CheckpointError(f"cannot start from checkpoint {folder}: {error}") from error
    drape.load_state_dict(tensors | learnt)
    run = state["config"] | {"step": state["best"]["step"] if state["best"] else state["step"]}
    return run | ({"started_from": state["started_from"]} if state.get("started_from") else {})


def checkpoint_step(folder: Path) -> int | None:
    """The step a checkpoint is of, also where a save was interrupted; None where there is none that can be read."""
    try:
        return _read_state(folder)["step"]
    except CheckpointError:
        return None


def saved_steps(folder: Path) -> int:
    """How many steps the run of a checkpoint takes in all. Raises CheckpointError when the file cannot be read."""
    steps = (_read_state(folder)["config"].get("optimisation") or {}).get("steps")
    if type(steps) is not int or steps < 1:
        raise CheckpointError(f"cannot read checkpoint {folder}: its configuration has {steps!r} optimisation.steps")
    return steps


def _optimiser_tensors(optimiser: Soap, drape: Drape) -> dict[str, dict[str, torch.Tensor]]:
    """The optimiser's state by kind and name of the parameter."""
    states = {name: optimiser.state[parameter] for name, parameter in drape.named_parameters()}
    return {kind: {name: state[kind] for name, state in states.items() if kind in state} for kind in OPTIMISER_FILES}


def _sibling(folder: Path, suffix: str) -> Path:
    return folder.with_name(f"{folder.name}.{suffix}")


def _complete(folder: Path) -> Path:
    """The folder, or what an interrupted save had just moved aside."""
    folder = folder.resolve()
    previous = _sibling(folder, "previous")
    return previous if not folder.exists() and previous.exists() else folder


def _refuse_other_files(folder: Path) -> None:
    own = {"state.json", *(f"{name}.safetensors" for name in TENSOR_FILES)}
    others = sorted(path.name for path in folder.iterdir() if path.name not in own) if folder.exists() else []
    if others:
        raise CheckpointError(f"{folder} holds {', '.join(others)}; a checkpoint needs a folder of its own")


def _save(tensors: Mapping[str, torch.Tensor], path: Path) -> None:
    save_file({name: tensor.detach().contiguous() for name, tensor in tensors.items()}, path)


def _read_state(folder: Path) -> dict:
    try:
        state = json.loads((_complete(folder) / "state.json").read_text())
    except (OSError, ValueError) as error:
        raise CheckpointError(f"cannot read checkpoint {folder}: {error}") from error
    state = state if isinstance(state, dict) else {}
    step, config = state.get("step"), state.get("config")
    if type(step) is not int or step < 0 or not isinstance(config, dict):
        raise CheckpointError(
            f"cannot read checkpoint {folder}: state.json needs a step of at least 0 and a config table, "
            f"got {step!r} and {config!r}"
        )
    best = state.setdefault("best", None)
    if best is not None and not (
        isinstance(best, dict) and type(best.get("step")) is int and type(best.get("energy_j")) is float
    ):
        raise CheckpointError(
            f"cannot read checkpoint {folder}: state.json needs best to be null or have step and energy_j, got {best!r}"
        )
    return state


def _read_tensors(folder: Path, name: str) -> dict[str, torch.Tensor]:
    try:
        return load_file(_complete(folder) / f"{name}.safetensors")
    except Exception as error:  # safetensors raises errors of its own, OSError and ValueError
        raise CheckpointError(f"cannot read checkpoint {folder}: {name}.safetensors: {error}") from error


def _check_same_model(tensors: dict, drape: Drape) -> None:
    """Sizes must fit, and what is given (mesh, garment nodes, body, joint limits) must be the drape's own."""
    _check_fit(tensors, drape.state_dict(), "drape")
    fixed = {name: buffer.cpu() for name, buffer in drape.named_buffers() if name not in OWN_BUFFERS}
    differing = [
        name for name, own in fixed.items() if not torch.allclose(tensors[name].to(own.dtype), own, rtol=0, atol=SAME)
    ]
    if differing:
        raise CheckpointError(f"is of another garment, body or garment nodes: {', '.join(differing)} differ")


def _check_fit(tensors: Mapping, expected: Mapping, file: str) -> None:
    if odd := sorted(set(tensors) ^ set(expected)):
        raise CheckpointError(f"does not fit the model: {file}.safetensors has too much or lacks {', '.join(odd)}")
    for name, tensor in tensors.items():
        if tensor.shape != expected[name].shape:
            raise CheckpointError(
                f"does not fit the model: {file}.safetensors has {name} of shape {tuple(tensor.shape)}, "
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

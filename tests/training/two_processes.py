"""What each of two processes does in test_processes, started by torchrun: a small run, and what came of it as files."""

from __future__ import annotations

import sys
from pathlib import Path

import torch
import warp as wp
from safetensors.torch import save_file
from training.small_runs import run, small_config

from physkin_training.config import TrainingConfig
from physkin_training.train import trainer as training
from physkin_training.train.processes import join, leave
from physkin_training.train.trainer import Trainer


def config(folder: Path) -> TrainingConfig:
    """Two bodies for each, whose cloth bends as the reference material: each process draws that by itself."""
    return small_config(folder, bodies=4, samples=8, other_bending=0.0)


def main(folder: Path) -> None:
    wp.config.quiet = True
    training.LARGEST_GRADIENT = 1e9  # so that gradients are told as they are
    processes, device = join("cpu")

    def report(name: str, tensors: dict[str, torch.Tensor]) -> None:
        copies = {key: tensor.detach().clone().contiguous() for key, tensor in tensors.items()}
        save_file(copies, folder / f"{name}{processes.rank}.safetensors")

    trainer = Trainer(config(folder), device, processes=processes)
    trainer.save(folder / "start")
    original, drawn = trainer.draw, []

    def draw():
        drawn.append(original())
        return drawn[-1]

    trainer.draw = draw
    run(trainer, 1)
    report("drawn", {str(index): tensor for index, tensor in enumerate(drawn[0])})
    report("gradient", {name: parameter.grad for name, parameter in trainer.drape.named_parameters()})
    report("energies", {"mean": torch.tensor(list(trainer.mean_energies().values()))})
    run(trainer, 5)
    trainer.save(folder / "middle")
    run(trainer, 6)
    report("end", trainer.drape.state_dict())
    report("best", trainer.best.parameters | {"step": torch.tensor(trainer.best.step)})

    resumed = Trainer(config(folder), device, processes=processes)
    resumed.resume(folder / "middle")
    run(resumed, 6)
    report("resumed", resumed.drape.state_dict())
    flags = processes.any(False, processes.rank == 1, True)
    report("flags", {"any": torch.tensor(flags)})
    leave()


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""Meshes of one's own among the garments of the page: `physkin fit-garment` makes a model of each, in a process of its
own, and trains it on while the page shows it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from physkin_core.mesh.mesh_file import SUFFIXES
from physkin_core.model.model_file import split_fabric

__all__ = ["OwnMeshes"]

PATTERN_SUFFIX = ".json"
LOOK_EVERY = 0.2
"""[s] From one look for the first model to the next."""
ENDS_WITHIN = 60.0
"""[s] In which training writes its checkpoint."""
KINDNESS = 10
"""Training gives way to the page."""


class OwnMeshes:
    """garments: as given, but with model files `NAME.safetensors` of the working folder in place of meshes and sewing
    patterns. A model that is there already is left alone; another one is made first, and gets better until `close`.

    garments: names, each with a fabric behind it or not. made_on: options of `physkin fit-garment` on the avatar that
    the meshes lie on. Raises ValueError when a mesh is refused; the command has then said why.
    """

    def __init__(self, garments: Sequence[str], made_on: Sequence[str]) -> None:
        self._trained: dict[Path, subprocess.Popen] = {}
        self.garments = []
        try:
            for name in garments:
                file, fabric = split_fabric(name)
                mesh = Path(file)
                if mesh.suffix.lower() in (*SUFFIXES, PATTERN_SUFFIX):
                    file = str(self._model_of(mesh, made_on))
                self.garments.append(f"{file}:{fabric}" if fabric else file)
        except BaseException:
            self.close()
            raise

    def _model_of(self, mesh: Path, made_on: Sequence[str]) -> Path:
        """The model's file, once it is there."""
        model = Path(f"{mesh.stem}.safetensors")
        again = f"physkin {' '.join(_command(mesh, model, made_on))} --resume"
        if model.exists():
            print(f"{model} of {mesh} exists already and is worn; to train it further: {again}", flush=True)
            return model
        program = [sys.executable, "-m", "physkin_core.cli", *_command(mesh, model, made_on)]
        trained = self._trained[mesh] = subprocess.Popen(program, start_new_session=True)
        os.setpriority(os.PRIO_PROCESS, trained.pid, KINDNESS)
        while not model.exists():
            if trained.poll() is not None:
                raise ValueError(f"{mesh} cannot be worn: physkin fit-garment ended with status {trained.returncode}")
            time.sleep(LOOK_EVERY)
        print(f"{mesh} is trained while this command runs; to continue later: {again}", flush=True)
        return model

    def close(self) -> None:
        """End training; it writes checkpoints."""
        running = [trained for trained in self._trained.values() if trained.poll() is None]
        for trained in running:
            trained.send_signal(signal.SIGINT)
        for trained in running:
            try:
                trained.wait(ENDS_WITHIN)
            except subprocess.TimeoutExpired:
                trained.kill()


def _command(mesh: Path, model: Path, made_on: Sequence[str]) -> list[str]:
    return ["fit-garment", str(mesh), "-o", str(model), *made_on]

"""`physkin simulate GARMENT --dynamic`: simulate cloth with inertia, on several bodies in several scenes at once."""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.model_file import load_garment_model
from physkin_core.progress import progress_line
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP, resolve_device
from physkin_training.dynamics.dynamic_simulation import DynamicSimulation
from physkin_training.dynamics.reference import Reference, rounded, save_reference
from physkin_training.dynamics.scenes import ROOT_SCENES, load_scene
from physkin_training.sampling.chosen_bodies import bodies_by_girth

__all__ = ["main"]

DEFAULT_SCENES = ("walk", "run", "dance", "jump", "kick", "cartwheel", *ROOT_SCENES)


def main(argv: list[str]) -> int:
    """Command line. Raises ValueError or OSError for bad input."""
    options = _parser().parse_args(argv)
    if options.steps < 1:
        raise ValueError(f"--steps must be at least 1, got {options.steps}")
    model, body_model = load_garment_model(options.garment), load_body_model()
    scenes = [load_scene(name, model.rig, seconds=options.seconds) for name in options.scenes]
    bodies = body_model.held_out_bodies[bodies_by_girth(body_model, options.bodies)]
    device = resolve_device(options.device)
    if device.type == "cpu":
        torch.set_num_threads(1)  # vectors are short: more threads would only wait for each other
    began = time.monotonic()
    simulation = DynamicSimulation(
        model, body_model, bodies, scenes, device, steps=options.steps, held_above=options.held_above
    )
    line, frames = progress_line(f"simulating {model.name}"), []

    def keep(frame: int, vertices: torch.Tensor) -> None:
        frames.append(rounded(vertices.cpu().numpy()))
        line((frame + 1) / simulation.frame_count)

    simulation.run(keep)
    options.output.mkdir(parents=True, exist_ok=True)
    vertices = np.stack(frames, axis=1).reshape(len(bodies), len(scenes), simulation.frame_count, -1, 3)
    lost_at = simulation.lost_at.cpu().numpy().reshape(len(bodies), len(scenes))
    for k, scene in enumerate(scenes):
        reference = Reference(model.name, scene, bodies, vertices[:, k], lost_at[:, k])
        save_reference(reference, options.output / f"{model.name}_{scene.name}.npz")
    lost = int((lost_at < simulation.frame_count).sum())
    print(
        f"{simulation.frame_count} frames of {lost_at.size} samples, {lost} of them lost, "
        f"in {time.monotonic() - began:.0f} s"
    )
    return 0


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="physkin simulate --dynamic", description=__doc__.split("`: ", 1)[1].splitlines()[0]
    )
    parser.add_argument("garment", help="garment model file, or the name of a shipped one")
    parser.add_argument("--dynamic", action="store_true", required=True, help="let the cloth move through time")
    parser.add_argument(
        "--scenes",
        nargs="+",
        default=DEFAULT_SCENES,
        metavar="SCENE",
        help=f"clips (CLIP@SECONDS begins there), or {', '.join(ROOT_SCENES)} (default: %(default)s)",
    )
    parser.add_argument("--seconds", type=float, default=5.5, help="length of every scene (default %(default)s)")
    parser.add_argument(
        "--bodies", type=int, default=3, help="held-out bodies, from lean to stout (default %(default)s)"
    )
    parser.add_argument(
        "--steps", type=int, default=8, help="steps of implicit Euler in each frame (default %(default)s)"
    )
    parser.add_argument(
        "--held-above",
        type=float,
        default=float("inf"),
        metavar="Z",
        help="vertices above this height of the canonical pose [m], such as a bodice, stay as the model drapes them",
    )
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    parser.add_argument(
        "-o", "--output", type=Path, required=True, help="folder to write; each scene is a file GARMENT_SCENE.npz"
    )
    return parser

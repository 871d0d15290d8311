"""`physkin simulate GARMENT --dynamic`: simulate cloth with inertia, on several bodies in several scenes at once."""

from __future__ import annotations

import argparse
import sys
import time
from dataclasses import asdict, fields
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.motion import Motion
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP, resolve_device
from physkin_training.dynamics.dynamic_simulation import TOLERANCE, DynamicSimulation, Frame
from physkin_training.dynamics.reference import Reference, save_reference, spread, swinging_vertices
from physkin_training.dynamics.scenes import ACTED_SCENES, ROOT_SCENES, load_scene
from physkin_training.energies.motion import Dynamics
from physkin_training.sampling.chosen_bodies import bodies_by_girth

__all__ = ["main"]

DEFAULT_SCENES = ("walk", "run", "dance", "jump", "kick", "cartwheel", *ROOT_SCENES, *ACTED_SCENES)


def main(argv: list[str]) -> int:
    """Command line entry, argv with or without `--dynamic`. Returns 0, or 2 after an error."""
    options = _parser().parse_args(argv)
    try:
        return _simulate(options)
    except (ValueError, OSError) as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


DYNAMICS = {
    "air_drag": "deceleration of cloth over its speed through still air [1/s]",
    "relaxation": "viscosity of the membrane over its stiffness [s]",
}
"""What its fields are, for --help."""


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
        help=f"clips (CLIP@SECONDS begins there), or {', '.join((*ROOT_SCENES, *ACTED_SCENES))} (default: %(default)s)",
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
    for entry in fields(Dynamics):
        name = "--" + entry.name.replace("_", "-")
        parser.add_argument(
            name, type=float, default=entry.default, metavar="X", help=f"{DYNAMICS[entry.name]} (default %(default)s)"
        )
    parser.add_argument(
        "--tolerance",
        type=float,
        default=TOLERANCE,
        help="force that may be left, over the weight of the garment (default %(default)s)",
    )
    parser.add_argument("--iterations", type=int, default=3, help="Newton steps in each step (default %(default)s)")
    parser.add_argument(
        "--products", type=int, default=48, help="matrix products in each Newton step (default %(default)s)"
    )
    parser.add_argument("--points", type=int, default=96, help="vertices to write in every frame (default %(default)s)")
    parser.add_argument(
        "--whole", type=int, default=30, help="write the whole garment every so many frames (default %(default)s)"
    )
    parser.add_argument(
        "--minutes", type=float, default=float("inf"), help="stop after so many minutes and write what is done"
    )
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    parser.add_argument(
        "-o", "--output", type=Path, required=True, help="folder to write; each scene is a file GARMENT_SCENE.npz"
    )
    return parser


def _simulate(options: argparse.Namespace) -> int:
    for name in ("steps", "iterations", "products", "points", "whole"):
        if getattr(options, name) < 1:
            raise ValueError(f"--{name} must be at least 1, got {getattr(options, name)}")
    if not (options.tolerance > 0 and options.minutes > 0):
        raise ValueError(f"tolerance {options.tolerance} and minutes {options.minutes} must be above 0")
    model, body_model = load_garment_model(options.garment), load_body_model()
    dynamics = Dynamics(**{entry.name: getattr(options, entry.name) for entry in fields(Dynamics)})
    scenes = [load_scene(name, model.rig, seconds=options.seconds) for name in options.scenes]
    bodies = body_model.held_out_bodies[bodies_by_girth(body_model, options.bodies)]
    device = resolve_device(options.device)
    if device.type == "cpu":
        torch.set_num_threads(1)  # vectors are short: more threads would only wait for each other
    began = time.monotonic()
    simulation = DynamicSimulation(
        *(model, body_model, bodies, scenes, device),
        steps=options.steps,
        dynamics=dynamics,
        held_above=options.held_above,
    )
    swinging = swinging_vertices(model.garment, model.rig)
    chosen = swinging[spread(model.garment.vertices[swinging], options.points)]
    recording = Recording(simulation, chosen, whole=options.whole)
    simulation.run(
        recording,
        tolerance=options.tolerance,
        iterations=options.iterations,
        products=options.products,
        seconds=60 * options.minutes - (time.monotonic() - began),
    )
    options.output.mkdir(parents=True, exist_ok=True)
    described = asdict(dynamics) | {"step_s": simulation.step, "tolerance": options.tolerance}
    described |= {"fit": simulation.dressed.fit}
    described |= {"held_above_m": options.held_above} if np.isfinite(options.held_above) else {}
    for reference in recording.references(scenes, bodies, described):
        save_reference(reference, options.output / f"{model.name}_{reference.motion.name}.npz")
    print(recording.report(time.monotonic() - began))
    return 0


class Recording:
    """Keeps of each frame what references hold, and says on the way how far the simulation is."""

    def __init__(self, simulation: DynamicSimulation, vertices: np.ndarray, *, whole: int) -> None:
        self.simulation, self.vertices, self.whole_every = simulation, vertices, whole
        self._index = torch.as_tensor(vertices, device=simulation.device)
        self._scenes = simulation.samples // len(simulation.dressed.body_set)
        middle = len(simulation.dressed.body_set) // 2
        self._of_middle = slice(middle * self._scenes, (middle + 1) * self._scenes)
        self.points: list[np.ndarray] = []
        self.whole: dict[int, np.ndarray] = {}
        self.energies: list[dict[str, np.ndarray]] = []
        self.residual: list[np.ndarray] = []
        self.iterations = 0

    def __call__(self, frame: Frame) -> None:
        self.points.append(frame.vertices[:, self._index].cpu().numpy())
        self.energies.append({name: values.cpu().numpy() for name, values in frame.energies.items()})
        if frame.index % self.whole_every == 0:
            self.whole[frame.index] = frame.vertices[self._of_middle].cpu().numpy()
        self.residual.append(frame.gradient_norm.cpu().numpy() / self.simulation.force_scale)
        self.iterations += int(frame.iterations.max())
        if frame.index % 10 == 0:
            print(
                f"frame {frame.index} of {self.simulation.frame_count}: Newton steps {frame.iterations.tolist()}, "
                f"residual / weight up to {self.residual[-1].max():.1e}",
                flush=True,
            )

    def references(self, scenes: list[Motion], bodies: np.ndarray, described: dict) -> list[Reference]:
        """One a scene, of the frames that there are."""
        frames = len(self.points)
        found = self.simulation.lost_at.clamp_max(frames).cpu().numpy()
        by_sample = np.stack(self.points, axis=1)
        for points, count in zip(by_sample, found):
            points[count:] = 0
        energies = {name: np.stack([each[name] for each in self.energies], axis=1) for name in self.energies[0]}
        results = []
        for k, scene in enumerate(scenes):
            motion = Motion(
                scene.joint_names,
                *(a[:frames] for a in (scene.positions, scene.root_orientation, scene.root_position)),
                scene.rate_hz,
                scene.name,
            )
            of_scene = slice(k, None, self._scenes)
            results.append(
                Reference(
                    self.simulation.model.name,
                    motion,
                    bodies,
                    self.vertices,
                    by_sample[of_scene],
                    found[of_scene],
                    {name: values[of_scene] for name, values in energies.items()},
                    len(bodies) // 2,
                    np.array(kept := [index for index in sorted(self.whole) if index < found[self._of_middle][k]]),
                    np.stack([self.whole[index][k] for index in kept]),
                    described,
                )
            )
        return results

    def report(self, seconds: float) -> str:
        residual = np.stack(self.residual)
        lost = int((self.simulation.lost_at < len(self.points)).sum())
        middle, high = np.nanquantile(residual, (0.5, 0.99))
        return (
            f"{len(self.points)} frames of {self.simulation.samples} samples, {lost} of them lost, in {seconds:.0f} s; "
            f"{self.iterations} Newton steps one after the other; residual / weight {middle:.1e} median, {high:.1e} "
            f"99th percentile"
        )


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))

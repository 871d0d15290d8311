"""Cross-check of the full-space solver against another project's: cloth of PyPI `newton`, made quasi-static by damping.

`PYTHONPATH=training python -m physkin_studies.crosscheck GARMENT` drapes one garment on the body the shipped garments
were made on, at one pose, with both solvers from the same start. Newton's vertex block descent has other elastic laws;
they are given the same stiffness at small strain:

- membrane: stable neo-Hookean with the Lame parameters of our St. Venant-Kirchhoff membrane (plane stress);
- bending: 1/2 k l0 (theta - theta0)^2 an edge, with k = 6 B l0 / (A1 + A2) from our B 3 l0^2 / (A1 + A2) (...)^2;
- contact: a spring a vertex, at the mean vertex's stiffness 2 k A, within a particle radius that is our contact offset;
  no friction, no self-contact.

Newton's cloth has no band and touches all of the body, so ours is compared with neither band nor worn parts. What these
make of it, which training and `physkin simulate` have, is a drape by itself.

Dimensions: `n` garment vertices, `V` body vertices. Metres.
"""

from __future__ import annotations

import argparse
import importlib.util
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import torch
from tabulate import tabulate

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment import Garment, load_garment
from physkin_core.model.garment_model import Material
from physkin_core.motion.loading import load_motion
from physkin_core.quality import area_strain, edge_strain
from physkin_core.runtime.draper import UPRIGHT_GRAVITY
from physkin_training.evaluate.plain_model import plain_model
from physkin_training.evaluate.simulate import DrapeSimulation, Poses
from physkin_training.physics.full_space_solver import Solution
from physkin_training.physics.rest_data import GRAVITY, hinge_rest
from physkin_training.physics.wearing import Wearing

__all__ = ["Drape", "NewtonDrape", "newton_drape", "surface_distance", "table"]

STEP_S = 1 / 600
SWEEPS = 10
"""Iterations of vertex block descent a time step; fewer, or longer steps, let cloth stretch as it falls, and slip
through the body."""
KEPT_VELOCITY = 0.98
"""Share of the velocity left after a time step."""
SLOW = 2e-3
"""[m/s] the fastest vertex of cloth at rest."""


@dataclass(frozen=True)
class NewtonDrape:
    """Vertices (n, 3) [m] where newton came to rest, time steps taken, and speed [m/s] of the fastest vertex there."""

    vertices: np.ndarray
    steps: int
    speed: float


@dataclass(frozen=True)
class Drape:
    """Vertices (n, 3) [m], energies (1,) [J] by term, and seconds of the clock and of the processor."""

    vertices: np.ndarray
    energies: dict[str, torch.Tensor]
    seconds: tuple[float, float]


def newton_drape(
    garment: Garment,
    material: Material,
    start: np.ndarray,
    body_vertices: np.ndarray,
    body_faces: np.ndarray,
    gravity: np.ndarray,
    *,
    steps: int = 2000,
    device: str = "cpu",
) -> NewtonDrape:
    """Let the garment settle from start (n, 3) on the body (V, 3) under the direction `gravity` (3,)."""
    import newton
    import warp as wp

    def lists(array: np.ndarray) -> list:
        return [wp.vec3(*map(float, row)) for row in array]

    mu = material.youngs_modulus / (2 * (1 + material.poisson_ratio))
    lam = material.youngs_modulus * material.poisson_ratio / (1 - material.poisson_ratio**2)
    spring = 2 * material.contact_stiffness * float(garment.vertex_areas.mean())
    builder = newton.ModelBuilder(gravity=tuple(float(GRAVITY * value) for value in gravity))
    builder.add_cloth_mesh(
        pos=wp.vec3(0.0, 0.0, 0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0, 0.0, 0.0),
        vertices=lists(garment.vertices),
        indices=garment.faces.reshape(-1).tolist(),
        density=material.density,
        tri_ke=mu,
        tri_ka=lam,
        tri_kd=0.0,
        edge_ke=1.0,
        edge_kd=0.0,
        particle_radius=material.contact_offset,
    )
    contact = newton.ModelBuilder.ShapeConfig(ke=spring, kd=0.0, mu=0.0)
    builder.add_shape_mesh(-1, mesh=newton.Mesh(body_vertices, body_faces.reshape(-1)), cfg=contact)
    builder.color(include_bending=True)
    model = builder.finalize(device=device)
    model.soft_contact_ke, model.soft_contact_kd, model.soft_contact_mu = spring, 0.0, 0.0
    _set_bending(model, garment, material)
    solver = newton.solvers.SolverVBD(model=model, iterations=SWEEPS)
    pipeline = newton.CollisionPipeline(model, soft_contact_gap=0.01)
    contacts, control = pipeline.contacts(), model.control()
    state, other = model.state(), model.state()
    state.particle_q.assign(np.asarray(start, dtype=np.float32))
    speed, taken = np.inf, 0
    while taken < steps and speed > SLOW:
        state.clear_forces()
        pipeline.collide(state, contacts)
        solver.step(state, other, control, contacts, STEP_S)
        state, other = other, state
        velocity = state.particle_qd.numpy()
        speed = float(np.linalg.norm(velocity, axis=1).max())
        state.particle_qd.assign(KEPT_VELOCITY * velocity)
        taken += 1
    return NewtonDrape(state.particle_q.numpy().astype(np.float64), taken, speed)


def _set_bending(model, garment: Garment, material: Material) -> None:
    """Stiffness of every interior edge; boundary edges have no hinge and bend freely."""
    _, factor = hinge_rest(garment)
    length = np.linalg.norm(np.diff(garment.vertices[garment.hinges[:, :2]], axis=1)[:, 0], axis=1)
    stiffness = {
        tuple(sorted(ends)): 2 * material.bending * value
        for ends, value in zip(garment.hinges[:, :2].tolist(), (factor / length).tolist(), strict=True)
    }
    properties = model.edge_bending_properties.numpy()
    ends = np.sort(model.edge_indices.numpy()[:, 2:], axis=1).tolist()
    properties[:, 0] = [stiffness.get(tuple(pair), 0.0) for pair in ends]
    model.edge_bending_properties.assign(properties)


def surface_distance(garment: Garment, first: np.ndarray, second: np.ndarray) -> tuple[float, float]:
    """Mean and largest distance [m] of the vertices of either drape (n, 3) from the surface of the other (the larger of
    the two directions: Hausdorff's)."""
    import trimesh

    pairs = ((first, second), (second, first))
    distances = [
        trimesh.proximity.closest_point(trimesh.Trimesh(1000 * surface, garment.faces, process=False), 1000 * points)[1]
        for points, surface in pairs
    ]
    return max(float(d.mean()) for d in distances) / 1000, max(float(d.max()) for d in distances) / 1000


def table(garment: Garment, drapes: dict[str, Drape]) -> str:
    """Markdown table of drapes by name, one row each; all have the same terms of energy."""
    terms = next(iter(drapes.values())).energies
    head = ["", "seconds", "CPU seconds", "edge %", "area %", *(f"{name} J" for name in terms), "total J"]
    rows = []
    for name, drape in drapes.items():
        strain = [function(garment, drape.vertices) for function in (edge_strain, area_strain)]
        energies = [float(values[0]) for values in drape.energies.values()]
        numbers = [*(f"{value:.1f}" for value in drape.seconds), *(f"{float(value):.3f}" for value in strain)]
        rows.append([name, *numbers, *(f"{value:.4f}" for value in [*energies, sum(energies)])])
    return tabulate(rows, head, tablefmt="github", disable_numparse=True)


def main(argv: list[str] | None = None) -> int:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("garment", type=Path)
    parser.add_argument("--motion", help="bundled motion or a motion file (default: the canonical pose)")
    parser.add_argument("--frame", type=int, default=0)
    parser.add_argument("--steps", type=int, default=2000, help="time steps of newton at most (default %(default)s)")
    parser.add_argument("-o", "--output", type=Path, metavar="NPZ", help="write the drapes and the body")
    options = parser.parse_args(argv)
    if importlib.util.find_spec("newton") is None:
        print("error: compares with newton, which is not installed: pip install newton", file=sys.stderr)
        return 2
    torch.set_num_threads(1)  # as many as the kernels of either solver use on a CPU
    body_model, material = load_body_model(), Material()
    garment, model = load_garment(options.garment), plain_model(options.garment)
    poses = Poses(model.rig.rest[None].copy(), np.array(UPRIGHT_GRAVITY)[None])
    if options.motion:
        motion = load_motion(options.motion)
        positions = motion.positions_for(model.rig)[[options.frame]].astype(np.float64)
        poses = Poses(positions, motion.gravity[[options.frame]])
    avatar, cpu = avatar_from_body(body_model, body_model.garment_body), torch.device("cpu")
    simulation = DrapeSimulation(garment, avatar, model, material, 1, cpu)
    wearing = Wearing.on(garment, avatar, model.rig)
    worn_simulation = DrapeSimulation(garment, avatar, model, material, 1, cpu, wearing=wearing)
    rough = simulation.run(poses, stages=8 if options.motion else 0, tolerance=0.1, iterations=15)
    start = rough.vertices.double().numpy()

    def minimised(by: DrapeSimulation, start: np.ndarray) -> tuple[Drape, Solution]:
        result, seconds = _timed(lambda: by.run_from(start, poses))
        return Drape(result.vertices[0].double().numpy(), result.energies, seconds), result

    ours, solution = minimised(simulation, start)
    settled, seconds = _timed(
        lambda: newton_drape(
            garment,
            material,
            start[0],
            simulation.body.vertices[0].cpu().numpy(),
            avatar.faces,
            poses.gravity[0],
            steps=options.steps,
        )
    )
    drapes = {
        "ours": ours,
        "newton": Drape(settled.vertices, simulation.energies(settled.vertices[None], poses), seconds),
        "ours, from newton's": minimised(simulation, settled.vertices[None])[0],
        "ours, band and worn parts": minimised(worn_simulation, start)[0],
    }
    print(table(garment, drapes) + "\n")
    for first, second in (
        ("ours", "newton"),
        ("ours, from newton's", "newton"),
        ("ours, band and worn parts", "ours"),
        ("ours, band and worn parts", "newton"),
    ):
        mean, largest = surface_distance(garment, drapes[first].vertices, drapes[second].vertices)
        print(f"surfaces of {first} | {second}: mean {1000 * mean:.2f} mm, Hausdorff {1000 * largest:.2f} mm apart")
    residual = float(solution.gradient_norm) / solution.force_scale
    print(
        f"ours: {int(solution.iterations)} iterations, residual / weight {residual:.4f}; "
        f"newton: {settled.steps} steps of {1000 * STEP_S:.1f} ms, fastest vertex {1000 * settled.speed:.1f} mm/s"
    )
    if options.output:
        vertices = {name: drape.vertices for name, drape in drapes.items()}
        body = simulation.body.vertices[0].cpu().numpy()
        np.savez_compressed(options.output, faces=garment.faces, body=body, body_faces=avatar.faces, **vertices)
    return 0


def _timed(work: Callable[[], Any]) -> tuple[Any, tuple[float, float]]:
    """What the work returns, and its seconds of the clock and of the processor."""
    clock, processor = time.perf_counter(), time.process_time()
    result = work()
    return result, (time.perf_counter() - clock, time.process_time() - processor)


if __name__ == "__main__":
    raise SystemExit(main())

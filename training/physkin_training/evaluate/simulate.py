"""`physkin simulate`: drape a garment on an avatar by minimising the energy that training minimises.

The minimum over all vertices is what a trained garment is measured against, and shows what a mesh is worth before it is
trained. Dimensions: `B` poses, `n` garment vertices, `d` degrees of freedom.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path
from typing import get_args

import numpy as np
import torch
from scipy.spatial import cKDTree
from tabulate import tabulate

from physkin_core.avatar.avatar import Avatar, avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment import Garment, load_garment
from physkin_core.model.garment_model import GarmentModel, Material, RestAngles
from physkin_core.model.model_file import load_garment_model
from physkin_core.motion.loading import load_motion
from physkin_core.outfit.draper import Draper
from physkin_core.outfit.outfit_options import (
    add_avatar_options,
    add_options,
    chosen_avatar,
    motion_settings,
    print_warnings,
)
from physkin_core.progress import progress_line
from physkin_core.quality import area_strain, edge_strain
from physkin_core.rig.rig import Rig
from physkin_core.runtime.frame_input import UPRIGHT_GRAVITY
from physkin_training.contact.wearing import Wearing
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP, resolve_device
from physkin_training.evaluate.plain_model import plain_model
from physkin_training.physics.full_space_solver import FullSpaceSolver
from physkin_training.physics.newton_solver import Solution
from physkin_training.physics.physics_losses import PhysicsLosses
from physkin_training.sampling.posed_bodies import posed_avatar

__all__ = ["DrapeSimulation", "command_parser", "main"]

REACH = 0.3
"""The body is looked for up to this distance [m]."""
STAGES = 8
"""Steps of the body from the canonical pose."""
ON_THE_WAY = {"tolerance": 0.1, "iterations": 15}
"""How well poses on the way from the canonical one are minimised."""
FARTHEST_CARRIED = 2.0
"""Offsets from plain skinning may grow by this factor at most as they are carried along."""
NOT_CONVERGED = 1
MOST_OF_IT, NEAR = 0.9, 0.03
"""Of the force that is left, by its square, and the distance [m] of skin that is named where it is."""


class DrapeSimulation:
    """One garment on one avatar, minimised at `samples` poses at once.

    start_model: the model whose drapes are started from; the garment may be another mesh of the same garment.
    wearing: what of the body counts as contact, and the band, as in training; None: all of the body, and no band.
    Raises ValueError when the model is for another rig than the avatar.
    """

    def __init__(
        self,
        garment: Garment,
        avatar: Avatar,
        start_model: GarmentModel,
        material: Material,
        samples: int,
        device: torch.device,
        *,
        wearing: Wearing | None = None,
    ) -> None:
        same = np.array_equal(garment.faces, start_model.garment.faces)
        self.garment, self.avatar, self.device = garment, avatar, device
        points = None if same else garment.vertices
        self._draper = Draper(start_model, avatar, precision="fp32", fit=0.0, points=points)  # as the mesh is
        self.rig = start_model.rig
        self.body = posed_avatar(avatar, self.rig, samples, device)
        self.losses = PhysicsLosses(garment, material, samples, device, wearing=wearing, reach=REACH)
        self.solver = FullSpaceSolver(self.losses)

    def run(
        self,
        positions: np.ndarray,
        gravity: np.ndarray,
        *,
        stages: int = 0,
        tolerance: float = 1e-2,
        iterations: int = 300,
    ) -> Solution:
        """Minimise at joint positions (B, d) [rad] under gravity (B, 3), a direction in the root frame.

        stages: 0 starts from the drapes of the start model at the poses themselves; otherwise the body is moved there
        from the canonical pose in so many steps, the garment being minimised roughly after each. From one to the next
        cloth is carried along as the start model's nodes move and turn it.
        """
        if stages < 0:
            raise ValueError(f"stages must be 0 or more, got {stages}")
        shares = np.linspace(0, 1, stages + 1) if stages else [1.0]
        carried = None
        for share in shares:
            at = self._partly(positions, gravity, share)
            skinned, turns = self._start(*at)
            place = skinned if carried is None else skinned + _turned_on(*carried, turns)
            self.body.pose(*self._tensors(at[0].copy()))
            options = ON_THE_WAY if share < 1 else {"tolerance": tolerance, "iterations": iterations}
            solution = self.solver.minimise(*self._tensors(place, at[1]), self.body.mesh, self.body.offset, **options)
            carried = solution.vertices.to(skinned) - skinned, turns
        return solution

    def force_left(self, result: Solution, gravity: np.ndarray) -> list[tuple[int, list[str]]]:
        """Of each drape, how few vertices have nine tenths of the force that is left, and the bones of the skin around
        them. gravity: (B, 3), as of the run before."""
        body = self.body
        _, gradients = self.losses.evaluate(result.vertices, *self._tensors(gravity), body.mesh, body.offset)
        bones, found = self.avatar.influence_bones[:, 0], []
        for gradient, cloth, skin in zip(gradients.cpu(), result.vertices.cpu(), body.vertices.cpu()):
            force = gradient.double().square().sum(dim=1).numpy()
            order = force.argsort()[::-1]
            few = int(np.searchsorted(np.cumsum(force[order]), MOST_OF_IT * force.sum())) + 1
            near = cKDTree(skin.numpy()).query_ball_point(cloth.numpy()[order[:few]], NEAR)
            around = {int(bone) for vertices in near for bone in bones[vertices]}
            found.append((few, [self.rig.bone_names[bone] for bone in sorted(around)]))
        return found

    def _partly(self, positions: np.ndarray, gravity: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
        """Joint positions and gravity at a share (0 to 1) of the way from the canonical pose."""
        if share == 1:
            return positions, gravity
        down = UPRIGHT_GRAVITY + share * (gravity - UPRIGHT_GRAVITY)
        length = np.linalg.norm(down, axis=1, keepdims=True)
        down = np.where(length > 0.1, down / np.maximum(length, 0.1), gravity)
        return self.rig.rest + share * (positions - self.rig.rest), down

    def _start(self, positions: np.ndarray, gravity: np.ndarray) -> tuple[torch.Tensor, torch.Tensor]:
        """Drapes (B, n, 3) of the start model, and how it turns the cloth about each vertex (B, n, 3, 3)."""
        bound = self._draper.bound
        drapes, turns = [], []
        for joints, down in zip(positions, gravity, strict=True):
            drapes.append(self._draper.drape(joints, down)[:, :3].astype(np.float64))
            linear = self._draper.node_transforms()[:, :, :3].astype(np.float64)
            turns.append(np.einsum("vk,vkij->vij", bound.influence_weights, linear[bound.influence_nodes]))
        return torch.as_tensor(np.stack(drapes)), torch.as_tensor(np.stack(turns))

    def _tensors(self, *arrays: np.ndarray) -> tuple[torch.Tensor, ...]:
        return tuple(torch.as_tensor(array, dtype=torch.float32, device=self.device) for array in arrays)


def _turned_on(offset: torch.Tensor, turned: torch.Tensor, now: torch.Tensor) -> torch.Tensor:
    """Offsets (B, n, 3) from plain skinning, turned with the cloth from how it was to how it is, (B, n, 3, 3) each."""
    local, _ = torch.linalg.solve_ex(turned, offset[..., None])
    carried = (now @ local)[..., 0]
    longest = FARTHEST_CARRIED * torch.linalg.vector_norm(offset, dim=-1)
    short = torch.linalg.vector_norm(carried, dim=-1) <= longest
    return torch.where(short[..., None], carried, offset)  # where blending has all but flattened the cloth


def main(argv: list[str] | None = None) -> int:
    """Command line: `physkin simulate GARMENT`. Returns 0, 1 when a drape did not converge. Raises ValueError or
    OSError for bad input."""
    arguments = sys.argv[1:] if argv is None else argv
    if "--dynamic" in arguments:
        from physkin_training.dynamics.command import main as simulate_dynamically

        return simulate_dynamically(arguments)
    return _simulate(command_parser().parse_args(arguments))


MATERIAL = {
    "youngs_modulus": "stiffness of the membrane [N/m]",
    "bending": "stiffness in bending [J]",
    "rest_angles": "whether cloth is flat at rest, or as its mesh lies",
}
"""Of its fields those that are options, and what they are."""


def command_parser() -> argparse.ArgumentParser:
    """Options of `physkin simulate`."""
    parser = argparse.ArgumentParser(prog="physkin simulate", description=__doc__.split("`: ", 1)[1].splitlines()[0])
    parser.add_argument("garment", type=Path, help="garment mesh (OBJ, PLY, STL), in the canonical pose")
    add_avatar_options(parser, made_on=True)
    add_options(parser, "source-rate")
    parser.add_argument("--motion", help="bundled motion or a motion file (default: the canonical pose)")
    parser.add_argument(
        "--frame", type=int, nargs="+", default=[0], metavar="K", help="frames of the motion (default 0)"
    )
    parser.add_argument(
        "--dynamic",
        action="store_true",
        help="let the cloth move through time; it has other options: physkin simulate --dynamic --help",
    )
    parser.add_argument("--start-from", metavar="MODEL", help="trained garment to start from (default: plain skinning)")
    for name, said in MATERIAL.items():
        kind = {"choices": get_args(RestAngles)} if name == "rest_angles" else {"type": float, "metavar": "X"}
        default, option = getattr(Material(), name), "--" + name.replace("_", "-")
        parser.add_argument(option, default=default, help=f"{said} (default %(default)s)", **kind)
    parser.add_argument(
        "--tolerance",
        type=float,
        default=1e-2,
        help="force that may be left, over the weight of the garment (default %(default)s)",
    )
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    parser.add_argument(
        "-o", "--output", type=Path, required=True, help=".obj or .ply (one frame), or .npz (any number)"
    )
    parser.add_argument("--picture", type=Path, metavar="PNG", help="picture of body and garment in all frames")
    return parser


def _simulate(options: argparse.Namespace) -> int:
    if not options.tolerance > 0:
        raise ValueError(f"--tolerance {options.tolerance} must be above 0")
    suffixes = (".obj", ".ply", ".npz") if len(options.frame) == 1 else (".npz",)
    if options.output.suffix.lower() not in suffixes:
        raise ValueError(f"cannot write {options.output}: the name must end in {' or '.join(suffixes)}")
    material = Material(**{name: getattr(options, name) for name in MATERIAL})
    garment = load_garment(options.garment)
    model = load_garment_model(options.start_from) if options.start_from else plain_model(garment)
    body_model = load_body_model()
    if options.avatar:
        avatar = chosen_avatar(options, model.rig)
    else:
        avatar = avatar_from_body(body_model, body_model.garment_body)
    print_warnings(avatar.warnings)
    positions, gravity = _poses(options, model.rig)
    device = resolve_device(options.device)
    if device.type == "cpu":
        torch.set_num_threads(1)  # vectors are short: more threads would only wait for each other
    began = time.perf_counter()
    wearing = Wearing.on(garment, avatar, model.rig)
    simulation = DrapeSimulation(garment, avatar, model, material, len(positions), device, wearing=wearing)
    result = simulation.run(positions, gravity, stages=0 if options.start_from else STAGES, tolerance=options.tolerance)
    seconds = time.perf_counter() - began
    vertices = result.vertices.double().cpu().numpy()
    print(report(garment, result))
    print(f"{seconds:.1f} s; force scale (the garment's weight) {result.force_scale:.3f} N")
    _write(options.output, garment, vertices, result)
    if options.picture:
        _draw(options.picture, avatar, garment, simulation.body.vertices.cpu().numpy(), vertices)
    if result.converged.all():
        return 0
    print(
        f"warning: {int((~result.converged).sum())} of {len(vertices)} drapes did not converge to a residual of "
        f"{options.tolerance} of the weight; where cloth is caught between body parts there may be no such drape",
        file=sys.stderr,
    )
    for drape, (few, bones) in enumerate(simulation.force_left(result, gravity)):
        if not result.converged[drape]:
            near = f"near {', '.join(bones)}" if bones else "away from the body"
            print(f"drape {drape}: nine tenths of the force that is left is at {few} vertices, {near}", file=sys.stderr)
    return NOT_CONVERGED


def _poses(options: argparse.Namespace, rig: Rig) -> tuple[np.ndarray, np.ndarray]:
    """Joint positions (B, d) [rad] and gravity (B, 3)."""
    if not options.motion:
        return rig.rest[None].copy(), np.array(UPRIGHT_GRAVITY)[None]
    watch = progress_line(f"reading {options.motion}")
    motion = load_motion(options.motion, **motion_settings(options), watch=watch)
    for frame in options.frame:
        if not 0 <= frame < motion.frame_count:
            raise ValueError(f"motion {options.motion} has frames 0 to {motion.frame_count - 1}, not {frame}")
    return motion.positions_for(rig)[options.frame].astype(np.float64), motion.gravity[options.frame]


def report(garment: Garment, result: Solution) -> str:
    """Markdown table of a solution, one row a drape."""
    vertices = result.vertices.double().cpu().numpy()
    columns = {
        "drape": range(len(vertices)),
        "iterations": result.iterations.tolist(),
        "residual / weight": (result.gradient_norm / result.force_scale).tolist(),
        "converged": ["yes" if flag else "NO" for flag in result.converged.tolist()],
        "edge %": edge_strain(garment, vertices),
        "area %": area_strain(garment, vertices),
        **{f"{name} J": values.tolist() for name, values in result.energies.items()},
    }
    return tabulate(columns, headers="keys", tablefmt="pipe", floatfmt=".4f")


def _write(path: Path, garment: Garment, vertices: np.ndarray, result: Solution) -> None:
    if path.suffix.lower() == ".npz":
        energies = {f"{name}_j": values.cpu().numpy() for name, values in result.energies.items()}
        np.savez_compressed(
            path,
            vertices=vertices.astype(np.float32),
            faces=garment.faces,
            converged=result.converged.cpu().numpy(),
            gradient_norm_n=result.gradient_norm.cpu().numpy(),
            **energies,
        )
        return
    import trimesh

    trimesh.Trimesh(vertices[0], garment.faces, process=False).export(path)


def _draw(path: Path, avatar: Avatar, garment: Garment, bodies: np.ndarray, drapes: np.ndarray) -> None:
    from physkin_core.pictures.picture import CLOTH_COLOUR, Mesh, contact_sheet, render, save_png
    from physkin_core.render.filming import avatar_mesh

    images = [
        render([avatar_mesh(avatar, body), Mesh(drape, garment.faces, CLOTH_COLOUR)], size=(600, 750))
        for body, drape in zip(bodies, drapes, strict=True)
    ]
    save_png(path, images[0] if len(images) == 1 else contact_sheet(images, columns=min(4, len(images))))

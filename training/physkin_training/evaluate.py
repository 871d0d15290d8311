"""Quality figures of a garment model on held-out bodies and uniform poses, beside plain skinning and the two minima.

`physkin evaluate MODEL` prints a table and writes JSON; deterministic for a seed on one kind of device.
Dimensions: `B` samples of a batch, `n` garment vertices, `m` garment nodes.
"""

from __future__ import annotations

import argparse
import copy
import json
import math
import sys
from collections.abc import Collection, Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import torch

from physkin_core.body_model import load_body_model
from physkin_core.garment_model import GarmentModel
from physkin_core.model_file import load_garment_model, save_garment_model
from physkin_core.rig import Rig
from physkin_training.devices import DEFAULT_DEVICE, resolve_device
from physkin_training.draping import Drape, compose_nodes, delta_transforms
from physkin_training.export import drape_from_model, encode_bodies
from physkin_training.full_space_solver import FullSpaceSolver
from physkin_training.minimum import subspace_minimum
from physkin_training.physics_losses import GRAVITY, Energies, PhysicsLosses
from physkin_training.posed_bodies import BodySet, PosedBodies

__all__ = ["Evaluation", "Figures"]

REACH = 0.3
"""Bodies are looked for up to this distance [m], beyond the deepest penetration."""
FEWER_INFLUENCES = 4
"""What skinning to so few influences, which most engines support, would cost is measured too."""
LARGEST_LIFT = 0.2
"""Mean rise [m] of the garment above plain skinning from which on it is taken to have left the body."""


class Figures:
    """Accumulates the quality figures over batches."""

    def __init__(self, garment, device: torch.device) -> None:
        self.garment = garment
        self.edges = torch.as_tensor(garment.edges.copy(), dtype=torch.int64, device=device)
        self.edge_lengths = torch.as_tensor(garment.edge_lengths.copy(), dtype=torch.float32, device=device)
        self.faces = torch.as_tensor(garment.faces.copy(), dtype=torch.int64, device=device)
        self.face_areas = torch.as_tensor(garment.face_areas.copy(), dtype=torch.float32, device=device)
        self.sums: dict[str, float] = {}
        self.samples = 0
        self.depths: list[torch.Tensor] = []

    def add(self, vertices: torch.Tensor, energies: Energies, *, count: int | None = None) -> None:
        """Count in the first `count` (default all) of a batch of drapes (B, n, 3)."""
        vertices = vertices[:count]
        ends = vertices[:, self.edges]
        length = torch.linalg.norm(ends[:, :, 1] - ends[:, :, 0], dim=-1)
        corners = vertices[:, self.faces]
        cross = torch.linalg.cross(corners[:, :, 1] - corners[:, :, 0], corners[:, :, 2] - corners[:, :, 0])
        area = torch.linalg.norm(cross, dim=-1) / 2
        distance = energies.signed_distance[:count]
        per_sample = {
            "edge_strain_percent": 100 * ((length - self.edge_lengths).abs() / self.edge_lengths).mean(dim=1),
            "area_strain_percent": 100 * ((area - self.face_areas).abs() / self.face_areas).mean(dim=1),
            "inside_percent": 100 * (distance < 0).float().mean(dim=1),
            "within_3mm_percent": 100 * (distance < 0.003).float().mean(dim=1),
            "stretch_j": energies.stretch[:count],
            "bend_j": energies.bend[:count],
            "collision_j": energies.collision[:count],
            "gravity_j": energies.gravity[:count],
        }
        for name, values in per_sample.items():
            self.sums[name] = self.sums.get(name, 0.0) + float(values.double().sum())
        self.depths.append((-distance).amax(dim=1).clamp_min(0))
        self.samples += len(vertices)

    def result(self) -> dict[str, float]:
        """Means over `pairs` samples; depths in mm: the deepest of all, and the 99.9th percentile of each sample's
        deepest."""
        depths = 1000 * torch.cat(self.depths)
        means = {name: value / self.samples for name, value in self.sums.items()}
        means["max_depth_mm"] = float(depths.max())
        means["max_depth_p999_mm"] = float(torch.quantile(depths, 0.999))
        means["energy_j"] = means["stretch_j"] + means["bend_j"] + means["collision_j"]
        return means | {"pairs": self.samples}


@dataclass(frozen=True)
class Batch:
    """One batch of held-out (body, pose) pairs, ready to drape. The first `count` count, the others only fill it up."""

    count: int
    posed_nodes: torch.Tensor
    modulation: torch.Tensor
    positions: torch.Tensor
    gravity: torch.Tensor


class Evaluation:
    """Held-out bodies and seeded poses for one garment model on one device.

    Raises ValueError when the model is for another rig than the body model's, or there are not so many bodies.
    """

    def __init__(
        self, model: GarmentModel, device: torch.device, *, bodies: int, poses: int, seed: int, batch: int = 64
    ) -> None:
        body_model = load_body_model()
        if not 1 <= bodies <= len(body_model.held_out_bodies):
            raise ValueError(f"bodies must be 1 to {len(body_model.held_out_bodies)}, got {bodies}")
        if poses < 1:
            raise ValueError(f"poses must be at least 1, got {poses}")
        if model.rig.to_json() != body_model.rig.to_json():
            difference = _difference(model.rig, body_model.rig)
            raise ValueError(f"garment model {model.name!r} is for another rig than the body model's: {difference}")
        self.model, self.device, self.poses, self.seed = model, device, poses, seed
        self.drape: Drape = drape_from_model(model).to(device).eval()
        self.bodies = BodySet(body_model, body_model.held_out_bodies[:bodies], device)
        self.batch = min(batch, bodies * poses)
        self.posed_bodies = PosedBodies(body_model, self.bodies, self.batch)
        self.losses = PhysicsLosses(model.garment, model.material, self.batch, device, reach=REACH)
        self.modulations = encode_bodies(self.drape, self.bodies.vertices.cpu().numpy(), body_model.faces)
        self.node_positions = self.drape.node_positions(self.bodies)

    def batches(self, *, upright: bool, count: int | None = None) -> Iterator[Batch]:
        """All pairs, or `count` pairs spread evenly over them, `self.batch` at a time: kernels keep their size, so a
        last partial batch is filled up with pairs that do not count."""
        generator = torch.Generator().manual_seed(self.seed)
        pairs = len(self.bodies) * self.poses
        rig = self.model.rig
        within = torch.rand(pairs, len(rig.lower), generator=generator)
        lower, upper = (torch.as_tensor(a.copy(), dtype=torch.float32) for a in (rig.lower, rig.upper))
        positions = lower + within * (upper - lower)
        tilt = torch.rand(pairs, generator=generator) * math.radians(110) * (0.0 if upright else 1.0)
        azimuth = torch.rand(pairs, generator=generator) * 2 * math.pi
        gravity = torch.stack([tilt.sin() * azimuth.cos(), tilt.sin() * azimuth.sin(), -tilt.cos()], dim=1)
        body = torch.arange(pairs) % len(self.bodies)
        chosen = torch.arange(pairs) if count is None else torch.linspace(0, pairs - 1, count).round().long()
        for start in range(0, len(chosen), self.batch):
            real = len(chosen[start : start + self.batch])
            pick = chosen[torch.arange(start, start + self.batch) % len(chosen)]
            q, g, b = (a[pick].to(self.device) for a in (positions, gravity, body))
            bones = self.posed_bodies.pose(q, b)
            posed_nodes = self.drape.posed_nodes(bones, self.node_positions[b])
            yield Batch(real, posed_nodes, self.modulations[b], q, g)

    def energy(self, vertices: torch.Tensor, batch: Batch) -> tuple[torch.Tensor, Energies]:
        """Mean energy and energies of drapes (B, n, 3) against the bodies of the batch posed last."""
        return self.losses(vertices, batch.gravity, self.posed_bodies.mesh, self.posed_bodies.offset)

    def figures(
        self, *, upright: bool, only: Collection[str] = ("model", "skinning", "fewer_influences")
    ) -> dict[str, dict[str, float]]:
        """The model, plain skinning, and the model with only the `FEWER_INFLUENCES` strongest influences a vertex
        (renormalised), over all pairs; of these rows, those named in `only`."""
        fewer = copy.deepcopy(self.drape)
        fewer.prune_influences(FEWER_INFLUENCES)
        drapes = {"model": self.drape, "skinning": self.drape, "fewer_influences": fewer}
        drapes = {name: drape for name, drape in drapes.items() if name in only}
        rows = {name: Figures(self.model.garment, self.device) for name in drapes}
        with torch.no_grad():
            for batch in self.batches(upright=upright):
                raw = self._raw(batch)
                for name, drape in drapes.items():
                    delta = delta_transforms(torch.zeros_like(raw) if name == "skinning" else raw)
                    vertices = drape.skin(compose_nodes(batch.posed_nodes, delta))
                    rows[name].add(vertices, self.energy(vertices, batch)[1], count=batch.count)
        return {name: figures.result() for name, figures in rows.items()}

    def minima(self, *, count: int, steps: int) -> dict[str, dict[str, float]]:
        """Model, subspace minimum and full-space minimum on `count` upright pairs (at most all of them).

        The full-space minimum starts from the lower of the other two. Minima also hold the mean `gradient_norm` at the
        end (see `Minimum`).
        """
        rows = {name: Figures(self.model.garment, self.device) for name in ("model", "subspace_minimum", "minimum")}
        solver = FullSpaceSolver(self.model.garment, self.losses, self.batch, self.device)
        norms: dict[str, list[float]] = {"subspace_minimum": [], "minimum": []}
        for batch in self.batches(upright=True, count=min(count, len(self.bodies) * self.poses)):

            def objective(vertices: torch.Tensor, batch: Batch = batch) -> torch.Tensor:
                return self.energy(vertices, batch)[0]

            with torch.no_grad():
                raw = self._raw(batch)
                own = self.drape.skin(compose_nodes(batch.posed_nodes, delta_transforms(raw)))
            subspace = subspace_minimum(objective, self.drape, batch.posed_nodes, raw, steps=steps)
            with torch.no_grad():
                better = self.energy(subspace.vertices, batch)[1].total < self.energy(own, batch)[1].total
            start = torch.where(better[:, None, None], subspace.vertices, own)
            place = (batch.gravity, self.posed_bodies.mesh, self.posed_bodies.offset)
            minima = {"subspace_minimum": subspace, "minimum": solver.minimise(start, *place)}
            for name, minimum in minima.items():
                norms[name] += minimum.gradient_norm[: batch.count].tolist()
            for name, vertices in {"model": own, **{k: m.vertices for k, m in minima.items()}}.items():
                with torch.no_grad():
                    rows[name].add(vertices, self.energy(vertices, batch)[1], count=batch.count)
        results = {name: figures.result() for name, figures in rows.items()}
        for name, values in norms.items():
            results[name]["gradient_norm"] = sum(values) / len(values)
        return results

    def _raw(self, batch: Batch) -> torch.Tensor:
        vector = self.drape.pose_vector(batch.positions, batch.gravity)
        return self.drape.networks(batch.modulation, vector, batch.posed_nodes)


def _difference(rig: Rig, other: Rig) -> str:
    if rig.bone_names != other.bone_names:
        return f"{rig.bone_count} bones, expected {other.bone_count}, or other names"
    if rig.dofs != other.dofs:
        return f"{len(rig.dofs)} degrees of freedom, expected {len(other.dofs)}, or other axes or limits"
    return "bones of other parents or in other places"


def evaluate_model(
    model: GarmentModel, device: torch.device, *, bodies: int, poses: int, seed: int, minimum: int, steps: int
) -> dict:
    """All rows of one model as plain data. minimum: pairs for the minima, 0 to leave them out."""
    batch = 64 if device.type == "cuda" else min(16, bodies * poses)
    evaluation = Evaluation(model, device, bodies=bodies, poses=poses, seed=seed, batch=batch)
    influences = model.influence_weights.shape[1]
    rows = ["model", "skinning", *(["fewer_influences"] if influences > FEWER_INFLUENCES else [])]
    scores: dict = evaluation.figures(upright=True, only=rows)
    scores["tilted"] = evaluation.figures(upright=False, only=["model"])["model"]
    scores["counts"] = {"bodies": bodies, "poses": poses, "seed": seed, "pairs": scores["model"]["pairs"]}
    scores["counts"]["influences"] = influences
    scores["material"] = asdict(model.material)
    scores["weight_n"] = float(model.garment.vertex_areas.sum() * model.material.density * GRAVITY)
    if minimum:
        subset = evaluation.minima(count=minimum, steps=steps)
        scores |= {"subspace_minimum": subset["subspace_minimum"], "minimum": subset["minimum"]}
        scores["model_on_subset"] = subset["model"]
        scores["counts"] |= {"minimum_pairs": subset["model"]["pairs"], "minimum_steps": steps}
        scores["energy_ratio"] = subset["model"]["energy_j"] / subset["minimum"]["energy_j"]
    return scores


COLUMNS = {
    "edge_strain_percent": "edge %",
    "area_strain_percent": "area %",
    "inside_percent": "inside %",
    "within_3mm_percent": "< 3 mm %",
    "max_depth_p999_mm": "depth p99.9 mm",
    "max_depth_mm": "deepest mm",
    "stretch_j": "stretch J",
    "bend_j": "bend J",
    "collision_j": "contact J",
    "gravity_j": "gravity J",
}
ROWS = {
    "skinning": "plain skinning",
    "model": "the model",
    "fewer_influences": "{influences} -> 4 influences",
    "tilted": "the model, tilted roots",
    "model_on_subset": "the model, subset",
    "subspace_minimum": "subspace minimum, subset",
    "minimum": "full-space minimum, subset",
}


def table(scores: dict) -> str:
    """The rows of `evaluate_model` as a Markdown table; below it the energy ratio, and a warning when the garment has
    left the body (strain and contact of such a garment look excellent)."""
    lines = ["| | " + " | ".join(COLUMNS.values()) + " |", "|---|" + "---|" * len(COLUMNS)]
    for row, label in ROWS.items():
        if row in scores:
            name = label.format(**scores["counts"])
            lines.append(f"| {name} | " + " | ".join(f"{scores[row][column]:.3f}" for column in COLUMNS) + " |")
    if "energy_ratio" in scores:
        pairs = scores["counts"]["minimum_pairs"]
        ratio = f"{scores['energy_ratio']:.2f}"
        lines += ["", f"Stretch, bend and contact energy, model / full-space minimum: {ratio} ({pairs} pairs)"]
    lift = (scores["model"]["gravity_j"] - scores["skinning"]["gravity_j"]) / scores["weight_n"]
    if lift > LARGEST_LIFT:
        lines += [
            "",
            f"WARNING: the garment lies {lift:.2f} m higher than with plain skinning on average; it may have left the "
            "body, and its other figures then mean nothing. Look at it.",
        ]
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    """Command line entry: `physkin evaluate MODEL`."""
    parser = argparse.ArgumentParser(prog="physkin evaluate", description=__doc__.splitlines()[0])
    parser.add_argument("model", help="garment model file, or the name of a shipped one")
    parser.add_argument("--bodies", type=int, default=16, help="held-out bodies (default 16)")
    parser.add_argument("--poses", type=int, default=256, help="uniform poses a body (default 256)")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--minimum", type=int, default=0, metavar="PAIRS", help="also minimise that many pairs")
    parser.add_argument("--minimum-steps", type=int, default=2000)
    parser.add_argument("--device", default=DEFAULT_DEVICE)
    parser.add_argument("--json", type=Path, metavar="FILE", help="write all figures there")
    parser.add_argument("--store", type=Path, metavar="FILE", help="write the model with its scores there")
    arguments = parser.parse_args(argv)
    try:
        model = load_garment_model(arguments.model)
        scores = evaluate_model(
            model,
            resolve_device(arguments.device),
            bodies=arguments.bodies,
            poses=arguments.poses,
            seed=arguments.seed,
            minimum=arguments.minimum,
            steps=arguments.minimum_steps,
        )
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    print(table(scores))
    if arguments.json:
        arguments.json.write_text(json.dumps(scores, indent=1))
    if arguments.store:
        save_garment_model(replace(model, scores=scores), arguments.store)
    return 0


if __name__ == "__main__":
    raise SystemExit(main())

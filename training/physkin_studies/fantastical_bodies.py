"""Bodies beyond what people look like: extreme shapes, children, giants, and bodies with swellings of their own.

The paper trains on a data set of fantastical characters; here they are made from the shipped adults: shape coefficients
beyond those of training, uniform scale, and smooth swellings about bones, which move surface and bones alike.
Dimensions: `V` body vertices, `b` bones, `c` shape coefficients, `s` bodies. Metres.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from physkin_core.avatar.body_model import BodyModel, load_body_model

__all__ = ["KINDS", "Swelling", "fantastical_body_model"]

TRAIN_BODIES, HELD_OUT_BODIES = 256, 32
SEED = 7
MIRRORED = 0.7
"""Share of swellings of a limb that its other side has too."""


@dataclass(frozen=True)
class Kind:
    """A kind of body. shape: factor on an adult's coefficients (from, to); scale: of the whole body; head: growth at
    the head's centre; swellings: how many others at most, growth: of their centres."""

    shape: tuple[float, float]
    scale: tuple[float, float] = (1.0, 1.0)
    head: tuple[float, float] = (0.0, 0.0)
    swellings: int = 0
    growth: tuple[float, float] = (-0.3, 0.7)


KINDS = {
    "extreme": Kind(shape=(1.5, 2.0)),
    "child": Kind(shape=(0.5, 1.0), scale=(0.55, 0.75), head=(0.3, 0.6)),
    "giant": Kind(shape=(0.8, 1.3), scale=(1.25, 1.5), head=(-0.2, 0.0), swellings=1, growth=(0.1, 0.4)),
    "swollen": Kind(shape=(0.5, 1.2), swellings=4),
}
"""Name -> kind. Bodies of a set are of these kinds in turn."""

PLACES = {
    "head": 0.13,
    "spine01": 0.14,
    "spine03": 0.13,
    "spine05": 0.13,
    "upperarm01.L": 0.07,
    "lowerarm01.L": 0.06,
    "upperleg01.L": 0.11,
    "lowerleg01.L": 0.08,
}
"""Bone about whose middle a body may swell -> how far [m] the swelling reaches, as a standard deviation."""


@dataclass(frozen=True)
class Swelling:
    """Points move away from `centre` (3,) [m] by `growth` times their distance, fading as a Gaussian of `reach` [m].

    No fold as long as growth is above -1 and below exp(1.5) / 2, as in all `KINDS`.
    """

    centre: np.ndarray
    reach: float
    growth: float

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3) [m] moved."""
        away = points - self.centre
        fade = np.exp(-(away**2).sum(axis=-1, keepdims=True) / (2 * self.reach**2))
        return points + self.growth * fade * away


@cache
def fantastical_body_model() -> BodyModel:
    """The shipped body model's mesh, rig and garment maker's body, with fantastical bodies to train on and held out.

    Its coefficients pick one body each; bodies are of `KINDS` in turn. Deterministic.
    """
    adults = load_body_model()
    generator = np.random.default_rng(SEED)
    count = TRAIN_BODIES + HELD_OUT_BODIES
    kinds = list(KINDS.values())
    sources = np.concatenate([np.resize(source, (size, source.shape[1])) for source, size in (
        (adults.train_bodies, TRAIN_BODIES), (adults.held_out_bodies, HELD_OUT_BODIES)
    )])  # fmt: skip
    made = [_make(adults, sources[k], kinds[k % len(kinds)], generator) for k in range(count)]
    made.append((adults.vertices(adults.garment_body), np.stack(adults.bones(adults.garment_body), axis=1)))
    one_each = np.eye(count + 1, dtype=np.float32)
    return replace(
        adults,
        mean_vertices=np.zeros_like(adults.mean_vertices),
        vertex_components=np.stack([vertices for vertices, _ in made]).astype(np.float32),
        mean_bones=np.zeros_like(adults.mean_bones),
        bone_components=np.stack([bones for _, bones in made]).astype(np.float32),
        garment_body=one_each[-1],
        train_bodies=one_each[:TRAIN_BODIES],
        held_out_bodies=one_each[TRAIN_BODIES:count],
    )


def _make(
    adults: BodyModel, source: np.ndarray, kind: Kind, generator: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (V, 3) and heads and tails (b, 2, 3) of one body from an adult's coefficients (c,)."""
    coefficients = source * generator.uniform(*kind.shape)
    vertices, bones = adults.vertices(coefficients), np.stack(adults.bones(coefficients), axis=1)
    root = bones[0, 0].copy()
    for swelling in _swellings(adults.rig.bone_names, bones, kind, generator):
        vertices, bones = swelling(vertices), swelling(bones)
    scale = generator.uniform(*kind.scale)
    moved = bones[0, 0].copy()
    return root + scale * (vertices - moved), root + scale * (bones - moved)


def _swellings(names: tuple[str, ...], bones: np.ndarray, kind: Kind, generator: np.random.Generator) -> list[Swelling]:
    def at(bone: str, growth: float) -> Swelling:
        reach = PLACES[bone.replace(".R", ".L")]
        return Swelling(bones[names.index(bone)].mean(axis=0), reach, growth)

    found = [at("head", generator.uniform(*kind.head))]
    places = [place for place in PLACES if place != "head"]
    for place in generator.permutation(places)[: generator.integers(0, kind.swellings, endpoint=True)]:
        growth = generator.uniform(*kind.growth)
        found.append(at(place, growth))
        if place.endswith(".L") and generator.random() < MIRRORED:
            found.append(at(place.replace(".L", ".R"), growth))
    return found

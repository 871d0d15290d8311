"""A garment as it is worn: what is asked for, and what comes of it on a body.

Dimensions: `n` garment vertices, `v` of them given. Metres, root frame, canonical pose.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import GarmentModel, SkinnedGarment
from physkin_core.model.surface_paths import openings, path_lengths
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import drape_poses
from physkin_core.runtime.rest_look import RestLook

__all__ = ["Layer", "WornGarment"]


@dataclass(frozen=True)
class WornGarment:
    """A garment and how it is to be worn.

    Attributes:
        model: the garment.
        tucked: whether its hem goes under the waistband of the next layer that is not tucked itself.
        fit: as for `Outfit`. None: the outfit's.

    Examples:
        >>> tucked = physkin.WornGarment(physkin.load_garment_model("tshirt"), tucked=True)
    """

    model: GarmentModel
    tucked: bool = False
    fit: float | None = None


@dataclass(frozen=True)
class Layer:
    """A garment as an outfit wears it on its body.

    Attributes:
        model: the garment. If another process has bound it, it comes without its networks.
        tucked: whether its hem is tucked in.
        fit: from 0 for one size to 1 for made to measure.
        bound: the whole garment, bound to the body and what lies beneath.
        rest: (n, 6) float32, vertices [m] and unit normals of the drape at rest, tucked in.
        at_rest: how the garment sits on the skin before it is tucked in. (A tucked hem goes into the skin below the
            waistband, where nobody sees it.)
        tucked_depth: (n,) [m] how far each vertex is below the waistband that it is tucked into; 0 above it.
        hidden: (n,) bool, vertices that are covered in all everyday poses.
        turned: (n,) bool, vertices of cloth that is turned inside out: lapels, and the fall of a collar.
        visible: (v,) int32, the vertices that clouds have.
        bound_visible: these vertices, bound.
        moved: whether vertices are moved after skinning, to keep layers in order or a hem tucked in.

    Examples:
        >>> model = physkin.load_garment_model("tshirt")
        >>> layer = physkin.Outfit([model], physkin.load_avatar("me.glb", model.rig)).layers[0]
        >>> layer.name, layer.fit
        ('tshirt', 1.0)
    """

    model: SkinnedGarment
    tucked: bool
    fit: float
    bound: BoundGarment
    rest: np.ndarray
    at_rest: RestLook
    tucked_depth: np.ndarray
    hidden: np.ndarray
    turned: np.ndarray
    visible: np.ndarray
    bound_visible: BoundGarment
    moved: bool = False

    @property
    def name(self) -> str:
        """Name of the garment model."""
        return self.model.name

    @property
    def faces(self) -> np.ndarray:
        """(f, 3) int32 triangles between the vertices that clouds have; (0, 3) for points without faces."""
        return self.bound_visible.faces

    @property
    def face_visible(self) -> np.ndarray:
        """(f,) bool, which faces of the bound garment are in `faces`, in the same order."""
        if len(self.faces) == len(self.bound.faces):
            return np.ones(len(self.faces), dtype=bool)
        return ~self.hidden[self.bound.faces].all(axis=1)

    @property
    def vertex_count(self) -> int:
        """Number of vertices v that clouds have."""
        return len(self.bound_visible.vertices)

    @cached_property
    def rest_garment(self) -> Garment:
        """The model's whole mesh in the rest shape that is worn here. Strains are measured against it."""
        return self.model.garment.reshaped(self.bound.vertices)

    @property
    def visible_garment(self) -> Garment:
        """The part of `rest_garment` that clouds have."""
        every = len(self.faces) == len(self.bound.faces)
        return self.rest_garment if every else self.rest_garment.submesh(self.face_visible)

    @cached_property
    def hem_distance(self) -> np.ndarray:
        """(n,) [m] along the cloth at rest from each vertex to its closest opening, or to where it is
        turned inside out: that is its edge as it is worn. Tucked hems do not count."""
        vertices, faces = self.bound.vertices, self.bound.faces
        hem = np.concatenate([np.empty(0, dtype=int), *openings(vertices, faces)])
        edges = np.concatenate([hem[self.tucked_depth[hem] == 0], np.flatnonzero(self.turned)])
        return path_lengths(vertices, faces, edges)

    def drape(self, poses: Iterable[tuple[np.ndarray, np.ndarray]]) -> list[np.ndarray]:
        """The whole garment by itself, in several poses.

        Args:
            poses: joint positions (d,) [rad] and direction of gravity (3,) of each.

        Returns:
            (n, 6) float32 for each pose: x, y, z [m] and unit normals.
        """
        return drape_poses(self.bound, poses)

"""Faces of a garment that was cut flat, from those of its panels: a place on a panel belongs to a single vertex."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from physkin_core.file_reading import ContentError

__all__ = ["without_faces", "with_faces"]

FACES, PANEL_FACES, VERTICES = "garment.faces", "garment.panel_faces", "garment.panel_vertices"


def without_faces(tensors: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Tensors of a model file, with the vertex of each panel place, (t,), instead of faces, where these follow."""
    if PANEL_FACES not in tensors:
        return dict(tensors)
    faces, panel_faces = tensors[FACES], tensors[PANEL_FACES]
    vertices = np.zeros(int(panel_faces.max()) + 1, faces.dtype)
    vertices[panel_faces] = faces
    if not np.array_equal(vertices[panel_faces], faces):
        return dict(tensors)
    return {name: tensor for name, tensor in tensors.items() if name != FACES} | {VERTICES: vertices}


def with_faces(tensors: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Tensors of a model file, with faces. Raises ContentError where panels tell none."""
    kept = dict(tensors)
    if VERTICES not in kept or FACES in kept:
        return kept
    vertices, panel_faces = kept.pop(VERTICES), kept.get(PANEL_FACES, np.zeros(0))
    if vertices.ndim != 1 or vertices.dtype.kind not in "iu" or panel_faces.dtype.kind not in "iu":
        raise ContentError(f"{VERTICES} and {PANEL_FACES} must be an integer index of each place and corner")
    if panel_faces.size == 0 or panel_faces.min() < 0 or panel_faces.max() >= len(vertices):
        raise ContentError(f"{PANEL_FACES} must hold indices from 0 to {len(vertices) - 1}, the places in {VERTICES}")
    kept[FACES] = vertices[panel_faces]
    return kept

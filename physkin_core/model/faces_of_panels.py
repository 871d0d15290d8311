"""Faces of a garment that was cut flat, told by those of its panels: a place on a panel is one of a single vertex."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from physkin_core.file_reading import ContentError

__all__ = ["told_by_panels", "with_faces"]

FACES, PANEL_FACES, VERTICES = "garment.faces", "garment.panel_faces", "garment.panel_vertices"


def told_by_panels(tensors: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
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
    told = dict(tensors)
    if VERTICES not in told or FACES in told:
        return told
    vertices, panel_faces = told.pop(VERTICES), told.get(PANEL_FACES, np.zeros(0))
    if vertices.ndim != 1 or vertices.dtype.kind not in "iu" or panel_faces.dtype.kind not in "iu":
        raise ContentError(f"{VERTICES} and {PANEL_FACES} must be an integer index of each place and corner")
    if panel_faces.size == 0 or panel_faces.min() < 0 or panel_faces.max() >= len(vertices):
        raise ContentError(f"{PANEL_FACES} must hold indices from 0 to {len(vertices) - 1}, the places in {VERTICES}")
    told[FACES] = vertices[panel_faces]
    return told

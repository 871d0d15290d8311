"""Edges of a mesh and the way along them."""

from __future__ import annotations

import numpy as np
import pytest
from random_models import tube

from physkin_core.model.surface_paths import mesh_edges, path_lengths


def test_lengths_are_those_of_the_shortest_path():
    """Up a tube, whose rings are joined by straight edges; its ends are where edges have one face."""
    mesh = tube()
    edges, count = mesh_edges(mesh.faces)
    assert np.array_equal(edges, mesh.edges)
    height = mesh.vertices[:, 2]
    ends = np.unique(edges[count == 1])
    assert set(ends) == set(np.flatnonzero(np.isclose(height, height.min()) | np.isclose(height, height.max())))
    lowest = np.flatnonzero(np.isclose(height, height.min()))
    assert path_lengths(mesh.vertices, mesh.faces, lowest) == pytest.approx(height - height.min(), abs=1e-9)


def test_no_way_is_infinitely_long():
    """To another piece, or without a source."""
    mesh = tube()
    n = len(mesh.vertices)
    two = np.concatenate([mesh.vertices, mesh.vertices + 1.0]), np.concatenate([mesh.faces, mesh.faces + n])
    lengths = path_lengths(*two, np.array([0]))
    assert np.isfinite(lengths[:n]).all() and np.isinf(lengths[n:]).all()
    assert np.isinf(path_lengths(mesh.vertices, mesh.faces, np.zeros(0, dtype=int))).all()

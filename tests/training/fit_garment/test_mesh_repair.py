"""Boundary loops of a mesh."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh
from random_models import tube

from physkin_training.fit_garment.mesh_repair import boundary_loops


def test_boundary_loops_follow_the_winding():
    shell = tube(rings=9, segments=32, radius=0.1, height=0.2)
    loops = boundary_loops(shell.faces)
    assert sorted(len(loop) for loop in loops) == [32, 32]
    directed = {tuple(edge) for edge in trimesh.Trimesh(shell.vertices, shell.faces, process=False).edges.tolist()}
    assert all(pair in directed for loop in loops for pair in zip(loop.tolist(), np.roll(loop, -1).tolist()))


def test_boundary_loops_reject_loops_that_touch():
    with pytest.raises(ValueError, match="1 vertices lie on two stretches of boundary"):
        boundary_loops(np.array([[0, 1, 2], [0, 3, 4]]))

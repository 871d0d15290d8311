"""Where points are to a closed body that runs into itself."""

from __future__ import annotations

import numpy as np
import trimesh

from physkin_training.physics.surface_queries import BodySurface


def test_points_inside_two_parts_at_once_are_told_apart():
    """Two boxes that overlap from x = 0.3 to 0.5: outside, inside one, inside both, and by how many parts."""
    boxes = [trimesh.creation.box((1.0, 1.0, 1.0)), trimesh.creation.box((1.0, 0.4, 0.4))]
    boxes[1].apply_translation((0.8, 0.0, 0.0))
    together = trimesh.util.concatenate(boxes)
    surface = BodySurface(together.vertices, together.faces)
    points = np.array([[-0.6, 0, 0], [-0.4, 0, 0], [0.4, 0, 0], [0.4, 0.3, 0], [0.6, 0.1, 0.1], [1.4, 0, 0]])
    assert surface.surrounds(points).tolist() == [False, True, True, True, True, False]
    assert surface.surrounds(points, times=2).tolist() == [False, False, True, False, False, False]


def test_no_points_are_inside():
    """As where no cloth is inside the skin."""
    box = trimesh.creation.box((1.0, 1.0, 1.0))
    assert BodySurface(box.vertices, box.faces).surrounds(np.empty((0, 3))).tolist() == []

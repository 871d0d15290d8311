"""Surfaces on the page: what is on it after they were painted, and taken off."""

from functools import partial
from types import SimpleNamespace

import numpy as np

from physkin_core.view.scene.heat_map import SKIN_BANDS
from physkin_core.view.surface_node import SurfaceNode

VERTICES = np.eye(3, dtype=np.float32)
FACES = np.array([[0, 1, 2]])


class Page:
    """A server that keeps the meshes that are on it."""

    def __init__(self):
        self.meshes = {}
        self.scene = SimpleNamespace(add_mesh_simple=self._add)

    def _add(self, name, vertices, faces, **look):
        remove = partial(self.meshes.pop, name)
        self.meshes[name] = SimpleNamespace(vertices=vertices, faces=faces, remove=remove, **look)
        return self.meshes[name]

    def colours(self):
        """Of the faces that are seen."""
        return [mesh.color for mesh in self.meshes.values() if mesh.visible]


def test_a_painted_surface_that_was_taken_off_comes_back_with_new_values():
    """As a garment does under a heat map, once its splats are switched off."""
    page = Page()
    surface = SurfaceNode(page, "cloth", 3, FACES, (1.0, 1.0, 1.0))
    surface.show(VERTICES, SKIN_BANDS, np.zeros(1))
    (plain,) = page.colours()
    surface.remove()
    assert not page.meshes
    surface.show(VERTICES, SKIN_BANDS, np.ones(1))
    (red,) = page.colours()
    assert red != plain
    surface.show(VERTICES, SKIN_BANDS, np.zeros(1))
    assert page.colours() == [plain]

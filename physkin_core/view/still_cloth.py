"""Cloth in its fabric while a figure stands still.

What moves on the page has one colour a mesh: the page takes vertices alone from frame to frame. What stands still is
sent once more, whole, with threads, stitches and hems.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from physkin_core.export.gltf_still import still_glb
from physkin_core.look.cloth_look import cloth_look
from physkin_core.outfit.outfit import Outfit
from physkin_core.render.filming import cloth_meshes
from physkin_core.view.page import Page
from physkin_core.view.scene.heat_map import Colour

__all__ = ["StillCloth"]

TO_ROOT_FRAME = (0.5, 0.5, 0.5, 0.5)
"""Quaternion w, x, y, z from glTF's axes."""


class StillCloth:
    """What of it is on a page. shown: which garments, from the skin outwards."""

    def __init__(self, page: Page) -> None:
        self._scene = page.server.scene
        self._handles: list = []

    @property
    def shown(self) -> bool:
        """Whether any is."""
        return bool(self._handles)

    def show(self, outfit: Outfit, cloth: Sequence[np.ndarray], colours: Sequence[Colour]) -> set[int]:
        """Show garments as they lie (v, 6), and return which: those that were cut flat."""
        found = set()
        for k, (layer, points, colour) in enumerate(zip(outfit.layers, cloth, colours)):
            look = cloth_look(layer.model.garment, layer.model.fabric, layer.face_visible, colour)
            if look is not None:
                content = still_glb(cloth_meshes(look, points[:, :3], layer.faces))
                name = f"/world/figure/fabric{k}"
                self._handles.append(self._scene.add_glb(name, content, wxyz=TO_ROOT_FRAME, receive_shadow=False))
                found.add(k)
        return found

    def remove(self) -> None:
        """Take it off the page."""
        for handle in self._handles:
            handle.remove()
        self._handles = []

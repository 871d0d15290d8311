"""A mesh on the page, of which only vertices are sent from frame to frame, painted in bands where asked for."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from physkin_core.view.scene.heat_map import Bands, Colour, Part, as_bytes, parts_of

if TYPE_CHECKING:
    import viser

__all__ = ["SurfaceNode"]

NO_VERTICES, NO_FACES = np.zeros((3, 3), dtype=np.float32), np.array([[0, 1, 2]], dtype=np.uint32)
"""Of a band without faces: the page takes no empty mesh."""
UNPAINTED = Bands(limits=(), colours=(None,), labels=())


class SurfaceNode:
    """vertex_count: of the mesh; faces: (f, 3) of these; name: its place in the scene. colour: of what is not painted,
    sRGB in [0, 1]."""

    def __init__(
        self, server: viser.ViserServer, name: str, vertex_count: int, faces: np.ndarray, colour: Colour
    ) -> None:
        self._server, self._name = server, name
        self._count, self._faces = vertex_count, faces
        self.colour, self._wireframe = colour, False
        self._bands, self._values = UNPAINTED, None
        self._parts: list[Part] = []
        self._handles: list = []

    def look(self, colour: Colour, *, wireframe: bool = False) -> None:
        """Change its colour, and whether only edges are drawn."""
        if (colour, wireframe) != (self.colour, self._wireframe):
            self.colour, self._wireframe = colour, wireframe
            for handle, each in zip(self._handles, self._bands.colours):
                handle.color, handle.wireframe = as_bytes(each or colour), wireframe

    def show(self, vertices: np.ndarray, bands: Bands | None = None, values: np.ndarray | None = None) -> None:
        """Move vertices (n, 3) [m] to where they are now, and give faces the colours of their values (f,) in bands, or
        without bands the mesh's own. Values are looked at anew when they are another array."""
        bands = bands or UNPAINTED
        if bands is not self._bands:
            self.remove()
        painted = not self._parts or bands is not self._bands or values is not self._values
        if painted:
            self._bands, self._values = bands, values
            band = bands.band(np.zeros(len(self._faces)) if values is None else values)
            self._parts = parts_of(self._faces, band, bands=len(bands.colours), vertex_count=self._count)
        if not self._handles:
            self._handles = [self._added(k, part, vertices) for k, part in enumerate(self._parts)]
            return
        for handle, part in zip(self._handles, self._parts):
            if painted:
                handle.faces, handle.vertices = _arrays(part, vertices)
                handle.visible = bool(len(part.faces))
            elif len(part.faces):
                handle.vertices = vertices[part.vertices]

    def remove(self) -> None:
        """Take it off the page."""
        for handle in self._handles:
            handle.remove()
        self._handles = []

    def _added(self, index: int, part: Part, vertices: np.ndarray):
        faces, points = _arrays(part, vertices)
        return self._server.scene.add_mesh_simple(
            f"{self._name}/part{index}",
            points,
            faces,
            color=as_bytes(self._bands.colours[index] or self.colour),
            wireframe=self._wireframe,
            side="double",
            receive_shadow=False,
            visible=bool(len(part.faces)),
        )


def _arrays(part: Part, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not len(part.faces):
        return NO_FACES, NO_VERTICES
    return part.faces, np.ascontiguousarray(vertices[part.vertices], dtype=np.float32)

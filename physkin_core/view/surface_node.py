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


class SurfaceNode:
    """vertex_count: of the mesh; faces: (f, 3) of these; name: its place in the scene."""

    def __init__(
        self, server: viser.ViserServer, name: str, vertex_count: int, faces: np.ndarray, colour: Colour
    ) -> None:
        self._server, self._name = server, name
        self._count, self._faces = vertex_count, faces
        self._colour, self._wireframe = colour, False
        self._bands: Bands | None = None
        self._values: np.ndarray | None = None
        self._handles: list = []
        self._parts = self._whole()

    @property
    def colour(self) -> Colour:
        """Of what is not painted, sRGB in [0, 1]."""
        return self._colour

    @colour.setter
    def colour(self, colour: Colour) -> None:
        if colour == self._colour:
            return
        self._colour = colour
        for handle, each in zip(self._handles, self._colours()):
            handle.color = as_bytes(each)

    @property
    def wireframe(self) -> bool:
        """Whether only edges are drawn."""
        return self._wireframe

    @wireframe.setter
    def wireframe(self, wireframe: bool) -> None:
        self._wireframe = wireframe
        for handle in self._handles:
            handle.wireframe = wireframe

    def show(self, vertices: np.ndarray) -> None:
        """Move vertices (n, 3) [m] to where they are now; their paint stays on the faces."""
        if not self._handles:
            self._handles = [
                self._added(k, vertices, part, colour)
                for k, (part, colour) in enumerate(zip(self._parts, self._colours()))
            ]
            return
        for handle, part in zip(self._handles, self._parts):
            if len(part.faces):
                handle.vertices = vertices[part.vertices]

    def paint(self, bands: Bands | None, values: np.ndarray | None, vertices: np.ndarray) -> None:
        """Give faces the colours of their values (f,), or with None the mesh's own; vertices (n, 3) as for `show`.
        Values are looked at anew when they are another array."""
        same, self._values = values is self._values, values
        if bands is not self._bands:
            self.remove()
            self._bands = bands
            self._parts = self._whole() if bands is None else self._banded(values)
            self.show(vertices)
            return
        if not same:
            self._parts = self._banded(values)
        if same or not self._handles:
            self.show(vertices)
        else:
            for handle, part in zip(self._handles, self._parts):
                handle.faces, handle.vertices = _arrays(part, vertices)
                handle.visible = bool(len(part.faces))

    def remove(self) -> None:
        """Take it off the page."""
        for handle in self._handles:
            handle.remove()
        self._handles = []

    def _whole(self) -> list[Part]:
        return parts_of(self._faces, np.zeros(len(self._faces), dtype=int), bands=1, vertex_count=self._count)

    def _banded(self, values: np.ndarray) -> list[Part]:
        bands = len(self._bands.colours)
        return parts_of(self._faces, self._bands.band(values), bands=bands, vertex_count=self._count)

    def _colours(self) -> list[Colour]:
        if self._bands is None:
            return [self._colour]
        return [self._colour if colour is None else colour for colour in self._bands.colours]

    def _added(self, index: int, vertices: np.ndarray, part: Part, colour: Colour):
        faces, points = _arrays(part, vertices)
        return self._server.scene.add_mesh_simple(
            f"{self._name}/part{index}",
            points,
            faces,
            color=as_bytes(colour),
            wireframe=self._wireframe,
            side="double",
            receive_shadow=False,
            visible=bool(len(part.faces)),
        )


def _arrays(part: Part, vertices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    if not len(part.faces):
        return NO_FACES, NO_VERTICES
    return part.faces, np.ascontiguousarray(vertices[part.vertices], dtype=np.float32)

"""Frames onto the page: what has changed is sent, meshes are made once an outfit.

What moves has one colour a mesh: the page takes vertices alone from frame to frame. Cloth that stands still is sent
once more, whole, in its fabric, with threads, stitches and hems.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from physkin_core.export.gltf_still import still_glb
from physkin_core.look.cloth_look import cloth_look, seen_from_afar
from physkin_core.view.page import Page
from physkin_core.view.scene.figures import OutfitFigures
from physkin_core.view.scene.heat_map import SKIN_BANDS, STRAIN_BANDS, Bands, Colour, as_bytes, own_bands
from physkin_core.view.scene.scene_state import Frame, SplatFrame
from physkin_core.view.surface_node import SurfaceNode

__all__ = ["Drawing", "Switches"]

BESIDE = 1.1
"""Plain skinning stands so far [m] to the figure's right: the panel is on the other side."""
NODE_COLOUR, NODE_SIZE = (0.95, 0.45, 0.05), 0.011
NORMAL_COLOUR, NORMAL_LENGTH, MOST_NORMALS = (0.10, 0.10, 0.10), 0.02, 900
"""[m]; of each garment at most so many are drawn."""
FROM_GLTF = (0.5, 0.5, 0.5, 0.5)
"""Quaternion w, x, y, z from glTF's axes to those of the root."""


@dataclass
class Switches:
    """What is drawn beside or over the figure. heat: "strain", "skin" or None. own_colours: of the body, where its file
    has materials. splats: in place of the garment that they are of. follow: the world moves, so that the figure stays
    in the picture."""

    nodes: bool = False
    wireframe: bool = False
    normals: bool = False
    heat: str | None = None
    own_colours: bool = True
    splats: bool = True
    follow: bool = True


class Drawing:
    """Draws frames of one page. figures: of the outfit drawn. skin_shows: (F,) faces of the body, where it is known."""

    def __init__(self, page: Page) -> None:
        self._page, self._scene = page, page.server.scene
        self._beside = self._scene.add_frame("/world/beside", show_axes=False)
        self.switches = Switches()
        self.figures: OutfitFigures | None = None
        self.skin_shows: np.ndarray | None = None
        self._own: tuple[Bands | None, np.ndarray | None] = (None, None)
        self._surfaces: list[SurfaceNode] = []
        self._plain: list[SurfaceNode] = []
        self._marks: dict[str, object] = {}
        self._still: list = []

    def stand(self, frame: Frame) -> None:
        """Draw the frame drawn last once more, as what stands still: cloth in its fabric, where nothing is painted over
        it."""
        switches = self.switches
        if self._still or switches.heat == "strain" or switches.wireframe:
            return
        if switches.splats and frame.splats is not None:
            return
        with self._page.server.atomic():
            for k, (layer, points, colour) in enumerate(zip(frame.outfit.layers, frame.cloth, frame.colours[1:])):
                look = cloth_look(layer.model.garment, layer.model.fabric, layer.face_visible, colour)
                if look is not None:  # only of cloth that was cut flat
                    content = still_glb(look, points, layer.faces)
                    name, how = f"/world/figure/fabric{k}", {"wxyz": FROM_GLTF, "receive_shadow": False}
                    self._still.append(self._scene.add_glb(name, content, **how))
                    self._surfaces[1 + k].remove()

    def show(self, frame: Frame) -> None:
        """Draw a frame as the switches are now."""
        with self._page.server.atomic():
            while self._still:
                self._still.pop().remove()
            if self.figures is None or frame.outfit is not self.figures.outfit:
                self._change_outfit(frame)
            self._place(frame)
            self._paint(frame)
            self._show_plain(frame)
            for figure in (self._surfaces, self._plain):
                for k, (surface, colour) in enumerate(zip(figure, _from_afar(frame))):
                    surface.look(colour, wireframe=self.switches.wireframe and k > 0)  # the first is the body
            self._show_marks(frame)

    def _change_outfit(self, frame: Frame) -> None:
        for surface in (*self._surfaces, *self._plain):
            surface.remove()
        self.figures, self.skin_shows = OutfitFigures(frame.outfit), None
        self._own = own_bands(frame.own_colours, _shown(frame))
        self._surfaces = self._new_surfaces("/world/figure", frame)
        self._plain = []

    def _new_surfaces(self, where: str, frame: Frame) -> list[SurfaceNode]:
        """The body and each garment."""
        outfit, server = frame.outfit, self._page.server
        meshes = {"body": (len(frame.body), outfit.body_to_draw.faces[_shown(frame)])}
        meshes |= {f"cloth{k}": (layer.vertex_count, layer.faces) for k, layer in enumerate(outfit.layers)}
        return [
            SurfaceNode(server, f"{where}/{name}", *mesh, colour)
            for (name, mesh), colour in zip(meshes.items(), frame.colours)
        ]

    def _place(self, frame: Frame) -> None:
        x, y, z, w = frame.pose.root_orientation
        forward = np.array([1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 0.0])
        right = np.array([forward[1], -forward[0], 0.0]) / max(np.linalg.norm(forward), 1e-6)
        place = frame.pose.root_position
        self._page.figure.wxyz = self._beside.wxyz = (w, x, y, z)
        self._page.figure.position = place
        self._beside.position = place + BESIDE * right
        self._page.world.position = -place * [1, 1, 0] if self.switches.follow else np.zeros(3)

    def _paint(self, frame: Frame) -> None:
        body, *cloth = self._surfaces
        heat = self.switches.heat
        if heat == "skin" and self.skin_shows is not None:
            shows = np.zeros(len(frame.outfit.faces_to_draw))
            shows[: len(self.skin_shows)] = self.skin_shows
            body.show(frame.body, SKIN_BANDS, shows[_shown(frame)])
        else:
            body.show(frame.body, *self._body_paint)
        strains = self.figures.strains_of_faces(frame) if heat == "strain" else [None] * len(cloth)
        splats = frame.splats if self.switches.splats else None
        for k, (surface, points, strain) in enumerate(zip(cloth, frame.cloth, strains)):
            if splats is not None and k == splats.garment:
                surface.remove()
            else:
                surface.show(points[:, :3], None if strain is None else STRAIN_BANDS, strain)
        self._show_splats(splats, frame.colours[1:])

    def _show_splats(self, shown: SplatFrame | None, colours: Sequence[Colour]) -> None:
        if shown is None:
            self._unmark("splats")
            return
        centres, covariances = shown.splats.centres, shown.splats.covariances()
        tints = np.tile(colours[shown.garment], (len(centres), 1)) if shown.colours is None else shown.colours
        look = tints, shown.opacity[:, None]
        if "splats" in self._marks:
            self._marks["splats"].set_gaussians(centres, covariances, *look)
        else:
            add = self._scene.add_gaussian_splats
            self._marks["splats"] = add("/world/figure/splats", centres, covariances, *look)

    def _show_plain(self, frame: Frame) -> None:
        if frame.plain and not self._plain:
            self._plain = self._new_surfaces("/world/beside", frame)
        if not frame.plain:
            while self._plain:
                self._plain.pop().remove()
            return
        self._plain[0].show(frame.body, *self._body_paint)
        for surface, vertices in zip(self._plain[1:], frame.plain):
            surface.show(vertices)

    @property
    def _body_paint(self) -> tuple[Bands | None, np.ndarray | None]:
        return self._own if self.switches.own_colours else (None, None)

    def _show_marks(self, frame: Frame) -> None:
        """Garment nodes and normals."""
        scene, switches = self._scene, self.switches
        self._mark(
            "nodes",
            np.concatenate(frame.nodes) if switches.nodes else None,
            lambda name, points: scene.add_point_cloud(
                name, points, as_bytes(NODE_COLOUR), point_size=NODE_SIZE, point_shape="circle", precision="float32"
            ),
        )
        self._mark(
            "normals",
            np.concatenate([_normal_lines(points) for points in frame.cloth]) if switches.normals else None,
            lambda name, lines: scene.add_line_segments(
                name, lines, as_bytes(NORMAL_COLOUR), thickness=1.0, thickness_units="screen"
            ),
        )

    def _mark(self, name: str, points: np.ndarray | None, add: Callable[[str, np.ndarray], object]) -> None:
        """Draw points; where there are as many as before, move them; with None, remove them."""
        old = self._marks.get(name)
        if old is not None and points is not None and old.points.shape == points.shape:
            old.points = points
            return
        self._unmark(name)
        if points is not None:
            self._marks[name] = add(f"/world/figure/{name}", points)

    def _unmark(self, name: str) -> None:
        if name in self._marks:
            self._marks.pop(name).remove()


def _from_afar(frame: Frame) -> tuple[Colour, ...]:
    """Colours of the body and each garment, whose threads are not drawn."""
    body, *cloth = frame.colours
    garments = zip(frame.outfit.garments, cloth)
    return body, *(seen_from_afar(garment.fabric, colour) for garment, colour in garments)


def _shown(frame: Frame) -> np.ndarray | slice:
    """Faces of the body that are drawn: under several layers not those that they hide."""
    return frame.outfit.faces_to_draw if len(frame.cloth) > 1 else slice(None)


def _normal_lines(points: np.ndarray) -> np.ndarray:
    """(N, 2, 3) from evenly chosen points (v, 6) along their normals."""
    chosen = points[:: -(-len(points) // MOST_NORMALS)]
    return np.stack([chosen[:, :3], chosen[:, :3] + NORMAL_LENGTH * chosen[:, 3:]], axis=1)

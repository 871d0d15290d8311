"""Figures of what is shown: strain, cloth inside the body, skin that shows, for the read-out and the heat maps.

Dimensions: `V` body vertices, `F` body faces, `v` vertices given of a garment, `f` faces of these, `n` vertices of all
garments together, `g` their faces. Metres.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass

import numpy as np

from physkin_core.check.sight import Surface, skin_shows
from physkin_core.model.garment import Garment
from physkin_core.model.surface_paths import hem_distances
from physkin_core.outfit.outfit import Outfit
from physkin_core.quality import contact_figures, edge_strains, signed_distance
from physkin_core.view.scene.scene_state import Frame

__all__ = ["Contact", "OutfitFigures", "figure_process", "look_at_contact"]

POLITENESS = 10
"""Frames go first."""


@dataclass(frozen=True)
class Contact:
    """inside_percent: of the cloth's vertices; deepest_mm: the deepest of them. skin_shows_percent: of the pixels
    that should show cloth; skin_shows: (F,) bool, where."""

    inside_percent: float
    deepest_mm: float
    skin_shows_percent: float
    skin_shows: np.ndarray


def look_at_contact(
    *, cloth: np.ndarray, cloth_faces: np.ndarray, hem_distance: np.ndarray, body: np.ndarray, body_faces: np.ndarray
) -> Contact:
    """Some tenths of a second. cloth (n, 3), cloth_faces (g, 3), hem_distance (n,) [m], body (V, 3), body_faces
    (F, 3)."""
    cloth, body = cloth.astype(np.float64), body.astype(np.float64)
    found = contact_figures(signed_distance(cloth, body, body_faces))
    skin = skin_shows(Surface(body, body_faces), Surface(cloth, cloth_faces, hem_distance))
    return Contact(
        inside_percent=found["inside_percent"],
        deepest_mm=found["max_depth_mm"],
        skin_shows_percent=skin.percent,
        skin_shows=skin.faces,
    )


class OutfitFigures:
    """What an outfit's figures are measured against: the rest shapes of what of its garments is given."""

    def __init__(self, outfit: Outfit) -> None:
        self.outfit = outfit
        layers = outfit.layers
        self._garments = [layer.visible_garment for layer in layers]
        rest = [layer.rest_garment for layer in layers]
        hems = [hem_distances(garment.vertices, garment.faces) for garment in rest]
        self._hem_distance = np.concatenate([hem[layer.visible] for hem, layer in zip(hems, layers)])
        first = np.cumsum([0, *(layer.vertex_count for layer in layers[:-1])])
        self._faces = np.concatenate([layer.faces + start for start, layer in zip(first, layers)])

    def strains(self, frame: Frame) -> list[np.ndarray]:
        """|l - l0| / l0 of every edge [%], of each garment."""
        return [edge_strains(garment, cloth[:, :3]) for garment, cloth in zip(self._garments, frame.cloth)]

    def strains_of_faces(self, frame: Frame) -> list[np.ndarray]:
        """For every face (f,) of each garment, the mean [%] of its corners', a corner's being that of its edges."""
        return [_carried_to_faces(garment, strain) for garment, strain in zip(self._garments, self.strains(frame))]

    def question(self, frame: Frame) -> dict[str, np.ndarray]:
        """What `look_at_contact` needs of a frame; no array that the next frame overwrites."""
        cloth = np.concatenate([points[:, :3] for points in frame.cloth])
        avatar = self.outfit.avatar  # not as it is drawn
        body = avatar.posed_vertices(self.outfit.bone_transforms(frame.pose.positions))
        return {
            "cloth": cloth,
            "cloth_faces": self._faces,
            "hem_distance": self._hem_distance,
            "body": body,
            "body_faces": avatar.faces,
        }


def _carried_to_faces(garment: Garment, of_edges: np.ndarray) -> np.ndarray:
    ends, count = garment.edges.reshape(-1), len(garment.vertices)
    edges_of_corner = np.maximum(np.bincount(ends, minlength=count), 1)
    of_corners = np.bincount(ends, np.repeat(of_edges, 2), minlength=count) / edges_of_corner
    return of_corners[garment.faces].mean(axis=1)


def figure_process() -> ProcessPoolExecutor:
    """A process of its own that looks at contact, so that frames need not wait."""
    return ProcessPoolExecutor(1, mp_context=multiprocessing.get_context("spawn"), initializer=_begin)


def _begin() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl+C ends the page, and that this
    os.nice(POLITENESS)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    """However the page was ended."""
    multiprocessing.parent_process().join()
    os._exit(0)

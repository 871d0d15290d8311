"""A garment mesh from a sewing pattern: what `fit-garment` takes in place of a mesh file."""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import torch

from physkin_core.avatar.avatar import Avatar
from physkin_core.mesh.look import Look
from physkin_core.mesh.mesh_file import MeshFile
from physkin_core.model.garment_model import Material
from physkin_core.rig.rig import Rig
from physkin_training.fit_garment.fitting import CLEARANCE, SOFT
from physkin_training.sewing.cut import EDGE_LENGTH_RANGE, Cut, cut
from physkin_training.sewing.pattern import Pattern, PatternError, load_pattern
from physkin_training.sewing.sew import sewn

__all__ = ["EDGE_LENGTH", "PATTERN_SUFFIX", "sewn_mesh"]

DRAFT = 1.7
"""Times as long edges as a garment's are those of the draft that it is sewn with before it hangs."""
log = logging.getLogger(__name__)
PATTERN_SUFFIX = ".json"
EDGE_LENGTH = 0.015
"""[m] of the triangles, by default."""


def sewn_mesh(path: Path, avatar: Avatar, rig: Rig, *, edge_length: float, device: torch.device) -> MeshFile:
    """The garment of a pattern, sewn and hung on an avatar in the canonical pose: root frame, metres.

    Its texture coordinates are those on the flat cloth, its parts are the panels, its line elements the threads.
    edge_length: of the triangles [m]. Raises PatternError as `load_pattern`, `cut` and `sewn` do.
    """
    pattern = load_pattern(path)
    pieces = cut(pattern, edge_length)
    log.info("%s: %d panels of %d vertices are sewn", path, len(pieces.names), len(pieces.places))
    material = Material(contact_offset=CLEARANCE + SOFT)
    garment = sewn(pieces, avatar, rig, material, device, draft=_draft(pattern, edge_length))
    uv = garment.panel_places[garment.panel_faces]
    look = Look(uv, np.full(len(garment.faces), -1), pieces.panel, parts=pieces.names)
    threads = np.zeros((0, 2), int) if garment.threads is None else garment.threads
    return MeshFile(garment.vertices, garment.faces, 0, look, threads)


def _draft(pattern: Pattern, edge_length: float) -> Cut | None:
    """A cut in longer edges; None for a panel that is too narrow for them."""
    try:
        return cut(pattern, min(DRAFT * edge_length, EDGE_LENGTH_RANGE[1]))
    except PatternError:
        return None

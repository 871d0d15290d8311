"""Draw `docs/fabrics.jpg`, a sewn dress in six fabrics: python docs/draw_fabrics.py (some six minutes)

It is sewn from its pattern once; below each figure its hem, close up.
"""

from __future__ import annotations

import numpy as np
import torch
from PIL import Image

from import_graph import ROOT
from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.look.cloth_look import cloth_colour, cloth_look
from physkin_core.model.garment import Garment
from physkin_core.model.garment_model import Material
from physkin_core.pictures.picture import CLOTH_COLOUR, contact_sheet, render
from physkin_core.render.filming import avatar_mesh, cloth_meshes
from physkin_training.sewing.cut import cut
from physkin_training.sewing.pattern import load_pattern
from physkin_training.sewing.sew import sewn

DRAWING = ROOT / "docs" / "fabrics.jpg"
PATTERN = ROOT / "training" / "garments" / "patterns" / "dress.json"
WORN = ("denim", "jersey:bordeaux", "rib:beige", "cotton:white", "wool", "silk:teal")
EDGE_LENGTH = 0.018  # [m]
AZIMUTH = 20
SIZE, CLOSE = (300, 480), (300, 260)
ABOUT_HEM = 0.045
"""[m] Half of what a close-up shows."""


def main() -> None:
    """Write the picture."""
    body_model = load_body_model()
    avatar = avatar_from_body(body_model, body_model.garment_body)
    pieces = cut(load_pattern(PATTERN), EDGE_LENGTH)
    garment = sewn(pieces, avatar, body_model.rig, Material(), torch.device("cpu"))
    draw(garment, avatar)


def draw(garment: Garment, avatar) -> None:
    """Write the picture of a garment on a body."""
    low, high = avatar.vertices.min(axis=0), avatar.vertices.max(axis=0)
    front = garment.vertices[:, 0] + 0.3 * garment.vertices[:, 1]
    hem = garment.vertices[np.argmin(garment.vertices[:, 2] - 0.15 * front)]
    far, near = [], []
    for fabric in WORN:
        colour = cloth_colour(fabric, CLOTH_COLOUR)
        look = cloth_look(garment, fabric, np.ones(len(garment.faces), dtype=bool), colour)
        meshes = [avatar_mesh(avatar, avatar.vertices), *cloth_meshes(look, garment.vertices, garment.faces)]
        far.append(render(meshes, size=SIZE, azimuth=AZIMUTH, bounds=np.stack([low, high]), floor=low[2]))
        about = np.stack([hem - ABOUT_HEM, hem + ABOUT_HEM]) + [0, 0, 0.6 * ABOUT_HEM]
        near.append(render(meshes, size=CLOSE, azimuth=AZIMUTH, bounds=about, floor=low[2]))
    columns = len(WORN)
    sheet = np.concatenate([contact_sheet(far, columns=columns), contact_sheet(near, columns=columns, captions=WORN)])
    Image.fromarray(sheet).save(DRAWING, quality=86)


if __name__ == "__main__":
    main()

"""Draw `docs/sewing.jpg`, how a garment is sewn from its pattern: python docs/draw_sewing.py (some two minutes)

A hoodie: its panels hung about the paper doll, seams half closed, closed, and as it hangs; below, how some others hang.
"""

from __future__ import annotations

import numpy as np
import torch
from PIL import Image

from import_graph import ROOT
from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.garment_model import Material
from physkin_core.pictures.picture import CLOTH_COLOUR, Mesh, contact_sheet, render
from physkin_core.render.filming import avatar_mesh
from physkin_training.sewing.cut import cut
from physkin_training.sewing.pattern import load_pattern
from physkin_training.sewing.sew import sewn

DRAWING = ROOT / "docs" / "sewing.jpg"
PATTERNS = ROOT / "training" / "garments" / "patterns"
SHOWN, STEPS = "hoodie", (1, 20, 50)
OTHERS = ("longsleeve", "trousers", "dress", "maxidress")
EDGE_LENGTH = 0.022  # [m]
SIZE = (330, 430)


def main() -> None:
    """Write the picture."""
    body_model = load_body_model()
    avatar = avatar_from_body(body_model, body_model.garment_body)
    low, high = avatar.vertices.min(axis=0), avatar.vertices.max(axis=0)
    bounds = np.stack([low - [0.1, 0.1, 0], high + [0.1, 0.1, 0.15]])

    def drawn(vertices: np.ndarray, faces: np.ndarray, body: np.ndarray) -> np.ndarray:
        meshes = [avatar_mesh(avatar, body), Mesh(vertices, faces, CLOTH_COLOUR)]
        return render(meshes, size=SIZE, bounds=bounds, floor=low[2])

    def hangs(name: str, steps: list) -> np.ndarray:
        """The picture of a garment; steps: to which those of its sewing are added."""
        pieces = cut(load_pattern(PATTERNS / f"{name}.json"), EDGE_LENGTH)
        given = pieces, avatar, body_model.rig, Material(), torch.device("cpu")
        garment = sewn(*given, watch=lambda *state: steps.append(state))
        return drawn(garment.vertices, garment.faces, avatar.vertices)

    steps: list = []
    last = hangs(SHOWN, steps)
    pictures = [*(drawn(*steps[step]) for step in STEPS), last, *(hangs(name, []) for name in OTHERS)]
    Image.fromarray(contact_sheet(pictures, columns=4)).save(DRAWING, quality=88)


if __name__ == "__main__":
    main()

"""Draw a strip: a garment's drapes without sway, with it, and simulated, one row each, at frames of a reference.

`python -m physkin_training.dynamics.strip REFERENCE.npz --frames 60 120 150 -o strip.jpg`
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_core.model.model_file import load_garment_model
from physkin_core.outfit.draper import Draper
from physkin_core.pictures.picture import CLOTH_COLOUR, Mesh, contact_sheet, render, save_png
from physkin_training.dynamics.reference import Reference, load_reference

__all__ = ["draw_strip"]

SIZE = (220, 330)
AZIMUTH = 80.0


def draw_strip(reference: Reference, frames: list[int], draper: Draper) -> list[list[np.ndarray]]:
    """Images (h, w, 3), three rows of one a frame. Raises ValueError for frames of which no whole garment is kept."""
    kept = {int(frame): vertices for frame, vertices in zip(reference.whole_frames, reference.whole)}
    if missing := [frame for frame in frames if frame not in kept]:
        raise ValueError(f"no whole garment of frames {missing}; there are {', '.join(map(str, kept))}")
    motion, faces = reference.motion, draper.faces
    positions = motion.positions_for(draper.model.rig)
    roots = np.concatenate([motion.root_position, motion.root_orientation], axis=1)
    draper.reset()
    rows: list[list[np.ndarray]] = [[], [], []]
    for k in range(max(frames) + 1):
        swaying = draper.drape(positions[k], time=k / motion.rate_hz, root=roots[k])[:, :3].copy()
        if k not in frames:
            continue
        body = Mesh(draper.avatar.posed_vertices(draper.bone_transforms(positions[k])), draper.avatar.faces)
        (still,) = draper.layer.drape([(positions[k], motion.gravity[k])])  # beside, as it would end what sways
        for row, vertices in zip(rows, (still[:, :3], swaying, kept[k])):
            row.append(render([body, Mesh(vertices, faces, CLOTH_COLOUR)], size=SIZE, azimuth=AZIMUTH))
    return rows


def main(argv: list[str] | None = None) -> None:
    """Command line entry."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument(
        "references", type=Path, nargs="+", metavar="REFERENCE", help="of the middle body, side by side"
    )
    parser.add_argument("--frames", type=int, nargs="+", required=True, help="multiples of what was kept whole")
    parser.add_argument("-o", "--output", type=Path, required=True)
    options = parser.parse_args(argv)
    rows: list[list[np.ndarray]] = [[], [], []]
    for path in options.references:
        reference = load_reference(path)
        model, body_model = load_garment_model(reference.garment), load_body_model()
        draper = Draper(model, avatar_from_body(body_model, reference.bodies[reference.whole_body]))
        for row, images in zip(rows, draw_strip(reference, options.frames, draper)):
            row += images
    save_png(options.output, contact_sheet([image for row in rows for image in row], columns=len(rows[0])))


if __name__ == "__main__":
    main()

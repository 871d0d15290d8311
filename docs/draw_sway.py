"""Draw the film `docs/sway.webp`: garments that sway, each above its simulation: python docs/draw_sway.py FOLDER

FOLDER holds references of the scene `turn`; each takes some ten minutes of a core:

    physkin simulate dress --dynamic --scenes turn --bodies 1 --seconds 3.4 --held-above 0.08 -o FOLDER
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from import_graph import ROOT
from physkin_core import Outfit, WornGarment, load_body_model, load_garment_model
from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.pictures.picture import Mesh, contact_sheet, render
from physkin_core.render.film_files import write_film
from physkin_core.render.filming import dressed_meshes
from physkin_training.dynamics.reference import Reference, load_reference

FILM = ROOT / "docs" / "sway.webp"
GARMENTS = ("skirt", "circleskirt", "dress", "maxidress")
FROM = 36
"""The first frame that is shown, shortly before the root turns."""
STEP = 4
"""Every so many frames are shown."""
SIZE, AZIMUTH = (210, 270), 25


def figures(reference: Reference) -> tuple[list[list[Mesh]], list[list[Mesh]]]:
    """Of each frame that is shown body and cloth, upright: as it sways, and as it was simulated."""
    outfit = Outfit(
        [WornGarment(load_garment_model(reference.garment))],
        avatar_from_body(load_body_model(), reference.bodies[0]),
    )
    motion, simulated = reference.motion, reference.simulated(0)
    rows: tuple[list[list[Mesh]], list[list[Mesh]]] = ([], [])
    for frame, positions in enumerate(motion.positions_for(outfit.rig)):
        (cloth,) = outfit.drape(positions, time=frame / motion.rate_hz, root=motion.root[frame])
        if frame < FROM or frame % STEP:
            continue
        turn, body = Rotation.from_quat(motion.root[frame, 3:]), outfit.posed_body(positions)
        for row, points in zip(rows, (cloth[:, :3], simulated[frame])):
            row.append(dressed_meshes(outfit, turn.apply(body), [turn.apply(points)]))
    return rows


def draw_film(folder: Path) -> None:
    """Write `FILM` from references in a folder."""
    references = [load_reference(folder / f"{name}_turn.npz") for name in GARMENTS]
    swaying, simulated = zip(*(figures(reference) for reference in references))
    shown = (*swaying, *simulated)
    corners = np.concatenate([mesh.vertices for column in shown for meshes in column for mesh in meshes])
    bounds = np.stack([corners.min(axis=0), corners.max(axis=0)])
    pictures = (
        contact_sheet(
            [render(meshes, size=SIZE, azimuth=AZIMUTH, bounds=bounds, floor=bounds[0, 2]) for meshes in frame],
            columns=len(GARMENTS),
            gap=0,
        )
        for frame in zip(*shown)
    )
    write_film(FILM, pictures, references[0].motion.rate_hz / STEP)
    print(f"wrote {FILM}")


if __name__ == "__main__":
    draw_film(Path(sys.argv[1]))

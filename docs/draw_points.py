"""Draw `docs/points.jpg`, splats on a draped T-shirt: python docs/draw_points.py

Each splat is drawn as a disc, as large as its two longest axes.
"""

from __future__ import annotations

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

from import_graph import ROOT
from physkin_core import BUNDLED_AVATAR, SplatDraper, Splats, load_avatar, load_garment_model, load_motion
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.surface_sampling import sample_surface
from physkin_core.pictures.picture import Mesh, contact_sheet, render

DRAWING = ROOT / "docs" / "points.jpg"
MOTION, FRAMES = "dance", (0, 30, 60)
COUNT, SIDE = 20_000, 0.05  # splats; [m] of a square of the checker
WIDE, THIN = 0.0052, 0.0004  # [m] standard deviations of a splat on the surface
CORNERS, REACH = 8, 1.4  # of a disc; its radius in standard deviations
COLOURS = ((0.80, 0.30, 0.22), (0.93, 0.87, 0.74))
"""sRGB of the checker."""


def surface_splats(model: GarmentModel) -> tuple[Splats, np.ndarray]:
    """Flat splats all over the garment, and which colour (n,) each has."""
    points, normals = sample_surface(model.garment.vertices, model.garment.faces, COUNT)
    first = np.cross(normals, [0.0, 0.0, 1.0])
    first /= np.linalg.norm(first, axis=1, keepdims=True)
    axes = np.stack([first, np.cross(normals, first), normals], axis=2)
    colour = np.floor(points / SIDE + 0.5).astype(int).sum(axis=1) % 2
    scales = np.tile([WIDE, WIDE, THIN], (COUNT, 1))
    return Splats(points, Rotation.from_matrix(axes).as_quat(), scales), colour


def discs(splats: Splats, colour: tuple[float, float, float]) -> Mesh:
    """Splats as a surface to draw."""
    order = np.argsort(-splats.scales, axis=1)[:, None, :2]
    lengths = np.take_along_axis(splats.scales[:, None, :], order, axis=2)
    spokes = REACH * np.take_along_axis(splats.axes(), order, axis=2) * lengths
    angles = 2 * np.pi * np.arange(CORNERS) / CORNERS
    circle = np.stack([np.cos(angles), np.sin(angles)], axis=1)
    vertices = splats.centres[:, None] + np.einsum("nck,ak->nac", spokes, circle)
    fan = np.array([[0, k, k + 1] for k in range(1, CORNERS - 1)])
    faces = CORNERS * np.arange(len(vertices))[:, None, None] + fan
    return Mesh(vertices.reshape(-1, 3), faces.reshape(-1, 3), colour)


def main() -> None:
    """Write the picture."""
    model = load_garment_model("tshirt")
    avatar, motion = load_avatar(BUNDLED_AVATAR, model.rig), load_motion(MOTION)
    splats, colour = surface_splats(model)
    draper = SplatDraper(model, avatar, splats)
    pictures = []
    for frame in FRAMES:
        positions = motion.positions_for(model.rig)[frame]
        draped = draper.drape(positions, motion.gravity[frame])
        body = avatar.posed_vertices(model.rig.bone_transforms(positions, heads=avatar.bone_heads))
        bounds = np.stack([draped.centres.min(axis=0), draped.centres.max(axis=0)])
        shown = [
            discs(Splats(draped.centres[part], draped.rotations[part], draped.scales[part]), COLOURS[index])
            for index in (0, 1)
            for part in [colour == index]
        ]
        pictures.append(render([Mesh(body, avatar.faces), *shown], size=(330, 400), azimuth=35, bounds=bounds))
    Image.fromarray(contact_sheet(pictures, columns=len(pictures))).save(DRAWING, quality=86, optimize=True)


if __name__ == "__main__":
    main()

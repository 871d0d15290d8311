"""Draw `docs/frames.jpg`, the frames of the node's messages: python docs/draw_frames.py

The dressed avatar in the middle of a motion, axes of the world on the floor and of the root at the pelvis.
"""

from __future__ import annotations

import numpy as np
import trimesh
from PIL import Image, ImageDraw, ImageFont
from scipy.spatial.transform import Rotation

from import_graph import ROOT
from physkin_core import BUNDLED_AVATAR, Outfit, load_avatar, load_garment_model, load_motion
from physkin_core.pictures.picture import Mesh, render
from physkin_core.render.filming import dressed_meshes

DRAWING = ROOT / "docs" / "frames.jpg"
MOTION, FRAME = "kick", 24
SIZE = (800, 560)
AXES = ((0.85, 0.15, 0.15), (0.15, 0.65, 0.2), (0.15, 0.35, 0.9))
LENGTH, RADIUS = 0.65, 0.012  # [m]
INK = (50, 54, 60)
FROM_ROOT = (1.0, -0.9)  # [m] where the world's origin is put on the floor, seen from below the root


def axes(place: np.ndarray, turn: Rotation) -> list[Mesh]:
    """Red X, green Y and blue Z at a place (3,) [m]."""
    found = []
    for direction, colour in zip(np.eye(3), AXES):
        end = place + turn.apply(LENGTH * direction)
        shaft = trimesh.creation.cylinder(RADIUS, segment=[place, end])
        tip = trimesh.creation.icosphere(radius=2.2 * RADIUS)
        tip.apply_translation(end)
        found += [Mesh(part.vertices, part.faces, colour) for part in (shaft, tip)]
    return found


def main() -> None:
    """Write the picture."""
    models = [load_garment_model(name) for name in ("trousers", "tshirt")]
    outfit, motion = Outfit(models, load_avatar(BUNDLED_AVATAR, models[0].rig)), load_motion(MOTION)
    positions, turn = motion.positions_for(models[0].rig)[FRAME], Rotation.from_quat(motion.root_orientation[FRAME])
    height = motion.root_position[FRAME] * [0, 0, 1]
    cloth = [turn.apply(cloud[:, :3]) + height for cloud in outfit.drape(positions, motion.gravity[FRAME])]
    body = turn.apply(outfit.posed_body(positions)) + height
    floor = float(body[:, 2].min())
    world, root = axes(np.array([*FROM_ROOT, floor]), Rotation.identity()), axes(height, turn)
    shown = [*dressed_meshes(outfit, body, cloth), *world]
    corners = np.concatenate([mesh.vertices for mesh in (*shown, *root)])
    view = {
        "size": SIZE,
        "azimuth": 40,
        "elevation": 16,
        "bounds": np.stack([corners.min(axis=0), corners.max(axis=0)]),
    }
    picture = render([*shown, *root], floor=floor, **view)
    alone = render(root, floor=None, **view)  # what the body hides of the root's axes shows through it
    picture = np.where(inked(alone)[..., None], 0.7 * alone + 0.3 * picture, picture).astype(np.uint8)
    drawn = Image.fromarray(picture)
    pen, font = ImageDraw.Draw(drawn), ImageFont.load_default(22)
    for name, axis_picture in (("world", render(world, floor=None, **view)), ("frame_id", alone)):
        rows, columns = np.nonzero(inked(axis_picture))
        pen.text((columns[rows.argmin()] - 14, rows.min() + 6), name, fill=INK, font=font, anchor="rm")
    drawn.save(DRAWING, quality=88)


def inked(picture: np.ndarray) -> np.ndarray:
    """(h, w) where something coloured is drawn."""
    return np.ptp(picture.astype(int), axis=-1) > 40


if __name__ == "__main__":
    main()

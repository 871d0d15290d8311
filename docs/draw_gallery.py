"""Draw `docs/gallery/`, clothes on bodies in motion: python docs/draw_gallery.py

Some minutes on one core. Needs the extras `[view,training]`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image

from import_graph import ROOT
from physkin_core import (
    BUNDLED_AVATAR,
    GarmentModel,
    Motion,
    Outfit,
    WornGarment,
    load_avatar,
    load_body_model,
    load_garment_model,
    load_motion,
)
from physkin_core.avatar.avatar import Avatar, avatar_from_body
from physkin_core.picture import Mesh, contact_sheet, render
from physkin_core.render.filming import draw_strip, dressed_meshes
from physkin_training.sampling.chosen_bodies import bodies_by_girth

GALLERY = ROOT / "docs" / "gallery"
GARMENTS = (
    *("tshirt", "longsleeve", "tanktop", "turtleneck", "hoodie", "trousers", "widetrousers"),
    *("shorts", "skirt", "circleskirt", "pencilskirt", "dress", "maxidress", "jumpsuit"),
)
IN_A_ROW = 2
MOTION, FRAME = "walk", 20
OUTFITS = {
    "T-shirt over trousers": ("trousers", "tshirt"),
    "T-shirt, tucked": ("tshirt*", "trousers"),
    "hoodie over trousers": ("trousers", "hoodie"),
    "hoodie, T-shirt, shorts": ("shorts", "tshirt", "hoodie"),
    "turtleneck, tucked": ("turtleneck*", "circleskirt"),
    "tank top, tucked": ("tanktop*", "pencilskirt"),
}
"""Garments from the skin outwards; * tucked."""
STRIPS = {"cartwheel": ("trousers", "longsleeve"), "kick": ("tshirt*", "trousers"), "jump": ("dress",)}
FRAMES = 8
SIZE, QUALITY = (150, 210), 84


def named(names: Sequence[str]) -> list[WornGarment]:
    """Shipped garments; * tucked."""
    return [WornGarment(load_garment_model(name.rstrip("*")), tucked=name.endswith("*")) for name in names]


def lean_to_stout(count: int) -> list[Avatar]:
    """Held-out bodies, from the leanest to the stoutest."""
    bodies = load_body_model()
    return [avatar_from_body(bodies, bodies.held_out_bodies[index]) for index in bodies_by_girth(bodies, count)]


def meshes_at(outfit: Outfit, motion: Motion, frame: int) -> list[Mesh]:
    """An outfit in a frame of a motion, in the root frame."""
    positions = motion.positions_for(outfit.rig)[frame]
    cloth = outfit.drape(positions, motion.gravity[frame])
    return dressed_meshes(outfit, outfit.posed_body(positions), cloth)


def save(name: str, picture: np.ndarray) -> None:
    """As JPEG."""
    Image.fromarray(picture).save(GALLERY / f"{name}.jpg", quality=QUALITY, optimize=True)
    print(f"wrote {GALLERY / name}.jpg")


def draw_bodies() -> None:
    """Each garment on three bodies."""
    motion, avatars = load_motion(MOTION), lean_to_stout(3)
    worn = [Outfit(named([name]), avatar) for name in GARMENTS for avatar in avatars]
    pictures = [render(meshes_at(outfit, motion, FRAME), size=SIZE, azimuth=35) for outfit in worn]
    save("bodies", contact_sheet(pictures, columns=len(avatars) * IN_A_ROW, gap=2))


def draw_outfits() -> None:
    """Each from the front and, below it, from behind."""
    motion = load_motion(MOTION)
    worn = [meshes_at(_outfit(named(names)), motion, FRAME) for names in OUTFITS.values()]
    pictures = [render(meshes, size=SIZE, azimuth=azimuth) for azimuth in (30, 210) for meshes in worn]
    captions = [*len(OUTFITS) * [""], *OUTFITS]
    save("outfits", contact_sheet(pictures, columns=len(OUTFITS), captions=captions, gap=2))


def draw_motions() -> None:
    """Strips of frames, from the front and the back."""
    for name, names in STRIPS.items():
        strip = Image.fromarray(draw_strip(_outfit(named(names)), load_motion(name), FRAMES))
        save(name, np.array(strip.resize((strip.width * 2 // 3, strip.height * 2 // 3), Image.Resampling.LANCZOS)))


def _outfit(garments: Sequence[WornGarment]) -> Outfit:
    model: GarmentModel = garments[0].model
    return Outfit(garments, load_avatar(BUNDLED_AVATAR, model.rig))


if __name__ == "__main__":
    GALLERY.mkdir(exist_ok=True)
    draw_bodies()
    draw_outfits()
    draw_motions()

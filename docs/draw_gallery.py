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
GARMENTS = ("tshirt", "longsleeve", "trousers", "skirt", "dress")
POSES = (("walk", 20), ("dance", 45))
"""Motions, and a frame of each."""
OUTFITS = {
    "T-shirt over trousers": ("trousers", "tshirt"),
    "T-shirt, tucked": ("tshirt*", "trousers"),
    "T-shirt over skirt": ("skirt", "tshirt"),
    "long sleeve, tucked": ("longsleeve*", "trousers"),
    "dress over trousers": ("trousers", "dress"),
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
    """A row a garment: three bodies in two poses."""
    motions = [(load_motion(name), frame) for name, frame in POSES]
    avatars, pictures = lean_to_stout(3), []
    for name in GARMENTS:
        outfits = [Outfit(named([name]), avatar) for avatar in avatars]
        for motion, frame in motions:
            pictures += [render(meshes_at(outfit, motion, frame), size=SIZE, azimuth=35) for outfit in outfits]
    save("bodies", contact_sheet(pictures, columns=len(avatars) * len(POSES), gap=2))


def draw_outfits() -> None:
    """Each from the front and, below it, from behind."""
    motion, frame = load_motion("walk"), 30
    worn = [meshes_at(_outfit(named(names)), motion, frame) for names in OUTFITS.values()]
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

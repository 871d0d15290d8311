"""Draw `docs/gallery/` and `docs/drapes.jpg`, clothes on bodies in motion: python docs/draw_gallery.py

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

GALLERY, WARDROBE = ROOT / "docs" / "gallery", ROOT / "docs" / "drapes.jpg"
GARMENTS = {
    "tshirt": ("jersey:white", "jersey:bordeaux"),
    "longsleeve": ("jersey:navy", "cotton:beige"),
    "tanktop": ("rib:white", "jersey:olive"),
    "turtleneck": ("wool:bordeaux", "rib:black"),
    "hoodie": ("jersey:grey", "wool:green"),
    "trousers": ("denim", "cotton:beige"),
    "widetrousers": ("wool:grey", "cotton:white"),
    "shorts": ("cotton:olive", "denim"),
    "skirt": ("denim", "wool:brown"),
    "circleskirt": ("cotton:red", "silk:indigo"),
    "pencilskirt": ("wool:black", "leather"),
    "dress": ("cotton:blue", "silk:bordeaux"),
    "maxidress": ("silk:teal", "cotton:ochre"),
    "jumpsuit": ("denim:indigo", "cotton:olive"),
}
"""Shipped garments, and what they are of: seen from the front, and from behind."""
MOTION, FRAME = "walk", 20
OUTFITS = {
    "T-shirt over trousers": ("trousers:denim", "tshirt:jersey:white"),
    "T-shirt, tucked": ("tshirt:jersey:red*", "trousers:cotton:beige"),
    "hoodie over trousers": ("trousers:denim:black", "hoodie:jersey:grey"),
    "hoodie, T-shirt, shorts": ("shorts:cotton:olive", "tshirt:jersey:white", "hoodie:jersey:navy"),
    "turtleneck, tucked": ("turtleneck:rib:black*", "circleskirt:wool:brown"),
    "tank top, tucked": ("tanktop:rib:white*", "pencilskirt:leather"),
}
"""Garments from the skin outwards; * tucked."""
WORN = (
    ("walk", 20, 0, OUTFITS["T-shirt over trousers"]),
    ("dance", 60, 1, ("dress:silk:bordeaux",)),
    ("walk", 44, 2, OUTFITS["hoodie over trousers"]),
    ("dance", 30, 0, OUTFITS["turtleneck, tucked"]),
    ("walk", 8, 1, ("jumpsuit:denim:indigo",)),
    ("dance", 90, 2, ("maxidress:cotton:teal",)),
)
"""What the README shows: motion, frame, which of three bodies from lean to stout, outfit."""
STRIPS = {
    "cartwheel": ("trousers:cotton:olive", "longsleeve:jersey:navy"),
    "kick": ("tshirt:jersey:white*", "trousers:denim"),
    "jump": ("dress:cotton:blue",),
}
FRAMES = 8
SIZE, LARGE, QUALITY = (150, 210), (270, 480), 84


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
    """Each garment on three bodies, from the front and from behind."""
    motion, avatars = load_motion(MOTION), lean_to_stout(3)
    pictures = []
    for name, fabrics in GARMENTS.items():
        for fabric, azimuth in zip(fabrics, (35, 215)):
            worn = (Outfit(named([f"{name}:{fabric}"]), avatar) for avatar in avatars)
            pictures += [render(meshes_at(outfit, motion, FRAME), size=SIZE, azimuth=azimuth) for outfit in worn]
    save("bodies", contact_sheet(pictures, columns=4 * len(avatars), gap=2))


def draw_wardrobe() -> None:
    """The README's picture."""
    avatars, pictures = lean_to_stout(3), []
    for clip, frame, body, names in WORN:
        meshes = meshes_at(Outfit(named(names), avatars[body]), load_motion(clip), frame)
        pictures.append(render(meshes, size=LARGE, azimuth=30, samples=32))
    Image.fromarray(contact_sheet(pictures, columns=len(WORN), gap=0)).save(WARDROBE, quality=QUALITY, optimize=True)
    print(f"wrote {WARDROBE}")


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
    draw_wardrobe()
    draw_bodies()
    draw_outfits()
    draw_motions()

"""Draw `docs/gallery/` and the film `docs/wardrobe.webp`, clothes on bodies in motion: python docs/draw_gallery.py

About half an hour on one core, most of it for the film. Needs the extras `[view,training]`.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from PIL import Image
from scipy.spatial.transform import Rotation

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
from physkin_core.pictures.picture import Mesh, contact_sheet, render
from physkin_core.render.film_files import write_film
from physkin_core.render.filming import draw_strip, dressed_meshes
from physkin_training.sampling.chosen_bodies import bodies_by_girth

GALLERY, WARDROBE = ROOT / "docs" / "gallery", ROOT / "docs" / "wardrobe.webp"
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
WARDROBE_WORN = (
    ("turtleneck:rib:black*", "circleskirt:wool:brown"),
    ("trousers:denim", "tshirt:jersey:white"),
    ("dress:silk:teal",),
)
"""What dances in the README, from the lean to the stout body."""
RATE = 15.0
"""[Hz] of the README's film."""
NEARER = 0.78
"""Share of the room that a camera would show of the film: corners of that room stay empty."""
STRIPS = {
    "cartwheel": ("trousers:cotton:olive", "longsleeve:jersey:navy"),
    "kick": ("tshirt:jersey:white*", "trousers:denim"),
    "jump": ("dress:cotton:blue",),
}
FRAMES = 8
SIZE, FILM, QUALITY = (150, 210), (300, 420), 84


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
    """The film in the README: three bodies that dance in real fabrics, which sway."""
    figures = [_dancing(Outfit(named(names), avatar)) for names, avatar in zip(WARDROBE_WORN, lean_to_stout(3))]
    everything = np.concatenate([mesh.vertices for figure in figures for meshes in figure for mesh in meshes])
    low, high = everything.min(axis=0), everything.max(axis=0)
    bounds = (low + high) / 2 + NEARER * np.stack([low - high, high - low]) / 2
    views = [[_filmed(meshes, bounds, low[2]) for meshes in frame] for frame in zip(*figures)]
    write_film(WARDROBE, [contact_sheet(pictures, columns=len(figures), gap=0) for pictures in views], RATE)
    print(f"wrote {WARDROBE}")


def _dancing(outfit: Outfit) -> list[list[Mesh]]:
    """Body and cloth in each frame of the second round of `dance`, upright, the root above the origin; so that the
    film's end goes on with its beginning."""
    once = load_motion("dance")
    motion = once.looped(2 * once.frame_count / once.rate_hz).resampled(RATE)
    frames = []
    for positions, time, root in zip(motion.positions_for(outfit.rig), motion.times, motion.root):
        turn, place = Rotation.from_quat(root[3:]), root[:3] * [0, 0, 1]
        clouds = outfit.drape(positions, time=time, root=root)
        body, *cloth = (turn.apply(points[:, :3]) + place for points in (outfit.posed_body(positions), *clouds))
        frames.append(dressed_meshes(outfit, body, cloth))
    return frames[len(frames) // 2 : -1]  # the last is the first again


def _filmed(meshes: list[Mesh], bounds: np.ndarray, floor: float) -> np.ndarray:
    return render(meshes, size=FILM, azimuth=20, bounds=bounds, floor=floor, samples=16)


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

"""Draw the pictures of docs/contact.md, `facing.svg` and `contact.webp`: python docs/draw_contact.py

The second needs the extras `[view,training]`; it shows clothes without contact with the skin, and with it.
"""

from __future__ import annotations

import math

from PIL import Image

from draw_gallery import lean_to_stout, named
from import_graph import ROOT
from physkin_core import Outfit, load_motion
from physkin_core.motion.motion import Motion
from physkin_core.pictures.picture import Mesh, contact_sheet, render
from physkin_core.render.filming import dressed_meshes

PICTURE, FACING = ROOT / "docs" / "contact.webp", ROOT / "docs" / "facing.svg"
MOMENTS = (("tshirt", "dance", 52, 40), ("hoodie", "kick", 16, 250))
"""Garment, bundled clip, frame at 30 Hz, and azimuth [degrees]."""
RATE = 30
SIZE, QUALITY = (280, 330), 86
SKIN, COUNTS, IGNORED, CLOTH = "#f3ddcb", "#c0392b", "#b9a595", "#2a6a94"


def played_to(outfit: Outfit, motion: Motion, frame: int) -> list[Mesh]:
    """Skin and cloth in a frame of a motion, with sway."""
    positions = motion.positions_for(outfit.rig)
    for k in range(frame + 1):
        cloth = outfit.drape(positions[k], time=motion.times[k], root=motion.root[k])
    return dressed_meshes(outfit, outfit.posed_body(positions[frame]), cloth)


def draw_moments() -> None:
    """Write `PICTURE`, two columns a moment: a stout body in a shipped garment, its skin drawn where it is."""
    avatar, pictures = lean_to_stout(3)[2], []
    for garment, clip, frame, azimuth in MOMENTS:
        outfit = Outfit(named([garment]), avatar, hide_covered=False)
        alone = outfit.with_bound_garment(0, outfit.layers[0].bound.without_contact)
        motion = load_motion(clip).resampled(RATE)
        for each in (alone, outfit):
            meshes = played_to(each, motion, frame)
            cloth = meshes[-1].vertices
            bounds = cloth.min(axis=0), cloth.max(axis=0)
            pictures.append(render(meshes, size=SIZE, azimuth=azimuth, bounds=bounds, floor=None))
    sheet = contact_sheet(pictures, columns=len(pictures), captions=["without", "with"] * len(MOMENTS))
    Image.fromarray(sheet).save(PICTURE, quality=QUALITY)
    print(f"wrote {PICTURE}")


def facing() -> str:
    """The SVG of the facing rule: cloth deep in a leg, and cloth that an arm presses on."""
    leg, arm = (170, 160, 78), (655, 160, 52)
    parts = [
        _round(*leg),
        *(_point(*leg, 30 * k, counts=abs((30 * k + 180) % 360 - 180) < 90) for k in range(12)),
        _cloth("M145 50V270", outside=1),
        f'<path d="M145 50C150 74 252 90 253 160C252 230 150 246 145 270" {_stroke(CLOTH)} stroke-dasharray="6 5"/>',
        _arrow(145, 160, 246),
        '<path d="M470 50Q505 160 470 270H430V50z" fill="' + SKIN + '"/>',
        _round(*arm),
        *(_point(*arm, 45 * k, counts=45 < (45 * k) % 360 < 315 and 45 * k not in (90, 270)) for k in range(8)),
        _cloth("M635 50V270", outside=1),
        f'<path d="M635 50C632 80 599 110 599 160C599 210 632 240 635 270" {_stroke(CLOTH)} stroke-dasharray="6 5"/>',
        _arrow(635, 160, 606),
        _text(170, 306, "skin beneath", bold=True),
        _text(170, 326, "the nearest skin is on the left, but faces away"),
        _text(635, 306, "skin that presses", bold=True),
        _text(635, 326, "an arm's skin counts where it faces the cloth"),
    ]
    style = 'xmlns="http://www.w3.org/2000/svg" font-family="Helvetica, Arial, sans-serif"'
    head = '<marker id="head" orient="auto" markerWidth="6" markerHeight="6" refX="5" refY="3">'
    lines = (
        f'<svg {style} viewBox="0 0 860 340">',
        "<title>The facing rule: which skin cloth is kept out of</title>",
        f'<defs>{head}<path d="M0 0L6 3L0 6z" fill="#222"/></marker></defs>',
        '<rect width="100%" height="100%" fill="#fff"/>',
        *parts,
        "</svg>\n",
    )
    return "\n".join(lines)


def _round(x: float, y: float, radius: float) -> str:
    return f'<circle cx="{x}" cy="{y}" r="{radius}" fill="{SKIN}" stroke="{IGNORED}"/>'


def _point(x: float, y: float, radius: float, degrees: float, *, counts: bool) -> str:
    """A point of round skin, with its normal."""
    along, up = math.cos(math.radians(degrees)), -math.sin(math.radians(degrees))
    at, end = ((x + r * along, y + r * up) for r in (radius, radius + 16))
    colour = COUNTS if counts else IGNORED
    return (
        f'<path d="M{at[0]:.1f} {at[1]:.1f}L{end[0]:.1f} {end[1]:.1f}" {_stroke(colour)}/>'
        f'<circle cx="{at[0]:.1f}" cy="{at[1]:.1f}" r="4.5" fill="{colour}"/>'
    )


def _cloth(path: str, *, outside: int) -> str:
    """Cloth that hangs straight down, with normals to the right (1) or to the left (-1)."""
    start, top, bottom = (float(number) for number in path[1:].replace("V", " ").split())
    ticks = "".join(f"M{start:g} {y:g}h{14 * outside}" for y in range(int(top) + 15, int(bottom), 38))
    return f'<path d="{path}" {_stroke(CLOTH, 3.5)}/><path d="{ticks}" {_stroke(CLOTH)}/>'


def _arrow(start: float, y: float, end: float) -> str:
    return f'<path d="M{start} {y}H{end}" {_stroke("#222", 2.5)} marker-end="url(#head)"/>'


def _stroke(colour: str, width: float = 2) -> str:
    return f'stroke="{colour}" stroke-width="{width:g}" fill="none"'


def _text(x: float, y: float, said: str, *, bold: bool = False) -> str:
    style = 'fill="#222" text-anchor="middle"' + (' font-weight="bold"' if bold else "")
    return f'<text x="{x}" y="{y}" font-size="14" {style}>{said}</text>'


if __name__ == "__main__":
    FACING.write_text(facing())
    print(f"wrote {FACING}")
    draw_moments()

"""Draw `docs/concepts/flow.svg`, from body and joint state to cloth, of the T-shirt: python docs/draw_flow.py"""

from __future__ import annotations

from html import escape

from import_graph import ROOT
from physkin_core import GarmentModel, load_garment_model
from physkin_core.model.hyper_modulator import POINT_COUNT

__all__ = ["FLOW", "flow"]

FLOW = ROOT / "docs" / "concepts" / "flow.svg"
WIDTH, HEIGHT = 990, 425
DATA, NETWORK, RULE = "#eef2f6", "#fde3c8", "#dcefd8"
"""Colours of what is given or made, of networks, and of what is computed without one."""


def flow(model: GarmentModel) -> str:
    """The SVG of a model."""
    m, n, influences = len(model.node_rest), len(model.garment.vertices), model.influence_nodes.shape[1]
    joints = len(model.rig.joint_names)
    once = [
        _box(20, 50, 160, "a body", f"{POINT_COUNT:,} points of its skin", DATA),
        _line("M180 80H226"),
        _box(230, 50, 190, "hyper modulator", "a transformer layer", NETWORK),
        _line("M325 110V166"),
        _text(333, 132, "modulates", size=12),
        _line("M150 50V30H560V80H706"),
        _box(710, 50, 260, "rest shape, garment nodes", "graded to the body", RULE),
        _line("M900 110V301"),
    ]
    frame = [
        _box(20, 170, 160, "joint state", f"{joints} joints, gravity", DATA),
        _line("M180 200H226"),
        _box(230, 170, 190, "pose modulator", _sizes(model.pose_modulator), NETWORK),
        _line("M420 200H486"),
        _text(453, 192, "modulates", size=12, anchor="middle"),
        _line("M100 230V301"),
        _box(20, 305, 160, "bones", "forward kinematics", RULE),
        _line("M180 335H226"),
        _box(230, 305, 190, "posed garment nodes", f"{m}, each with its bone", RULE),
        _line("M420 322H510V234"),
        _box(490, 170, 240, "node deformer", _sizes(model.node_deformer), NETWORK),
        _line("M660 230V301"),
        _text(668, 270, "corrections", size=12),
        _line("M420 348H536"),
        _box(540, 305, 204, "corrected garment nodes", "affine frames", RULE),
        _line("M744 335H786"),
        _box(790, 305, 180, "skinning", f"{influences} garment nodes a vertex", RULE),
        _line("M880 365V392"),
    ]
    texts = [
        _text(20, 34, "once per body", size=14, colour="#777"),
        _text(20, 163, "every frame", size=14, colour="#777"),
        _text(880, 410, f"{n:,} positions and normals", size=13, anchor="middle"),
    ]
    style = 'xmlns="http://www.w3.org/2000/svg" font-family="Helvetica, Arial, sans-serif"'
    head = '<marker id="head" orient="auto" markerWidth="7" markerHeight="7" refX="6" refY="3.5">'
    lines = [
        f'<svg {style} viewBox="0 0 {WIDTH} {HEIGHT}">',
        "<title>From a body and a joint state to draped cloth</title>",
        f'<defs>{head}<path d="M0 0L7 3.5L0 7z" fill="#444"/></marker></defs>',
        '<rect width="100%" height="100%" fill="#fff"/>',
        f'<path d="M12 148H{WIDTH - 12}" stroke="#bbb" stroke-dasharray="5 5"/>',
        *once,
        *frame,
        *texts,
        "</svg>\n",
    ]
    return "\n".join(lines)


def _sizes(layers) -> str:
    return " → ".join(str(size) for size in (layers[0][0].shape[1], *(len(bias) for _, bias in layers)))


def _box(x: int, y: int, width: int, name: str, said: str, colour: str) -> str:
    middle = x + width / 2
    return (
        f'<rect x="{x}" y="{y}" width="{width}" height="60" rx="8" fill="{colour}" stroke="#8a8a8a"/>'
        + _text(middle, y + 26, name, size=14, bold=True, anchor="middle")
        + _text(middle, y + 46, said, size=11, anchor="middle")
    )


def _line(path: str) -> str:
    return f'<path d="{path}" stroke="#444" stroke-width="1.8" fill="none" marker-end="url(#head)"/>'


def _text(x: float, y: float, said: str, *, size: int, bold=False, anchor="start", colour="#222") -> str:
    weight = ' font-weight="bold"' if bold else ""
    style = f'font-size="{size}" fill="{colour}" text-anchor="{anchor}"{weight}'
    return f'<text x="{x:g}" y="{y:g}" {style}>{escape(said)}</text>'


if __name__ == "__main__":
    FLOW.parent.mkdir(exist_ok=True)
    FLOW.write_text(flow(load_garment_model("tshirt")))
    print(f"wrote {FLOW}")

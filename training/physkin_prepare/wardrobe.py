"""Sew the wardrobe: twenty-two garments from the sewing patterns in training/garments/patterns, on the garment body.

`python -m physkin_prepare.wardrobe [--names ...] [--output training/garments] [--device cpu]` writes one OBJ file each,
in the root frame of the template, with the panels as parts and texture coordinates in metres along the grain.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from pathlib import Path

from physkin_core.avatar.avatar import avatar_from_body
from physkin_core.avatar.body_model import load_body_model
from physkin_training.devices import DEFAULT_DEVICE, DEVICE_HELP, resolve_device
from physkin_training.fit_garment.checks import check_garment, write_garment
from physkin_training.fit_garment.sewn_mesh import sewn_mesh

__all__ = ["EDGE_LENGTHS", "main"]

PATTERNS = Path(__file__).parents[1] / "garments" / "patterns"

EDGE_LENGTHS = {
    "tshirt": 0.0127,
    "longsleeve": 0.0141,
    "tanktop": 0.012,
    "turtleneck": 0.0139,
    "hoodie": 0.0166,
    "trousers": 0.0145,
    "widetrousers": 0.0157,
    "shorts": 0.012,
    "skirt": 0.0124,
    "circleskirt": 0.018,
    "pencilskirt": 0.012,
    "dress": 0.0192,
    "maxidress": 0.0229,
    "jumpsuit": 0.0182,
    "dressshirt": 0.0138,
    "polo": 0.0121,
    "ziphoodie": 0.0147,
    "cardigan": 0.0134,
    "blazer": 0.014,
    "coat": 0.0168,
    "leggings": 0.012,
    "pleatedskirt": 0.0138,
}
"""[m] of the triangles of each garment: 12 mm, or what gives 6,500 vertices."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Command line. Raises PatternError for what cannot be sewn, RuntimeError for what cannot be trained."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--names", nargs="+", choices=tuple(EDGE_LENGTHS), default=tuple(EDGE_LENGTHS))
    parser.add_argument("--output", type=Path, default=PATTERNS.parent, help="folder for NAME.obj")
    parser.add_argument("--device", default=DEFAULT_DEVICE, help=DEVICE_HELP)
    options = parser.parse_args(arguments)
    body_model = load_body_model()
    template = avatar_from_body(body_model, body_model.garment_body)
    options.output.mkdir(parents=True, exist_ok=True)
    device = resolve_device(options.device)
    for name in options.names:
        path, edge_length = PATTERNS / f"{name}.json", EDGE_LENGTHS[name]
        mesh = sewn_mesh(path, template, body_model.rig, edge_length=edge_length, device=device)
        checked = check_garment(mesh, template, template, sewn=True)
        if refused := checked.first("refused"):
            raise RuntimeError(f"{name}: {refused.check}: {refused.found}")
        write_garment(options.output / f"{name}.obj", checked)
        warnings = [f"{verdict.check}: {verdict.found}" for verdict in checked.verdicts if verdict.outcome != "ok"]
        print(f"{name}: {len(checked.vertices)} vertices{''.join(f'; {warning}' for warning in warnings)}", flush=True)


if __name__ == "__main__":
    main()

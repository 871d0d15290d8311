"""A page of static files on which an avatar moves and its cloth is computed in the visitor's browser (docs/browser.md).

Besides what every page has (native/web) a folder holds `outfit.physkin.gz`, what the evaluator loads, `dressed.glb`,
what is drawn, and `motion.json`. Dimensions: `T` frames, `d` joints.
"""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from physkin_core.export.gltf_dressed import dressed_glb
from physkin_core.formats.gltf_builder import FROM_ROOT_FRAME
from physkin_core.mesh.look import Look
from physkin_core.motion.motion import Motion
from physkin_core.native_module import native
from physkin_core.outfit.outfit import Outfit

__all__ = ["PAGE", "write_web_page"]

PAGE = Path(native.__file__).parent / "web"
"""What every page has; there if `make wasm` ran before the installation."""
DIGITS = 4
"""Of numbers of a motion, in radians and metres."""


def write_web_page(folder: Path, outfit: Outfit, motion: Motion, looks: Sequence[Look | None]) -> int:
    """Write the page into a folder, which is made if need be; returns its size [bytes]. looks: one a garment, as of
    `garment_looks`. Raises ValueError in an installation without the module for browsers."""
    if not PAGE.is_dir():
        raise ValueError(f"this installation has no module for browsers: {PAGE} is missing; `make wasm` makes it")
    shutil.copytree(PAGE, folder, dirs_exist_ok=True)
    (folder / "dressed.glb").write_bytes(dressed_glb(outfit, looks))
    (folder / "motion.json").write_text(json.dumps(_plain(motion, outfit), separators=(",", ":")))
    bound = folder / "outfit.physkin"
    outfit.save_bound(bound)
    (folder / "outfit.physkin.gz").write_bytes(gzip.compress(bound.read_bytes(), mtime=0))
    bound.unlink()
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _plain(motion: Motion, outfit: Outfit) -> dict:
    """positions: (T, d) in the outfit's order of joints; root: (T, 7) and wind: (3,) in glTF's axes."""
    root = np.concatenate(
        [
            motion.root_position @ FROM_ROOT_FRAME.T,
            motion.root_orientation[:, :3] @ FROM_ROOT_FRAME.T,
            motion.root_orientation[:, 3:],
        ],
        axis=1,
    )
    return {
        "name": motion.name,
        "rate": motion.rate_hz,
        "positions": motion.positions_for(outfit.rig).astype(float).round(DIGITS).tolist(),
        "root": root.astype(float).round(DIGITS).tolist(),
        "wind": (FROM_ROOT_FRAME @ outfit.wind).round(DIGITS).tolist(),
    }

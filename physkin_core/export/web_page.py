"""A page of static files on which an avatar moves and its cloth is computed in the visitor's browser (docs/browser.md).

Besides what every page has (native/web) a folder holds `outfit.physkin.gz`, what the evaluator loads, `dressed.glb`,
what is drawn, and `motion.json`; with a camera also `mediapipe`, which finds landmarks, and `camera.json`, with numbers
of the reader of landmarks (native/web/landmarks.js). Dimensions: `T` frames, `d` joints.
"""

from __future__ import annotations

import gzip
import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from physkin_core.avatar.body_model import load_body_model
from physkin_core.export.gltf_dressed import dressed_glb
from physkin_core.mesh.look import Look
from physkin_core.motion.landmarks import LandmarkReader
from physkin_core.motion.motion import Motion
from physkin_core.motion.retargeting import leg_length
from physkin_core.native_module import native
from physkin_core.outfit.outfit import Outfit

__all__ = ["PAGE", "write_web_page"]

PAGE = Path(native.__file__).parent / "web"
"""What every page has; there if `make wasm` ran before the installation."""
FINDER = "mediapipe"
"""Folder of what finds landmarks: 12 MB, for pages with a camera."""
DIGITS = 4
"""Of numbers of a motion, in radians and metres."""


def write_web_page(
    folder: Path, outfit: Outfit, motion: Motion, looks: Sequence[Look | None], *, camera: bool = False
) -> int:
    """Write the page into a folder, which is made if need be; returns its size [bytes]. looks: one a garment, as of
    `garment_looks`. camera: whether the avatar can follow who looks at the page. Raises ValueError in an installation
    without the module for browsers, and where a camera is asked for garments of another rig than the default one."""
    needed = PAGE / FINDER if camera else PAGE
    if not needed.is_dir():
        raise ValueError(f"this installation has no module for browsers: {needed} is missing; `make wasm` makes it")
    plain, rig = _plain(motion, outfit), load_body_model().rig
    if camera and outfit.joint_names != rig.joint_names:
        raise ValueError("a camera moves garments of the default rig; these have one of their own: leave --camera out")
    shutil.copytree(PAGE, folder, dirs_exist_ok=True, ignore=None if camera else shutil.ignore_patterns(FINDER))
    if camera:
        legs = leg_length(replace(rig, heads=outfit.avatar.bone_heads))
        plain["camera"] = round(legs / leg_length(rig), DIGITS)
        (folder / "camera.json").write_text(LandmarkReader("mediapipe").to_json())
    (folder / "dressed.glb").write_bytes(dressed_glb(outfit, looks))
    (folder / "motion.json").write_text(json.dumps(plain, separators=(",", ":")))
    bound = folder / "outfit.physkin"
    outfit.save_bound(bound)
    (folder / "outfit.physkin.gz").write_bytes(gzip.compress(bound.read_bytes(), mtime=0))
    bound.unlink()
    return sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())


def _plain(motion: Motion, outfit: Outfit) -> dict:
    """positions: (T, d) in the outfit's order of joints; root: (T, 7) and wind: (3,) in glTF's axes."""
    root = motion.root[:, [1, 2, 0, 4, 5, 3, 6]]  # x left, y up, z forward
    return {
        "name": motion.name,
        "rate": motion.rate_hz,
        "positions": motion.positions_for(outfit.rig).astype(float).round(DIGITS).tolist(),
        "root": root.astype(float).round(DIGITS).tolist(),
        "wind": [round(float(outfit.wind[axis]), DIGITS) for axis in (1, 2, 0)],
    }

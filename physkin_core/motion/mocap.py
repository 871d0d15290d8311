"""Motion capture files, BVH and ASF/AMC, as clips."""

from __future__ import annotations

from pathlib import Path

from physkin_core.file_reading import LARGEST_FILE, read_bytes, reading
from physkin_core.motion.mocap_files import read_amc, read_bvh
from physkin_core.motion.motion import MotionError
from physkin_core.motion.source_clip import SourceClip

__all__ = ["AMC_RATE_HZ", "read_mocap"]

AMC_RATE_HZ = 120.0
"""An AMC file does not state its rate; this is that of the CMU database."""
LARGEST_SKELETON = 1 << 22
"""[bytes] of an ASF file: that of 1,000 bones has some hundred thousand."""


def read_mocap(path: Path, *, skeleton: str | Path | None = None) -> SourceClip:
    """Read a .bvh file, or an .amc as if recorded at `AMC_RATE_HZ`. skeleton: the .asf of an .amc; None: `02.asf` for
    `02_02.amc`. Raises MotionError, and what `read_bvh` and `read_amc` raise."""
    if path.suffix.lower() == ".bvh":
        return read_bvh(_text(path)).clip()
    asf = Path(skeleton) if skeleton else path.with_name(f"{path.stem.split('_')[0]}.asf")
    with reading(f"skeleton {asf}", MotionError):
        bones = _text(asf, LARGEST_SKELETON)
    return read_amc(_text(path), bones, AMC_RATE_HZ).clip()


def _text(path: Path, most: int = LARGEST_FILE) -> str:
    return read_bytes(path, most=most).decode().replace("\r\n", "\n").replace("\r", "\n")

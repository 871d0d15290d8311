"""FBX files as glTF: read by ufbx, in a process that may die of it."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from importlib.util import find_spec

from physkin_core.file_reading import ContentError

__all__ = ["FBX_SUFFIX", "MOST_MEMORY", "REFUSED", "WITHIN", "fbx_as_glb"]

FBX_SUFFIX = ".fbx"
MOST_MEMORY, WITHIN = 2048, 60
"""[MiB] and [s] that reading a file may take."""
REFUSED = 3
"""Exit status of a process whose answer is what is wrong with the file."""


def fbx_as_glb(content: bytes, *, clips: bool) -> bytes:
    """A GLB of an FBX file: metres, Y up, nodes in the bind pose, pictures beside the file named as they are there.

    clips: whether its takes are wanted, sampled at 60 Hz at most. Raises ContentError where it cannot be read.
    """
    if find_spec("ufbx") is None:
        raise ContentError("it is FBX; to read it: pip install ufbx")
    command = [sys.executable, "-P", "-m", "physkin_core.formats.fbx_conversion", "clips" if clips else "figure"]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(map(os.path.abspath, sys.path))}
    try:
        done = subprocess.run(command, input=content, env=environment, timeout=WITHIN, capture_output=True)
    except subprocess.TimeoutExpired as error:
        raise ContentError(f"it could not be read within {WITHIN} s; use a smaller file") from error
    if done.returncode == REFUSED:
        raise ContentError(done.stdout.decode(errors="replace"))
    if done.returncode:
        code = done.returncode
        ended = signal.Signals(-code).name if code < 0 else f"exit status {code}"
        raise ContentError(f"the process that read it was ended ({ended}); it is damaged, export it again")
    return done.stdout

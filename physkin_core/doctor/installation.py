"""The run time itself: Python, the evaluator, what is shipped, a frame, and the extras."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, version
from importlib.util import find_spec

import numpy as np

from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.doctor.doctor import Finding
from physkin_core.extras import EXTRAS, install_command
from physkin_core.model.model_file import load_garment_model, shipped_models
from physkin_core.motion.loading import bundled_motions, load_motion
from physkin_core.outfit.draper import Draper
from physkin_core.runtime.evaluator import supported_instruction_sets

__all__ = ["look"]

AGREEMENT = 1e-3  # [m] of a drape with rounded network weights and one without
REINSTALL = f"install again: {install_command(options='--force-reinstall --no-deps')}"


def look() -> Iterator[Finding]:
    """One finding after the other."""
    try:
        installed = version("physkin")
    except PackageNotFoundError:
        installed = "in a source folder or a colcon workspace"
    yield Finding("physkin", "good", f"{installed}, Python {platform.python_version()}, {platform.machine()}")
    yield _instruction_set()
    for subject, check in (("garment models", _models), ("motions", _motions), ("a frame", _frame)):
        try:
            yield Finding(subject, "good", check())
        except ValueError as error:
            yield Finding(subject, "broken", str(error), REINSTALL)
    yield from map(_extra, EXTRAS)


def _instruction_set() -> Finding:
    sets, forced = supported_instruction_sets(), os.environ.get("PHYSKIN_NATIVE_ISA")
    if forced is None:
        is_slow = len(sets) == 1 and platform.machine() == "x86_64"
        slow = "; without AVX2 a frame takes several times as long" if is_slow else ""
        return Finding("evaluator", "good", f"instruction set {sets[-1]}{slow}")
    said = f"PHYSKIN_NATIVE_ISA={forced}; this CPU has {', '.join(sets)}"
    if forced in sets:
        return Finding("evaluator", "good", said)
    return Finding("evaluator", "broken", said, "unset PHYSKIN_NATIVE_ISA")


def _models() -> str:
    """Reading checks digests, shapes and values."""
    return _all_read({name: load_garment_model(name) for name in shipped_models()})


def _motions() -> str:
    return _all_read({name: load_motion(name) for name in bundled_motions()})


def _all_read(found: dict[str, object]) -> str:
    if not found:
        raise ValueError("none are shipped")
    return f"{len(found)} shipped, all read: {', '.join(found)}"


def _frame() -> str:
    """The bundled avatar in a garment: kernels for whole numbers against those for fp32."""
    model = load_garment_model("tshirt")
    avatar = load_avatar(BUNDLED_AVATAR, model.rig)
    rounded, exact = (Draper(model, avatar, fit=0.0, precision=each).drape({}) for each in ("int8", "fp32"))
    apart = float(np.abs(rounded[:, :3] - exact[:, :3]).max())
    said = f"T-shirt on the bundled avatar; its drapes in int8 and fp32 differ by {1e3 * apart:.2f} mm"
    if not apart <= AGREEMENT:
        raise ValueError(f"{said}, allowed: {1e3 * AGREEMENT:g} mm")
    return said


def _extra(extra: str) -> Finding:
    missing = [package for package in EXTRAS[extra] if find_spec(package) is None]
    if missing:
        said = f"lacks {', '.join(missing)}" if len(missing) < len(EXTRAS[extra]) else "not installed"
        return Finding(f"[{extra}]", "note", said, install_command(extra))
    return Finding(f"[{extra}]", "good", "installed")

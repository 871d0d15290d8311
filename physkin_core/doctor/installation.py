"""The run time itself: Python, the evaluator, what is shipped, a frame, and the extras."""

from __future__ import annotations

import os
import platform
import shutil
import sysconfig
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

COMPILERS = ("g++", "clang++", "c++")
AGREEMENT = 1e-3  # [m] of a drape with rounded network weights and one without
REINSTALL = f"install again: {install_command(options='--force-reinstall --no-deps')}"


def look() -> Iterator[Finding]:
    """One finding after the other."""
    yield _version()
    yield _instruction_set()
    yield from _shipped()
    yield _frame()
    yield _compiler()
    yield from map(_extra, EXTRAS)


def _version() -> Finding:
    try:
        installed = version("physkin")
    except PackageNotFoundError:
        installed = "in a source folder or a colcon workspace"
    return Finding("physkin", "good", f"{installed}, Python {platform.python_version()}, {platform.machine()}")


def _instruction_set() -> Finding:
    sets, forced = supported_instruction_sets(), os.environ.get("PHYSKIN_NATIVE_ISA")
    has = f"this CPU has {', '.join(sets)}"
    if forced is None:
        is_slow = len(sets) == 1 and platform.machine() == "x86_64"
        slow = "; without AVX2 a frame takes several times as long" if is_slow else ""
        return Finding("evaluator", "good", f"instruction set {sets[-1]}{slow}")
    if forced in sets:
        return Finding("evaluator", "good", f"instruction set {forced}, as PHYSKIN_NATIVE_ISA says; {has}")
    return Finding("evaluator", "broken", f"PHYSKIN_NATIVE_ISA={forced}: {has}", "unset PHYSKIN_NATIVE_ISA")


def _shipped() -> Iterator[Finding]:
    """Files that every command may need; reading checks their digests, shapes and values."""
    for subject, names, load in (
        ("garment models", shipped_models(), load_garment_model),
        ("motions", bundled_motions(), load_motion),
    ):
        try:
            for name in names:
                load(name)
        except ValueError as error:
            yield Finding(subject, "broken", str(error), REINSTALL)
            continue
        state, remedy = ("good", "") if names else ("broken", REINSTALL)
        yield Finding(subject, state, f"{len(names)} shipped, all read: {', '.join(names)}", remedy)


def _frame() -> Finding:
    """The bundled avatar in a garment: kernels for whole numbers against those for fp32."""
    try:
        model = load_garment_model("tshirt")
        avatar = load_avatar(BUNDLED_AVATAR, model.rig)
        rounded, exact = (Draper(model, avatar, fit=0.0, precision=each).drape({}) for each in ("int8", "fp32"))
    except ValueError as error:
        return Finding("a frame", "broken", str(error), REINSTALL)
    apart = float(np.abs(rounded[:, :3] - exact[:, :3]).max())
    said = f"T-shirt on the bundled avatar; its drapes in int8 and fp32 differ by {1e3 * apart:.2f} mm"
    if not apart <= AGREEMENT:
        return Finding("a frame", "broken", said, f"{REINSTALL}; if that does not help, report it with this output")
    return Finding("a frame", "good", said)


def _compiler() -> Finding:
    for name in (sysconfig.get_config_var("CXX") or "").split()[:1] + list(COMPILERS):
        if path := shutil.which(name):
            return Finding("compiler", "good", f"{path} (only needed to build from source)")
    remedy = "to build from source: apt install g++, or another GCC or Clang with C++17"
    return Finding("compiler", "note", "none found; a wheel needs none", remedy)


def _extra(extra: str) -> Finding:
    missing = [package for package in EXTRAS[extra] if find_spec(package) is None]
    if missing:
        said = f"lacks {', '.join(missing)}" if len(missing) < len(EXTRAS[extra]) else "not installed"
        return Finding(f"[{extra}]", "note", said, install_command(extra))
    return Finding(f"[{extra}]", "good", "installed")

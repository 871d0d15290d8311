"""Options of every command that puts on garments, and the garments that they ask for."""

from __future__ import annotations

import argparse
import logging
import sys
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from physkin_core.avatar.avatar import Avatar
from physkin_core.avatar.loading import BUNDLED_AVATAR, load_avatar
from physkin_core.model.model_file import load_garment_model, split_fabric
from physkin_core.motion.loading import bundled_motions, load_motion
from physkin_core.motion.motion import Motion
from physkin_core.outfit.coverage import OWN_CLOTHES
from physkin_core.outfit.outfit import Outfit
from physkin_core.progress import progress_line
from physkin_core.rig.rig import Rig
from physkin_core.runtime.layer import WornGarment
from physkin_core.separation.limb_separator import separated_motion

log = logging.getLogger(__name__)

__all__ = [
    "OPTIONS",
    "add_avatar_options",
    "add_options",
    "add_outfit_options",
    "as_asked",
    "as_option",
    "chosen_avatar",
    "chosen_garments",
    "dressed",
    "named_garments",
    "motion_settings",
    "print_warnings",
    "read_motion",
    "the_garment",
]

DEFAULT = "tshirt"


OPTIONS: dict[str, dict[str, Any]] = {
    "rig": {"metavar": "FILE", "help": "rig file of an avatar without a skeleton"},
    "bones": {
        "metavar": "FILE",
        "help": "which joint is which bone, in files that are not PhySkin's own (default: NAME.bones.json beside each)",
    },
    "source-rate": {
        "type": float,
        "metavar": "HZ",
        "help": "rate at which a motion file's clip was recorded (default: what the file says, 120 for an .amc)",
    },
    "rate": {"type": float, "metavar": "HZ", "help": "frames a second (default: the motion's own)"},
    "own-clothes": {
        "choices": OWN_CLOTHES,
        "default": OWN_CLOTHES[0],
        "help": "clothes that the avatar wears already: replaced where garments cover them (default), all hidden, or "
        "all kept",
    },
    "garment": {
        "action": "append",
        "metavar": "MODEL",
        "help": "garment: a shipped name or a file (default {worn}); fabric and colour may follow, as in "
        "skirt:denim:navy. Repeat it for an outfit, from the skin outwards",
    },
    "tucked": {
        "action": "append",
        "default": [],
        "metavar": "MODEL",
        "help": "garment to tuck into the waistband of the next one; repeat it for several",
    },
    "fit": {
        "type": float,
        "metavar": "F",
        "help": "1: made to measure, 0: one size, or between (default: 1; 0 with a rig other than the body model's)",
    },
    "separate-limbs": {
        "action": argparse.BooleanOptionalAction,
        "default": True,
        "help": "whether arms and legs that a motion puts into the trunk or into each other are moved out (default: "
        "%(default)s)",
    },
    "sway": {
        "type": float,
        "default": 1.0,
        "metavar": "S",
        "help": "how much cloth swings with the root, 0 to 1 (default 1)",
    },
    "wind": {
        "type": float,
        "nargs": 3,
        "default": (0.0, 0.0, 0.0),
        "metavar": ("X", "Y", "Z"),
        "help": "velocity of the air in the motion's world, Z up, at most 13 m/s (default: still air)",
    },
}
"""Of several commands, as `argparse` has them. None of them is checked before `Outfit` takes it."""


def as_option(name: str, value: Any) -> Any:
    """An option's value as `argparse` gives it, of a table's cell: text as on a command line, or JSON's types.

    Raises ValueError naming option and value."""
    how, words = OPTIONS.get(name, {}), value if isinstance(value, list) else str(value).split()
    with suppress(KeyError, TypeError, ValueError):
        if how.get("action") is argparse.BooleanOptionalAction:
            return {"true": True, "false": False}[str(value).lower()]
        if how.get("action") == "append":
            return list(map(str, words))
        if "type" in how:
            (*numbers,) = map(how["type"], words)
            if len(numbers) == how.get("nargs", 1):
                return numbers if "nargs" in how else numbers[0]
        elif value in how.get("choices", [value]):
            return str(value)
    raise ValueError(f"{name} {value!r} is not allowed; it is: {how['help']}")


def add_options(parser: argparse.ArgumentParser, *names: str, worn: str = DEFAULT) -> None:
    """Add some of `OPTIONS`. worn: what help says is worn where no garment is named."""
    for name in names:
        flags = ("-g", "--garment") if name == "garment" else (f"--{name}",)
        parser.add_argument(*flags, **OPTIONS[name] | {"help": OPTIONS[name]["help"].replace("{worn}", worn)})


def add_avatar_options(parser: argparse.ArgumentParser, made_on: bool = False) -> None:
    """Add `--avatar`, `--rig` and `--bones`. made_on: of a garment that is no model yet: None then stands for the body
    that shipped ones were made on; else the bundled one is the default."""
    default, said = (None, "that of the shipped garments") if made_on else (BUNDLED_AVATAR, "the bundled one")
    parser.add_argument("--avatar", metavar="AVATAR", default=default, help=f"avatar file (default: {said})")
    add_options(parser, "rig", "bones")


def add_outfit_options(parser: argparse.ArgumentParser) -> None:
    """Add who wears what, for commands whose avatar is an option."""
    add_avatar_options(parser)
    add_options(parser, "own-clothes", "garment", "tucked", "fit")


def the_garment(names: Sequence[str] | None, taker: str) -> str:
    """The one file or shipped name that `--garment` gives to a command of one garment; a T-shirt where there is none.

    taker: what holds or drapes one, for the ValueError where several are named."""
    name, *more = names or [DEFAULT]
    if more:
        raise ValueError(f"{taker} one garment, got {len(names)}: {', '.join(names)}")
    return name


def named_garments(names: Sequence[str] | None, tucked: Sequence[str]) -> list[tuple[str, bool]]:
    """Garments by file or shipped name, from the skin outwards, and whether each is tucked in; a T-shirt where none is
    named. Raises ValueError when one is tucked that is not worn."""
    names = names or [DEFAULT]
    files = [split_fabric(name)[0] for name in names]
    for name in tucked:
        if name not in names and name not in files:
            raise ValueError(f"--tucked {name}: none of the garments, which are {', '.join(names)}")
    return [(name, name in tucked or file in tucked) for name, file in zip(names, files)]


def chosen_garments(names: Sequence[str] | None, tucked: Sequence[str]) -> list[WornGarment]:
    """The same, loaded. Raises ValueError, too, when a file is no model."""
    return [
        WornGarment(load_garment_model(name), tucked=is_tucked) for name, is_tucked in named_garments(names, tucked)
    ]


def chosen_avatar(options: argparse.Namespace, rig: Rig) -> Avatar:
    """The avatar of a command, the bundled one where none is named. Raises as `load_avatar`."""
    file = options.avatar or BUNDLED_AVATAR
    return load_avatar(file, rig, rig_file=options.rig, bones=None if file == BUNDLED_AVATAR else options.bones)


def dressed(
    options: argparse.Namespace, *, for_engines: bool = False, whole: bool = False, avatar: Avatar | None = None
) -> Outfit:
    """The garments on the avatar, as the options have them; prints what was assumed, and how garments sit if not well.

    whole: with what cannot be seen, as what is worn over it can be taken off. for_engines: whole, and where there is no
    detail with the skinning weights that engines take. avatar: default that of the options.
    Raises as `chosen_garments`, `load_avatar` and `Outfit`.
    """
    garments = chosen_garments(options.garment, options.tucked)
    if for_engines:
        garments = [
            replace(each, model=each.model.for_engines()) if each.model.detail is None else each for each in garments
        ]
    avatar = avatar or chosen_avatar(options, garments[0].model.rig)
    hide_covered, own_clothes = not (for_engines or whole), getattr(options, "own_clothes", OWN_CLOTHES[0])
    outfit = Outfit(garments, avatar, fit=options.fit, hide_covered=hide_covered, own_clothes=own_clothes)
    outfit.sway, outfit.wind = getattr(options, "sway", outfit.sway), getattr(options, "wind", outfit.wind)
    print_warnings(outfit.warnings)
    return outfit


def print_warnings(warnings: Sequence[str]) -> None:
    """On standard error, a line each."""
    for warning in warnings:
        print(f"warning: {warning}", file=sys.stderr)


def motion_settings(options: argparse.Namespace) -> dict[str, Any]:
    """What `load_motion` is told of a command's motion."""
    is_ours = options.motion in bundled_motions() or options.motion.endswith(".safetensors")
    return {"bones": None if is_ours else options.bones, "source_rate_hz": options.source_rate}


def as_asked(motion: Motion, options: argparse.Namespace, outfit: Outfit) -> Motion:
    """The motion with its limbs separated, where `--separate-limbs` is so and the avatar has limbs that can be."""
    if options.separate_limbs:
        try:
            return separated_motion(motion, outfit.rig, outfit.avatar)
        except ValueError as error:
            log.info("limbs are not separated: %s", error)
    return motion


def read_motion(options: argparse.Namespace) -> Motion:
    """The motion that a command is given, at `--rate` where it has that, with a line of progress.

    Raises MotionError for what is no motion, ValueError where it has no frame `--frame`."""
    motion = load_motion(options.motion, **motion_settings(options), watch=progress_line(f"reading {options.motion}"))
    if getattr(options, "rate", None) not in (None, motion.rate_hz):
        motion = motion.resampled(options.rate)
    if not 0 <= getattr(options, "frame", 0) < motion.frame_count:
        raise ValueError(f"motion {options.motion} has frames 0 to {motion.frame_count - 1}, not {options.frame}")
    return motion

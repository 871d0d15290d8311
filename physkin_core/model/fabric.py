"""What cloth a garment is made of, and in which colour: chosen when it is put on, at no cost per frame.

A drape at rest hangs on ratios alone. Cloth that weighs twice as much, or stretches twice as easily and bends half as
stiffly, hangs like the trained one under twice the gravity, which networks know from accelerated roots; what is left is
how stiffly it bends against how stiffly it stretches, which they learn, too (`optimisation.other_bending`). So weight
goes into the network weights for gravity, and bending into a bias of the hyper modulator.
"""

from __future__ import annotations

import math
import re
from dataclasses import asdict, dataclass, fields, replace
from numbers import Real

import numpy as np

from physkin_core.file_reading import shown
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.hyper_modulator import with_bending

__all__ = ["COLOURS", "FABRICS", "Fabric", "with_fabric", "parse_fabric", "split_colour"]

LIGHTEST, HEAVIEST = 0.25, 1.75
"""Weight over stretch that a garment may have, in times that of the trained cloth: networks know roots that accelerate
until nothing weighs anything, or three times as much."""


@dataclass(frozen=True)
class Fabric:
    """How cloth stretches and bends, and how heavy it is.

    Args:
        stretch: Young's modulus of the membrane [N/m].
        bend: stiffness of the dihedral energy [J].
        density: mass by area [kg/m2].

    Raises:
        ValueError: naming a value that is not a finite number above 0.

    Examples:
        >>> canvas = physkin.Fabric(stretch=400.0, bend=3e-5, density=0.3)
        >>> physkin.FABRICS["denim"].density
        0.4
    """

    stretch: float
    bend: float
    density: float

    def __post_init__(self) -> None:
        for name in (entry.name for entry in fields(self)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Real) or not 0 < float(value) < math.inf:
                raise ValueError(f"fabric {name} is {value!r}, allowed: a finite number above 0")
            object.__setattr__(self, name, float(value))


KEYS = {entry.name for entry in fields(Fabric)}
JERSEY = Fabric(stretch=200.0, bend=3e-6, density=0.2)
FABRICS = {
    "jersey": JERSEY,
    "silk": Fabric(stretch=130.0, bend=5e-7, density=0.06),
    "cotton": Fabric(stretch=250.0, bend=4e-6, density=0.12),
    "wool": Fabric(stretch=200.0, bend=7e-6, density=0.22),
    "rib": Fabric(stretch=140.0, bend=4e-6, density=0.23),
    "denim": Fabric(stretch=350.0, bend=5e-5, density=0.4),
    "leather": Fabric(stretch=800.0, bend=2.5e-4, density=0.55),
}
"""Fabrics by name, from measurements and textbooks (docs/notebook/fabrics.md). Jersey is the reference material."""


COLOURS = {
    "beige": (216, 200, 172),
    "black": (28, 28, 30),
    "blue": (38, 86, 158),
    "bordeaux": (96, 22, 40),
    "brown": (104, 72, 48),
    "green": (44, 110, 70),
    "grey": (128, 130, 134),
    "indigo": (42, 66, 114),
    "navy": (30, 40, 72),
    "ochre": (196, 134, 52),
    "olive": (98, 98, 56),
    "orange": (214, 112, 40),
    "pink": (226, 150, 166),
    "purple": (96, 60, 124),
    "red": (172, 36, 40),
    "rose": (196, 106, 116),
    "teal": (30, 112, 118),
    "white": (240, 239, 235),
    "yellow": (228, 188, 62),
}
"""Of clothes, sRGB from 0 to 255."""


def split_colour(text: str) -> tuple[str, tuple[float, float, float] | None]:
    """What follows a garment's name: the fabric, empty where none is named, and the colour, sRGB in [0, 1], None where
    none is. text: "denim", "denim:navy", "#334" or "denim:#2a3450". Raises ValueError saying which colours there are.
    """
    fabric, _, colour = text.rpartition(":")
    if not fabric and not _is_colour(text):
        return text, None
    if colour not in COLOURS and not re.fullmatch("#([0-9a-fA-F]{3}){1,2}", colour):
        raise ValueError(f"unknown colour {shown(colour)}; allowed: #rgb, #rrggbb, {', '.join(COLOURS)}")
    digits = colour[1:] if len(colour) == 7 else "".join(2 * digit for digit in colour[1:])
    red, green, blue = COLOURS[colour] if colour in COLOURS else bytes.fromhex(digits)
    return fabric, (red / 255, green / 255, blue / 255)


def _is_colour(text: str) -> bool:
    return text.startswith("#") or text in COLOURS


def parse_fabric(text: str) -> dict[str, float]:
    """Fields of `Fabric` that a text gives: all for a name, some for numbers such as "stretch=120+bend=3e-5", none for
    a colour alone. Raises ValueError saying what is allowed."""
    text, colour = split_colour(text)
    if not text and colour is not None:
        return {}
    if text in FABRICS:
        return asdict(FABRICS[text])
    try:
        pairs = [(name.strip(), float(number)) for name, number in (part.split("=") for part in text.split("+"))]
    except ValueError:
        pairs = []
    values = dict(pairs)
    if not pairs or len(values) < len(pairs) or not values.keys() <= KEYS:
        raise ValueError(
            f"unknown fabric {shown(text)}; allowed: {', '.join(FABRICS)}, or numbers, each once, as in "
            "stretch=120+bend=3e-5+density=0.2"
        )
    replace(JERSEY, **values)  # checks them
    return values


def _fabric_for(text: str, model: GarmentModel) -> Fabric:
    """A fabric by its name or by numbers, for a garment model (see `with_fabric`)."""
    said, material = parse_fabric(text), model.material
    text = split_colour(text)[0]
    own = Fabric(material.youngs_modulus, material.bending, material.density)
    if text not in FABRICS:
        return replace(own, **said)
    stretch, bend, density = (said[key] / getattr(JERSEY, key) for key in ("stretch", "bend", "density"))
    least, most = (2.0**octave for octave in model.bending_octaves)
    bend = min(max(bend / stretch, least), most) * stretch
    return Fabric(own.stretch * stretch, own.bend * bend, own.density * density)


def with_fabric(model: GarmentModel, fabric: Fabric | str) -> GarmentModel:
    """The same garment in another fabric and colour.

    Args:
        model: the garment as it was trained.
        fabric: a name ("denim"), numbers ("bend=2e-5+density=0.18"), a colour ("navy", "#334"), a name with a colour
            ("denim:navy"), or a `Fabric`. A name multiplies the material of the model by that fabric's ratios to
            jersey. If the model has not learnt cloth of this stiffness, it uses the nearest that it has learnt. Numbers
            are used as they are; numbers left out stay the model's own. A string also sets the colour and look of the
            cloth; a `Fabric` does not.

    Returns:
        A model like any other: it can be draped, saved and measured.

    Raises:
        ValueError: for an unknown name, and for a fabric outside of what the model has learnt, naming the limits.

    Examples:
        >>> skirt = physkin.with_fabric(physkin.load_garment_model("skirt"), "denim:navy")
        >>> canvas = physkin.Fabric(stretch=400.0, bend=3e-5, density=0.3)
        >>> stiff = physkin.with_fabric(physkin.load_garment_model("skirt"), canvas)
    """
    if isinstance(fabric, str):
        model = replace(model, fabric=fabric)
        if not parse_fabric(fabric):
            return model
    material = model.material
    if not model.hyper_modulator["bend"].any() or not material.bending:
        raise ValueError(
            f"garment model {model.name!r} cannot be made of another fabric: it is of another one already (take "
            "the model as it was trained), or has not learnt bending (train it with optimisation.other_bending)"
        )
    fabric = _fabric_for(fabric, model) if isinstance(fabric, str) else fabric
    stretch = fabric.stretch / material.youngs_modulus
    heavier = fabric.density / material.density / stretch
    stiffer = fabric.bend / material.bending / stretch
    least, most = (2.0**octave for octave in model.bending_octaves)
    for named, unit, own, times, limits in (
        (f"density {fabric.density:g}", "kg/m2", material.density, heavier, (LIGHTEST, HEAVIEST)),
        (f"bend {fabric.bend:g}", "J", material.bending, stiffer, (least, most)),
    ):
        if not limits[0] * 0.999 <= times <= limits[1] * 1.001:
            allowed = " to ".join(f"{limit * stretch * own:.3g}" for limit in limits)
            raise ValueError(
                f"{named} {unit} at stretch {fabric.stretch:g} N/m is not what {model.name!r} has learnt, "
                f"allowed: {allowed} {unit}"
            )
    weight, bias = model.pose_modulator[0]
    weight = weight.copy()
    weight[:, -3:] *= np.float32(heavier)
    return replace(
        model,
        hyper_modulator=with_bending(model.hyper_modulator, stiffer),
        pose_modulator=((weight, bias), *model.pose_modulator[1:]),
        material=replace(material, youngs_modulus=fabric.stretch, bending=fabric.bend, density=fabric.density),
        as_trained=model,
    )

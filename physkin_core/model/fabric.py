"""What cloth a garment is made of, chosen when it is put on: nothing a frame.

A drape at rest hangs on ratios alone. Cloth that weighs twice as much, or stretches twice as easily and bends half as
stiffly, hangs like the trained one under twice the gravity, which networks know from accelerated roots; what is left is
how stiffly it bends against how stiffly it stretches, which they learn, too (`optimisation.other_bending`). So weight
goes into the network weights for gravity, and bending into a bias of the hyper modulator.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields, replace
from numbers import Real

import numpy as np

from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.hyper_modulator import BENDING_OCTAVES, with_bending

__all__ = ["FABRICS", "Fabric", "fabric_of", "made_of"]

LIGHTEST, HEAVIEST = 0.75, 1.25
"""Weight over stretch, in those of the trained cloth, that a garment may have: lighter cloth comes out no better."""


@dataclass(frozen=True)
class Fabric:
    """stretch: Young's modulus of the cloth [N/m]. bend: stiffness of the dihedral energy [J]. density [kg/m2].

    Raises ValueError naming a value that is not above 0.
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
FABRICS = {
    "jersey": Fabric(stretch=60.0, bend=2.5e-5, density=0.2),
    "wool": Fabric(stretch=90.0, bend=1.5e-4, density=0.3),
    "denim": Fabric(stretch=120.0, bend=4.0e-4, density=0.4),
    "leather": Fabric(stretch=200.0, bend=1.3e-3, density=0.7),
}
"""Cloth by name. Jersey is the reference material; weights are usual ones, stiffness is relative to it."""


def fabric_of(text: str) -> Fabric:
    """A fabric by its name, or by numbers: "stretch=120+bend=3e-4+density=0.4". What is left out is jersey's.

    Raises ValueError saying what is allowed.
    """
    if text in FABRICS:
        return FABRICS[text]
    try:
        pairs = [(name.strip(), float(number)) for name, number in (part.split("=") for part in text.split("+"))]
    except ValueError:
        pairs = []
    values = dict(pairs)
    if not pairs or len(values) < len(pairs) or not values.keys() <= KEYS:
        raise ValueError(
            f"no fabric {text!r}; allowed: {', '.join(FABRICS)}, or numbers, each once, as in "
            "stretch=120+bend=3e-4+density=0.4"
        )
    return replace(FABRICS["jersey"], **values)


def made_of(model: GarmentModel, fabric: Fabric | str) -> GarmentModel:
    """The garment made of another fabric, by name (see `FABRICS`) or by numbers: a model like any other.

    Raises ValueError for a fabric that the model has not learnt, saying what is allowed.
    """
    fabric = fabric_of(fabric) if isinstance(fabric, str) else fabric
    material = model.material
    stretch = fabric.stretch / material.youngs_modulus
    heavier = fabric.density / material.density / stretch
    stiffer = fabric.bend / material.bending / stretch if material.bending else math.inf
    if not model.hyper_modulator["bend"].any():
        raise ValueError(
            f"garment model {model.name!r} is of another fabric already, take the model as it was trained; or it has "
            "learnt no bending, train it with optimisation.other_bending"
        )
    if not LIGHTEST * 0.999 <= heavier <= HEAVIEST * 1.001:
        allowed = " to ".join(f"{times * stretch * material.density:.3g}" for times in (LIGHTEST, HEAVIEST))
        raise ValueError(
            f"density {fabric.density:g} kg/m2 at stretch {fabric.stretch:g} N/m is not what {model.name!r} has "
            f"learnt, allowed: {allowed} kg/m2"
        )
    least, most = (2.0**octave for octave in BENDING_OCTAVES)
    if not least * 0.999 <= stiffer <= most * 1.001:
        allowed = " to ".join(f"{times * stretch * material.bending:.2g}" for times in (least, most))
        raise ValueError(
            f"bend {fabric.bend:g} J at stretch {fabric.stretch:g} N/m is not what {model.name!r} has learnt, "
            f"allowed: {allowed} J"
        )
    weight, bias = model.pose_modulator[0]
    weight = weight.copy()
    weight[:, -3:] *= np.float32(heavier)
    return replace(
        model,
        hyper_modulator=with_bending(model.hyper_modulator, stiffer),
        pose_modulator=((weight, bias), *model.pose_modulator[1:]),
        material=replace(material, youngs_modulus=fabric.stretch, bending=fabric.bend, density=fabric.density),
    )

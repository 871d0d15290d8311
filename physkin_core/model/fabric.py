"""What cloth a garment is made of, chosen when it is put on: nothing a frame.

A drape at rest hangs on ratios alone. Cloth that weighs twice as much, or stretches twice as easily and bends half as
stiffly, hangs like the trained one under twice the gravity, which networks know from accelerated roots; what is left is
how stiffly it bends against how stiffly it stretches, which they learn, too (`optimisation.other_bending`). So weight
goes into the network weights for gravity, and bending into a bias of the hyper modulator.
"""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass, fields, replace
from numbers import Real

import numpy as np

from physkin_core.file_reading import shown
from physkin_core.model.garment_model import GarmentModel
from physkin_core.model.hyper_modulator import with_bending

__all__ = ["FABRICS", "Fabric", "made_of", "said_of"]

LIGHTEST, HEAVIEST = 0.25, 1.75
"""Weight over stretch that a garment may have, in times that of the trained cloth: networks know roots that accelerate
until nothing weighs anything, or three times as much."""


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
JERSEY = Fabric(stretch=200.0, bend=3e-6, density=0.2)
FABRICS = {
    "jersey": JERSEY,
    "silk": Fabric(stretch=130.0, bend=5e-7, density=0.06),
    "cotton": Fabric(stretch=250.0, bend=4e-6, density=0.12),
    "wool": Fabric(stretch=200.0, bend=7e-6, density=0.22),
    "denim": Fabric(stretch=350.0, bend=5e-5, density=0.4),
    "leather": Fabric(stretch=800.0, bend=2.5e-4, density=0.55),
}
"""Cloth by name, from measurements and textbooks (docs/fabrics.md says which). Jersey is the reference material."""


def said_of(text: str) -> dict[str, float]:
    """What the name of a fabric, or numbers such as "stretch=120+bend=3e-5", say of it: some fields of `Fabric`.

    Raises ValueError saying what is allowed.
    """
    if text in FABRICS:
        return asdict(FABRICS[text])
    try:
        pairs = [(name.strip(), float(number)) for name, number in (part.split("=") for part in text.split("+"))]
    except ValueError:
        pairs = []
    values = dict(pairs)
    if not pairs or len(values) < len(pairs) or not values.keys() <= KEYS:
        raise ValueError(
            f"no fabric {shown(text)}; allowed: {', '.join(FABRICS)}, or numbers, each once, as in "
            "stretch=120+bend=3e-5+density=0.2"
        )
    replace(JERSEY, **values)  # checks them
    return values


def _fabric_for(text: str, model: GarmentModel) -> Fabric:
    """A fabric by its name or by numbers, for a garment model (see `made_of`)."""
    said, material = said_of(text), model.material
    own = Fabric(material.youngs_modulus, material.bending, material.density)
    if text not in FABRICS:
        return replace(own, **said)
    stretch, bend, density = (said[key] / getattr(JERSEY, key) for key in ("stretch", "bend", "density"))
    least, most = (2.0**octave for octave in model.bending_octaves)
    bend = min(max(bend / stretch, least), most) * stretch
    return Fabric(own.stretch * stretch, own.bend * bend, own.density * density)


def made_of(model: GarmentModel, fabric: Fabric | str) -> GarmentModel:
    """The garment made of another fabric, by name or by numbers (see `said_of`): a model like any other.

    A name stands for ratios to jersey, of what the model was trained as; where it has not learnt to bend so, for the
    nearest that it has learnt. Numbers are what they say, and what they leave out is the model's own.
    Raises ValueError for a fabric that the model has not learnt, saying what is allowed.
    """
    material = model.material
    if not model.hyper_modulator["bend"].any() or not material.bending:
        raise ValueError(
            f"garment model {model.name!r} is of another fabric already, take the model as it was trained; or it has "
            "learnt no bending, train it with optimisation.other_bending"
        )
    fabric = _fabric_for(fabric, model) if isinstance(fabric, str) else fabric
    stretch = fabric.stretch / material.youngs_modulus
    heavier = fabric.density / material.density / stretch
    stiffer = fabric.bend / material.bending / stretch
    if not LIGHTEST * 0.999 <= heavier <= HEAVIEST * 1.001:
        allowed = " to ".join(f"{times * stretch * material.density:.3g}" for times in (LIGHTEST, HEAVIEST))
        raise ValueError(
            f"density {fabric.density:g} kg/m2 at stretch {fabric.stretch:g} N/m is not what {model.name!r} has "
            f"learnt, allowed: {allowed} kg/m2"
        )
    least, most = (2.0**octave for octave in model.bending_octaves)
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

"""A trained garment: mesh, garment nodes, skinning weights, networks and the rig they were trained for.

Dimensions: `n` vertices, `f` faces, `m` garment nodes, `K` influences a vertex. Metres, root frame, canonical pose.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Real
from typing import Any, Literal, get_args

import numpy as np

from physkin_core.file_reading import shown
from physkin_core.model.detail import Detail
from physkin_core.model.garment import Garment
from physkin_core.model.hyper_modulator import BENDING_OCTAVES, HEADS, hyper_modulator_shapes
from physkin_core.model.mlp import Layer, modulation_size
from physkin_core.model.model_arrays import (
    Array,
    Chain,
    GarmentModelError,
    Named,
    Part,
    check_arrays,
    described,
    described_arrays,
)
from physkin_core.model.sway_network import SwayNetwork, drive_size, pose_size
from physkin_core.rig.rig import Rig

__all__ = ["GarmentModel", "Material", "RestAngles", "SkinnedGarment"]

RestAngles = Literal["flat", "as_made"]
MOST_OCTAVES = 16
SHORTEST_NORMAL = 1e-3
"""Rest normals may have any length from here on."""
NORMAL_STEP, WEIGHT_STEP, ENGINE_WEIGHT_STEP = 2.0**-9, 1 / 4095, 1 / 255
"""What the file holds whole multiples of. Unit normals are kept to 0.1 degrees, and engines take bytes. The skinning
weights of neighbours are rounded each their own way: with 1 / 1023 that strained a T-shirt by 0.017 points; so, 0.001.
"""


@dataclass(frozen=True)
class Material:
    """The cloth that a garment was trained as. The defaults are the reference material: jersey, flat at rest.

    Attributes:
        youngs_modulus: [N/m] of the StVK membrane.
        poisson_ratio: of the StVK membrane.
        bending: [J], stiffness of the dihedral energy.
        density: [kg/m2].
        contact_offset: [m] from the body.
        contact_stiffness: [J/m4]; energy = stiffness * vertex area * depth^2.
        rest_angles: "flat" for cloth that bends from the plane, as woven and knitted cloth does; "as_made" for cloth
            that bends from the shape of its mesh.

    Raises:
        ValueError: for a value that is not a finite number or has no physical meaning, naming what is allowed.

    Examples:
        >>> physkin.load_garment_model("tshirt:denim").material.density
        0.4
    """

    youngs_modulus: float = 200.0
    poisson_ratio: float = 0.25
    bending: float = 3e-6
    density: float = 0.2
    contact_offset: float = 0.003
    contact_stiffness: float = 4.0e6
    rest_angles: RestAngles = "flat"

    def __post_init__(self) -> None:
        if self.rest_angles not in get_args(RestAngles):
            allowed = " or ".join(map(repr, get_args(RestAngles)))
            raise ValueError(f"material rest_angles is {shown(self.rest_angles)}, allowed: {allowed}")
        for name in (entry.name for entry in fields(self) if entry.name != "rest_angles"):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
                raise ValueError(f"material {name} is {value!r}, allowed: a finite number")
            if name in ("youngs_modulus", "density") and value <= 0:
                raise ValueError(f"material {name} is {value}, allowed: more than 0")
            if name == "poisson_ratio" and not 0 <= float(value) < 1:
                raise ValueError(f"material {name} is {value}, allowed: from 0 to below 1")
            if value < 0:
                raise ValueError(f"material {name} is {value}, allowed: 0 or more")
            object.__setattr__(self, name, float(value))


@dataclass(frozen=True)
class SkinnedGarment:
    """A garment as its garment nodes carry it, without the networks that correct them.

    garment: mesh the model was trained on. rest_normals: (n, 3), 1e-3 long at least, what skinning carries to the
    draped garment's normals; fitted to drapes they come out truer than the mesh's, for cloth does not deform as
    skinning's linear part says. node_rest: (m, 3); node_bone: (m,) index into `rig`. influence_nodes: (n, K) index;
    influence_weights: (n, K), rows sum to 1. engine_nodes, engine_weights: (n, k), the same with the few influences
    that engines take, learnt beside. detail: folds between garment nodes; None for none. fabric: what it was made of
    when it was put on, as `with_fabric` takes it; empty for what it was trained as. It decides the look, and no file
    holds it.
    """

    name: str
    rig: Rig
    garment: Garment = described("garment", Part(Garment))
    rest_normals: np.ndarray = described("garment.normals", Array("n 3", step=NORMAL_STEP))
    node_rest: np.ndarray = described("garment_nodes.rest", Array("m 3", np.float32))
    node_bone: np.ndarray = described("garment_nodes.bone", Array("m", below="b"))
    influence_nodes: np.ndarray = described("skinning.nodes", Array("n K", below="m"))
    influence_weights: np.ndarray = described("skinning.weights", Array("n K", step=WEIGHT_STEP, sums_to_one=True))
    engine_nodes: np.ndarray = described("engine_skinning.nodes", Array("n k", below="m"))
    engine_weights: np.ndarray = described(
        "engine_skinning.weights", Array("n k", step=ENGINE_WEIGHT_STEP, sums_to_one=True)
    )
    detail: Detail | None = described("detail", Part(Detail, optional=True), default=None, kw_only=True)
    fabric: str = field(default="", kw_only=True)


@dataclass(frozen=True)
class GarmentModel(SkinnedGarment):
    """A trained garment: all that is needed to put it on a body and to drape it.

    Attributes:
        name: the name of the garment.
        rig: the rig that it was trained on.
        garment: its mesh and its shape at rest.
        fabric: the fabric that it is made of, as `with_fabric` takes it. Empty: the fabric that it was trained as.
        hyper_modulator: arrays by name (see `physkin_core.model.hyper_modulator`). "fit" and "bend" tell the network
            how far the garment is made to measure, and how stiff its cloth is.
        pose_modulator, node_deformer: layers of these networks.
        sway: network that moves the garment nodes as the body moves. None: cloth does not swing.
        material: the cloth that it is made of.
        training: plain data on how it was trained: seed, bodies, steps. `bending_octaves` are the softest
            and the stiffest cloth that it has learnt, as exponents of two. The default (-2, 5) is a quarter to 32 times
            as stiff as `material`.
        scores: plain data on how well it drapes.
        as_trained: the model that `with_fabric` made this one from. None: it is as it was trained. Not stored in files.

    Raises:
        GarmentModelError: naming what does not fit together.

    Examples:
        >>> model = physkin.load_garment_model("tshirt")
        >>> model.name, len(model.node_rest), model.rig.joint_names[0]
        ('tshirt', 128, 'spine05_x')
    """

    pose_modulator: tuple[Layer, ...] = described("pose_modulator", Chain("p", "deformer_modulation"))
    node_deformer: tuple[Layer, ...] = described("node_deformer", Chain("12m", "12m"))
    hyper_modulator: Mapping[str, np.ndarray] = described("hyper_modulator", Named(hyper_modulator_shapes))
    sway: SwayNetwork | None = described("sway", Part(SwayNetwork, optional=True), default=None)
    material: Material = field(default_factory=Material)
    training: Mapping[str, Any] = field(default_factory=dict)
    scores: Mapping[str, Any] = field(default_factory=dict)
    as_trained: GarmentModel | None = field(default=None, kw_only=True, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.name, str) or not self.name.strip():
            raise GarmentModelError(f"a garment model needs a name, got {self.name!r}")
        for key in ("training", "scores"):
            if not isinstance(getattr(self, key), Mapping):
                raise GarmentModelError(f"{key} must be an object of names and values, got {getattr(self, key)!r}")
        sizes = {"b": self.rig.bone_count, "d": len(self.rig.dofs), "p": self.rig.pose_size}
        sizes["pose_modulation"] = modulation_size(self.pose_modulator)
        sizes["deformer_modulation"] = modulation_size(self.node_deformer)
        if self.sway is not None:
            joints = self.sway.joints.size
            sizes |= {"drive": drive_size(joints), "pose": pose_size(joints)}
        if self.detail is not None:
            last = self.node_deformer[-1][0].shape if self.node_deformer else ()  # whatever it is: checked below
            sizes["deformer_width"] = math.prod(last[1:])
            sizes["detail_nodes"] = math.prod(self.detail.offsets.shape[:1]) // 3
        check_arrays(self, sizes)
        _check_octaves(self.training.get("bending_octaves", BENDING_OCTAVES))
        if (width := len(self.hyper_modulator["fit"])) % HEADS:
            raise GarmentModelError(f"hyper_modulator token width {width} is not a multiple of its {HEADS} heads")
        if self.sway is not None and not self.sway.rates.min() > 0:
            raise GarmentModelError(f"sway.rates holds {self.sway.rates.min():g}, allowed: more than 0")
        length = np.linalg.norm(self.rest_normals, axis=1)
        if length.min() < SHORTEST_NORMAL:
            raise GarmentModelError(
                f"garment.normals of vertex {int(length.argmin())} is {length.min():.1e} long, "
                f"allowed: {SHORTEST_NORMAL:g} or more"
            )

    @property
    def bending_octaves(self) -> tuple[float, float]:
        """How much softer and stiffer than its material it has learnt to bend, as powers of two."""
        softest, stiffest = self.training.get("bending_octaves", BENDING_OCTAVES)
        return softest, stiffest

    def for_engines(self) -> GarmentModel:
        """The same model with 4 influences a vertex, as game engines take them."""
        return replace(self, influence_nodes=self.engine_nodes, influence_weights=self.engine_weights)

    def without_networks(self) -> SkinnedGarment:
        """The same garment without its networks, which binding folds into the bound garment."""
        return SkinnedGarment(**{entry.name: getattr(self, entry.name) for entry in fields(SkinnedGarment)})

    def arrays(self) -> dict[str, np.ndarray]:
        """Every array by its name in the garment model file."""
        return {name: array for name, array, _ in described_arrays(self)}


def _check_octaves(octaves: Any) -> None:
    try:
        softest, stiffest = (float(octave) for octave in octaves)
    except (TypeError, ValueError):
        softest = stiffest = math.nan
    if not -MOST_OCTAVES <= softest <= 0 <= stiffest <= MOST_OCTAVES:
        allowed = f"two numbers, from {-MOST_OCTAVES} to 0 and from 0 to {MOST_OCTAVES}"
        raise GarmentModelError(f"training.bending_octaves is {shown(octaves)}, allowed: {allowed}")

"""A trained garment: mesh, garment nodes, skinning weights, networks and the rig they were trained for.

Dimensions: `n` vertices, `f` faces, `m` garment nodes, `K` influences a vertex. Metres, root frame, canonical pose.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from numbers import Real

import numpy as np

from physkin_core.model.garment import Garment, vertex_normals
from physkin_core.model.hyper_modulator import token_features
from physkin_core.model.mlp import ACTIVATIONS, Layer, modulation_size
from physkin_core.model.sway_network import SwayNetwork, drive_size, pose_size
from physkin_core.rig.rig import Rig

__all__ = ["INDEX_ARRAYS", "GarmentModel", "GarmentModelError", "Material"]

INDEX_ARRAYS = ("garment.faces", "garment_nodes.bone", "skinning.nodes", "engine_skinning.nodes", "sway.joints")
"""The arrays of indices; all others hold floating point numbers."""
SHORTEST_NORMAL = 1e-3
"""Rest normals may have any length from here on."""


class GarmentModelError(ValueError):
    """A garment model is incomplete or inconsistent."""


@dataclass(frozen=True)
class Material:
    """What the garment was trained as. Defaults are the reference material of every quoted figure.

    youngs_modulus [N/m] and poisson_ratio of the StVK membrane, bending [J] of the dihedral energy, density [kg/m2],
    contact_offset [m], contact_stiffness [J/m4] (energy = stiffness * vertex area * depth^2).
    Raises ValueError naming a value that is not a finite number or has no physical meaning, and what is allowed.
    """

    youngs_modulus: float = 60.0
    poisson_ratio: float = 0.25
    bending: float = 2.5e-5
    density: float = 0.2
    contact_offset: float = 0.003
    contact_stiffness: float = 4.0e6

    def __post_init__(self) -> None:
        for name in (entry.name for entry in fields(self)):
            value = getattr(self, name)
            if isinstance(value, bool) or not isinstance(value, Real) or not math.isfinite(value):
                raise ValueError(f"material {name} is {value!r}, allowed: a finite number")
            if name in ("youngs_modulus", "density") and value <= 0:
                raise ValueError(f"material {name} is {value}, allowed: more than 0")
            if name == "poisson_ratio" and not 0 <= value < 1:
                raise ValueError(f"material {name} is {value}, allowed: from 0 to below 1")
            if value < 0:
                raise ValueError(f"material {name} is {value}, allowed: 0 or more")
            object.__setattr__(self, name, float(value))


@dataclass(frozen=True)
class GarmentModel:
    """Everything a run needs. Raises GarmentModelError naming what does not fit.

    garment: mesh the model was trained on. node_rest: (m, 3); node_bone: (m,) int32, index into `rig`.
    influence_nodes: (n, K) int32; influence_weights: (n, K) float32, rows sum to 1. Other integer types are converted.
    engine_nodes, engine_weights: (n, k), the same with the few influences that engines take, learnt beside; or None.
    rest_normals: (n, 3), 1e-3 long at least, what skinning carries to the draped garment's normals. Default those
    of the mesh; fitted to drapes they come out truer, for cloth does not deform as skinning's linear part says.
    hyper_modulator: arrays by name (see `physkin_core.model.hyper_modulator`), "fit" and "bend" among them only
    where made to measure and other bending stiffness were learnt. pose_modulator, node_deformer: layers.
    sway: network that moves the garment nodes of a body that moves; None where a pendulum does.
    training, scores: plain data on how it was trained (seed, bodies, steps) and how it measured up.
    """

    name: str
    rig: Rig
    garment: Garment
    node_rest: np.ndarray
    node_bone: np.ndarray
    influence_nodes: np.ndarray
    influence_weights: np.ndarray
    hyper_modulator: Mapping[str, np.ndarray]
    pose_modulator: tuple[Layer, ...]
    node_deformer: tuple[Layer, ...]
    activation: str = "silu"
    engine_nodes: np.ndarray | None = None
    engine_weights: np.ndarray | None = None
    rest_normals: np.ndarray | None = None
    sway: SwayNetwork | None = None
    material: Material = field(default_factory=Material)
    training: Mapping = field(default_factory=dict)
    scores: Mapping = field(default_factory=dict)

    def __post_init__(self) -> None:
        m, n = _rows(self.node_rest), len(self.garment.vertices)
        if not isinstance(self.name, str) or not self.name.strip():
            raise GarmentModelError(f"a garment model needs a name, got {self.name!r}")
        for key in ("training", "scores"):
            if not isinstance(getattr(self, key), Mapping):
                raise GarmentModelError(f"{key} must be an object of names and values, got {getattr(self, key)!r}")
        if self.activation not in ACTIVATIONS:
            raise GarmentModelError(f"unknown activation {self.activation!r}; known: {', '.join(ACTIVATIONS)}")
        _expect("garment_nodes.rest", self.node_rest, (m, 3))
        _expect("garment_nodes.bone", self.node_bone, (m,))
        if self.rest_normals is None:
            normals = vertex_normals(self.garment.vertices, self.garment.faces)
            object.__setattr__(self, "rest_normals", normals.astype(np.float32))
        _expect("garment.normals", self.rest_normals, (n, 3))
        object.__setattr__(self, "node_bone", _indices("garment_nodes.bone", self.node_bone, self.rig.bone_count))
        nodes = _influences("skinning", self.influence_nodes, self.influence_weights, vertices=n, node_count=m)
        object.__setattr__(self, "influence_nodes", nodes)
        if (self.engine_nodes is None) != (self.engine_weights is None):
            raise GarmentModelError("engine_skinning needs both nodes and weights")
        if self.engine_nodes is not None:
            nodes = _influences("engine_skinning", self.engine_nodes, self.engine_weights, vertices=n, node_count=m)
            object.__setattr__(self, "engine_nodes", nodes)
        _expect_chain("pose_modulator", self.pose_modulator, self.rig.pose_size, (modulation_size(self.node_deformer),))
        _expect_chain("node_deformer", self.node_deformer, 12 * m, (9 * m, 12 * m))
        _expect_hyper_modulator(self.hyper_modulator, modulation_size(self.pose_modulator))
        if self.sway is not None:
            if len(self.node_deformer[-1][1]) != 12 * m:
                raise GarmentModelError("a sway network needs a node deformer of 12 numbers a garment node")
            _expect_sway_network(self.sway, 12 * m, modulation_size(self.pose_modulator))
            joints = _indices("sway.joints", self.sway.joints, len(self.rig.dofs))
            object.__setattr__(self, "sway", replace(self.sway, joints=joints))
        for name, array in self.arrays().items():
            if name in INDEX_ARRAYS:
                continue
            if array.dtype.kind != "f":
                raise GarmentModelError(f"{name} is of type {array.dtype}, expected floating point numbers")
            if not np.isfinite(array).all():
                raise GarmentModelError(f"{name} holds a value that is not finite")
        length = np.linalg.norm(self.rest_normals, axis=1)
        if length.min() < SHORTEST_NORMAL:
            raise GarmentModelError(
                f"garment.normals of vertex {int(length.argmin())} is {length.min():.1e} long, "
                f"allowed: {SHORTEST_NORMAL:g} or more"
            )

    @property
    def made_to_measure(self) -> bool:
        """Whether the networks have learnt rest shapes graded to the body (`fit` above 0), too."""
        return "fit" in self.hyper_modulator

    @property
    def learnt_bending(self) -> bool:
        """Whether the networks have learnt cloth that bends otherwise, too (see `physkin_core.model.fabric`)."""
        return "bend" in self.hyper_modulator

    @property
    def accelerated(self) -> bool:
        """Whether the networks have learnt effective gravity of any size, as accelerated roots feel it."""
        return bool((self.training.get("poses") or {}).get("accelerated"))

    def for_engines(self) -> GarmentModel:
        """The same model skinned by the few influences that engines take. Raises GarmentModelError when it has not
        learnt them."""
        if self.engine_nodes is None:
            raise GarmentModelError(f"garment model {self.name!r} has not learnt skinning weights for engines")
        return replace(self, influence_nodes=self.engine_nodes, influence_weights=self.engine_weights)

    def checked_fit(self, fit: float | None) -> float:
        """The fit as a number; None is 1 where this model has learnt made to measure, else 0.

        Raises ValueError when it is not 0 to 1, or above 0 and this model has not learnt it.
        """
        if fit is None:
            return float(self.made_to_measure)
        if isinstance(fit, bool) or not isinstance(fit, Real) or not 0 <= fit <= 1:
            raise ValueError(f"fit must be 0 (the template) to 1 (made to measure), got {fit!r}")
        if fit > 0 and not self.made_to_measure:
            raise ValueError(
                f"garment model {self.name!r} has not learnt to be made to measure: fit is {fit:g}, allowed is 0; "
                'train it with optimisation.fit = "both"'
            )
        return float(fit)

    def arrays(self) -> dict[str, np.ndarray]:
        """Every array by its name in the garment model file."""
        named = {
            "garment.vertices": self.garment.vertices,
            "garment.faces": self.garment.faces,
            "garment.normals": self.rest_normals,
            "garment_nodes.rest": self.node_rest,
            "garment_nodes.bone": self.node_bone,
            "skinning.nodes": self.influence_nodes,
            "skinning.weights": self.influence_weights,
        }
        if self.engine_nodes is not None:
            named |= {"engine_skinning.nodes": self.engine_nodes, "engine_skinning.weights": self.engine_weights}
        for network, layers in (("pose_modulator", self.pose_modulator), ("node_deformer", self.node_deformer)):
            for index, (weight, bias) in enumerate(layers):
                named[f"{network}.{index}.weight"], named[f"{network}.{index}.bias"] = weight, bias
        if self.sway is not None:
            named |= {f"sway.{name}": array for name, array in self.sway.arrays().items()}
        return named | {f"hyper_modulator.{name}": array for name, array in self.hyper_modulator.items()}


def _expect(name: str, array: np.ndarray, shape: tuple[int, ...]) -> None:
    if array.shape != shape or 0 in shape:
        raise GarmentModelError(f"{name} has shape {array.shape}, expected {shape}, none of them empty")


def _rows(array: np.ndarray) -> int:
    return array.shape[0] if array.ndim else 0


def _indices(name: str, indices: np.ndarray, count: int) -> np.ndarray:
    """The indices as int32, once they are known to be whole numbers from 0 to count - 1."""
    if indices.dtype.kind not in "iu":
        raise GarmentModelError(f"{name} is of type {indices.dtype}, expected an integer index")
    if indices.min() < 0 or indices.max() >= count:
        raise GarmentModelError(f"{name} holds index {indices.min()}..{indices.max()}, allowed 0..{count - 1}")
    return indices.astype(np.int32, copy=False)


def _influences(name: str, nodes: np.ndarray, weights: np.ndarray, *, vertices: int, node_count: int) -> np.ndarray:
    """The influences' garment nodes as int32, once they and their skinning weights are known to be right."""
    count = nodes.shape[1] if nodes.ndim == 2 else 0
    _expect(f"{name}.nodes", nodes, (vertices, count))
    _expect(f"{name}.weights", weights, (vertices, count))
    if weights.min() < 0 or np.abs(weights.sum(axis=1) - 1).max() > 1e-3:
        raise GarmentModelError("skinning weights must be non-negative and sum to 1 at every vertex")
    return _indices(f"{name}.nodes", nodes, node_count)


def _expect_chain(name: str, layers: tuple[Layer, ...], inputs: int, outputs: tuple[int, ...]) -> None:
    if not layers:
        raise GarmentModelError(f"{name} has no layers")
    for index, (weight, bias) in enumerate(layers):
        _expect(f"{name}.{index}.weight", weight, (bias.size, inputs))
        _expect(f"{name}.{index}.bias", bias, (bias.size,))
        inputs = bias.size
    if inputs not in outputs:
        raise GarmentModelError(f"{name} gives {inputs} numbers, expected {' or '.join(map(str, outputs))}")


def _expect_hyper_modulator(network: Mapping[str, np.ndarray], outputs: int) -> None:
    try:
        width, hidden = _rows(network["embed.weight"]), _rows(network["feed_forward.0.weight"])
        shapes = {
            "embed": (width, token_features()),
            "attention.input": (3 * width, width),
            "attention.output": (width, width),
            "feed_forward.0": (hidden, width),
            "feed_forward.1": (width, hidden),
            "pool": (1, width),
            "output": (outputs, width),
        }
        shapes |= dict.fromkeys(("norm_1", "norm_2"), (width,))
        block = 0
        while f"residual.{block}.norm.weight" in network:
            inner = _rows(network[f"residual.{block}.0.weight"])
            shapes |= {f"residual.{block}.0": (inner, width), f"residual.{block}.1": (width, inner)}
            shapes[f"residual.{block}.norm"] = (width,)
            block += 1
        for name, shape in shapes.items():
            _expect(f"hyper_modulator.{name}.weight", network[f"{name}.weight"], shape)
            _expect(f"hyper_modulator.{name}.bias", network[f"{name}.bias"], shape[:1])
    except KeyError as error:
        raise GarmentModelError(f"hyper_modulator lacks {error}") from None
    if width % 4:
        raise GarmentModelError(f"hyper_modulator token width {width} is not a multiple of its 4 heads")
    for name in {"fit", "bend"} & network.keys():
        _expect(f"hyper_modulator.{name}", network[name], (width,))
    known = {f"{name}.{part}" for name in shapes for part in ("weight", "bias")} | {"fit", "bend"}
    if unknown := sorted(set(network) - known):
        raise GarmentModelError(f"hyper_modulator has unknown arrays: {', '.join(unknown)}")


def _expect_sway_network(network: SwayNetwork, outputs: int, modulation: int) -> None:
    arrays = network.arrays()
    joints, states, code = (_rows(arrays[name]) for name in ("joints", "rates", "code.directions"))
    hidden, read, last = (_rows(arrays[f"{name}.bias"]) for name in ("first", "read", "last"))
    shapes = {
        "first": (hidden, drive_size(joints)),
        "drive": (2 * states, hidden),
        "gate": (states, hidden),
        "read": (read, 2 * states + pose_size(joints) + drive_size(joints)),
        "last": (last, read),
        "out": (outputs, last),
    }
    wanted = {f"{name}.weight": shape for name, shape in shapes.items()}
    wanted |= {f"{name}.bias": shape[:1] for name, shape in shapes.items()}
    wanted |= {"joints": (joints,), "rates": (states,), "turns": (states,), "code.mean": (modulation,)}
    wanted |= {"first.code": (hidden, code), "read.code": (read, code), "code.directions": (code, modulation)}
    for name, shape in wanted.items():
        _expect(f"sway.{name}", arrays[name], shape)
    if not network.rates.min() > 0:
        raise GarmentModelError(f"sway.rates holds {network.rates.min():g}, allowed: more than 0")

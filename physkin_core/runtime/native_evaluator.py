"""The per-frame path in C++: joint positions to garment vertices and normals, on one core, without allocating.

Dimensions as in `bound_garment`: `d` degrees of freedom, `m` garment nodes, `n` garment vertices.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np

from physkin_core.runtime.bound_garment import BoundGarment

try:
    import physkin_core._native as _native
except ImportError as error:
    raise ImportError(
        f"physkin_core in {Path(__file__).parents[1]} has no native module built for this Python ({error}). In a "
        "source folder, install with `pip install -e .`, or start Python elsewhere to use the installed package."
    ) from error

__all__ = ["PRECISIONS", "NativeEvaluator", "NativeEvaluatorBatch", "Precision", "supported_instruction_sets"]

Precision = Literal["fp32", "bf16", "int8"]
PRECISIONS: tuple[Precision, ...] = ("fp32", "bf16", "int8")
"""Precisions of network weights."""


def supported_instruction_sets() -> list[str]:
    """Instruction sets this CPU can run, narrowest first.

    "baseline", "v3" (AVX2 and FMA), "v4" (AVX-512), "v4_vnni" (AVX-512 and its VNNI).
    """
    return _native.supported_instruction_sets()


class NativeEvaluator:
    """Evaluates one bound garment frame by frame. Not for use by two threads at once.

    bound: its arrays are copied and packed; later changes to them have no effect.
    instruction_set: one of `supported_instruction_sets()`. By default the environment variable PHYSKIN_NATIVE_ISA
        decides, and without it the widest supported set.
    precision: of the network weights, one of `PRECISIONS`: "fp32"; "bf16", widened in registers; "int8", with
        activations rounded to 16 bits and the layers that read bone transforms and the pose vector in bf16. By default
        the environment variable PHYSKIN_NATIVE_PRECISION decides, and without it "int8", which no quality figure tells
        from "fp32" for models rounded to it (docs/notebook/benchmark.md).
    normals: "skinned", rest normals carried along, or "faces", those of the posed mesh's faces around each vertex,
        weighted by area: slower, and right where the cloth ripples.

    Building one takes milliseconds, without the interpreter's lock: other threads go on. Network weights must not be
    changed meanwhile.

    Raises ValueError if an array of `bound` has another dtype, shape or layout than its class states, an
    index is out of range, a value is not finite, the instruction set is unknown or not supported by this CPU, the
    precision or `normals` are unknown, or normals are those of faces and the garment has none.
    """

    def __init__(
        self,
        bound: BoundGarment,
        *,
        instruction_set: str | None = None,
        precision: Precision | None = None,
        normals: Literal["skinned", "faces"] = "skinned",
    ) -> None:
        self._evaluator = _native.Evaluator(bound, instruction_set, precision, normals)

    @property
    def instruction_set(self) -> str:
        """Name of the instruction set in use."""
        return self._evaluator.instruction_set

    @property
    def precision(self) -> str:
        """Precision of the network weights."""
        return self._evaluator.precision

    @property
    def skinning_terms(self) -> int:
        """Garment nodes blended, summed over blocks of 16 vertices: each costs 12 multiply-adds a vertex."""
        return self._evaluator.skinning_terms

    def evaluate(self, joint_positions: np.ndarray, gravity: np.ndarray, out: np.ndarray) -> None:
        """Computes one frame into `out`.

        joint_positions: (d,) [rad], float32 or float64.
        gravity: (3,) unit direction of gravity in the root frame, float32 or float64; or with the moment behind it,
            (5,) or (14,), as of `physkin_core.sway.moment`.
        out: writable float32, (n, 6) for x, y, z [m] and unit normals in the root frame, or (n, 3) for positions
            alone. Rows must be contiguous but may be any distance apart, so that `out` can be a view of a larger
            buffer, such as the data of a point cloud message.

        Raises TypeError if an array has another dtype or `out` is read-only; ValueError if a shape is wrong, an input
        is not finite, or the networks' output is not (`out` is then unchanged).
        """
        try:
            self._evaluator.evaluate(joint_positions, gravity, out)
        except TypeError:
            raise TypeError(_explain(joint_positions=joint_positions, gravity=gravity, out=out)) from None

    def bind_step(self, joint_positions: np.ndarray, gravity: np.ndarray, out: np.ndarray) -> _native.Step:
        """A frame bound to its arrays: they are checked once, and then `step()` reads and writes them where they lie.

        joint_positions: (d,) [rad] and gravity: (3,), (5,) or (14,), C-contiguous float32, to be changed in place
        between frames. out: as in `evaluate`. Returns an object whose method `step()`, of no arguments, converts and
        allocates nothing; it keeps the arrays and this evaluator alive. Its methods `pose`, `run_networks`,
        `compose_nodes`, `skin` and `compute_normals` repeat single stages of the last frame, without sway, twist and
        pace, for timing.

        Raises TypeError or ValueError as `evaluate` does; `step()` raises ValueError if an input or the networks'
        output is not finite (`out` is then unchanged).
        """
        try:
            return _native.Step(self._evaluator, joint_positions, gravity, out)
        except TypeError:
            raise TypeError(_explain(joint_positions=joint_positions, gravity=gravity, out=out)) from None

    def skin(self, node_transforms: np.ndarray, out: np.ndarray) -> None:
        """Skinning alone, from given node transforms, (m, 3, 4) float32, C-contiguous.

        out and errors as in `evaluate`.
        """
        try:
            self._evaluator.skin(node_transforms, out)
        except TypeError:
            raise TypeError(_explain(node_transforms=node_transforms, out=out)) from None

    def node_transforms(self) -> np.ndarray:
        """Garment node transforms of the last frame, (m, 3, 4) [linear | translation in m], root frame, float32.

        Zeros before the first frame.
        """
        return self._evaluator.node_transforms.copy()

    def corrections(self) -> np.ndarray:
        """What the node deformer gave last, (m, 9) or (m, 12) float32; zeros before the first frame."""
        return self._evaluator.corrections.copy()


class NativeEvaluatorBatch:
    """One garment on several bodies, their frames computed together. Not for use by two threads at once.

    Network weights are kept once, and read from memory once for up to four bodies. Every body's frame is, bit for bit,
    that of a `NativeEvaluator` of its bound garment.

    bounds: `B` of them, from `bind_garment(..., fold=False)` of one garment model.
    instruction_set, precision, normals: as in `NativeEvaluator`.
    Raises ValueError as `NativeEvaluator` does, and where the bound garments do not share their networks.
    """

    def __init__(
        self,
        bounds: Sequence[BoundGarment],
        *,
        instruction_set: str | None = None,
        precision: Precision | None = None,
        normals: Literal["skinned", "faces"] = "skinned",
    ) -> None:
        self._batch = _native.Batch(list(bounds), instruction_set, precision, normals)

    @property
    def instruction_set(self) -> str:
        """Name of the instruction set in use."""
        return self._batch.instruction_set

    @property
    def precision(self) -> str:
        """Precision of the network weights."""
        return self._batch.precision

    def bind(self, joint_positions: np.ndarray, gravity: np.ndarray, out: np.ndarray) -> None:
        """Sets the arrays that `step` reads and writes where they lie, until others are bound; they are kept alive.

        joint_positions: (B, d) [rad] and gravity: (B, 3) unit, root frame, C-contiguous float32.
        out: (B, n, 6) or (B, n, 3) writable float32; rows contiguous, any distance apart, as in `NativeEvaluator`.
        Raises TypeError for another dtype or a read-only `out`, ValueError for a wrong shape or overlapping rows.
        """
        try:
            self._batch.bind(joint_positions, gravity, out)
        except TypeError:
            raise TypeError(_explain(joint_positions=joint_positions, gravity=gravity, out=out)) from None

    def step(self) -> None:
        """Computes a frame of every body. Converts and allocates nothing.

        Raises ValueError, naming the body and the value, if an input or what the networks make of it is not finite, or
        no arrays are bound; nothing is written then.
        """
        self._batch.step()

    def evaluate(self, joint_positions: np.ndarray, gravity: np.ndarray, out: np.ndarray) -> None:
        """`bind`, then `step`."""
        self.bind(joint_positions, gravity, out)
        self.step()


def _explain(**arrays: object) -> str:
    """What the binding rejected, in place of its list of C++ signatures."""
    got = []
    for name, value in arrays.items():
        if isinstance(value, np.ndarray):
            access = "" if value.flags.writeable else "read-only "
            got.append(f"{name} {access}{value.dtype} of shape {value.shape}")
        else:
            got.append(f"{name} {type(value).__name__}")
    return f"arrays must be NumPy float32 (inputs also float64) and out writable and 2-D; got {', '.join(got)}"

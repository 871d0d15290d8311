"""Frames in C++: joint positions to garment vertices and normals, on one core, without allocating.

Dimensions as in `bound_garment`: `d` degrees of freedom, `m` garment nodes, `n` garment vertices; `g` garments.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Literal

import numpy as np

from physkin_core.model.skinning import SkinningData
from physkin_core.native_module import as_float32, native
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.frame_input import FrameInput

__all__ = [
    "NO_DETAIL",
    "PRECISIONS",
    "Evaluator",
    "Precision",
    "Skinner",
    "drape_poses",
    "supported_instruction_sets",
]

Precision = Literal["fp32", "bf16", "int8"]
PRECISIONS: tuple[Precision, ...] = ("fp32", "bf16", "int8")
"""Precisions of network weights."""

NO_DETAIL = np.empty((0, 3), dtype=np.float32)
"""Offsets of detail nodes of garments without any."""


def supported_instruction_sets() -> list[str]:
    """Instruction sets this CPU can run, narrowest first.

    "baseline", "v3" (AVX2 and FMA), "v3_vnni" (also AVX-VNNI), "v4" (AVX-512), "v4_vnni" (AVX-512 and its VNNI); on
    ARM "baseline" (NEON), "dotprod", "i8mm".
    """
    return native.supported_instruction_sets()


class Evaluator:
    """Evaluates one bound garment, or several worn over each other on one body. Not for use by two threads at once.

    bounds: the garments, innermost first; their arrays are copied and packed, later changes to them have no effect.
    orders: what keeps two of them in order, `LayerOrder`s of `physkin_core.outfit.layer_order`.
    instruction_set: one of `supported_instruction_sets()`. By default the environment variable PHYSKIN_NATIVE_ISA
        decides, and without it the widest supported set.
    precision: of the network weights, one of `PRECISIONS`: "fp32"; "bf16", widened in registers; "int8", with
        activations rounded to 16 bits and the layers that read bone transforms and the pose vector in bf16. By default
        the environment variable PHYSKIN_NATIVE_PRECISION decides, and without it "int8", which no quality figure tells
        from "fp32" for models rounded to it (docs/notebook/benchmark.md).

    Normals are those of the posed mesh's faces around each vertex, weighted by area; where there are no faces, rest
    normals are carried along.

    Building one takes milliseconds, without the interpreter's lock: other threads go on. Network weights must not be
    changed meanwhile.

    Raises ValueError if an array of a bound garment has another dtype, shape or layout than its class states, an index
    is out of range, a value is not finite, garments are of several rigs or bodies, the instruction set is unknown or
    not supported by this CPU, or the precision is unknown.
    """

    def __init__(
        self,
        bounds: Sequence[BoundGarment],
        orders: Sequence[object] = (),
        *,
        instruction_set: str | None = None,
        precision: Precision | None = None,
    ) -> None:
        self._evaluator = native.Evaluator(list(bounds), list(orders), instruction_set, precision)

    @property
    def instruction_set(self) -> str:
        """Name of the instruction set in use."""
        return self._evaluator.instruction_set

    @property
    def precision(self) -> Precision:
        """Precision of the network weights."""
        return self._evaluator.precision

    def bind_frame(self, joint_positions: np.ndarray, inputs: np.ndarray, outs: Sequence[np.ndarray]) -> native.Step:
        """A frame bound to its arrays: they are checked once, and then `step()` reads and writes them where they lie.

        joint_positions: (d,) [rad]; inputs: (g, 13) as of `FrameInput.rows`; C-contiguous float32, to be changed in
        place between frames. outs: one a garment, writable float32, all (n, 6) for x, y, z [m] and unit normals in the
        root frame, or all (n, 3) for positions alone. Rows must be contiguous but may be any distance apart, so that
        they can be views of a larger buffer, such as the data of a point cloud message.

        Returns an object whose method `step()`, of no arguments, converts and allocates nothing; it keeps the arrays
        and this evaluator alive. Its methods `pose`, `run_networks`, `compose_nodes`, `skin`, `keep` (the order of
        layers) and `compute_normals` repeat single stages of the last frame, for timing.

        Raises TypeError if an array has another dtype or one of `outs` is read-only; ValueError if a shape is wrong;
        `step()` raises ValueError if an input or the networks' output is not finite (`outs` are then unchanged).
        """
        try:
            return native.Step(self._evaluator, joint_positions, inputs, list(outs))
        except TypeError:
            raise TypeError(_explain(joint_positions=joint_positions, inputs=inputs, out=outs[0])) from None

    def frames(
        self, frame_input: FrameInput, rest: np.ndarray, joint_indices: dict[str, int] | None = None
    ) -> native.Frames:
        """Frames in one call each, of anything that `Outfit.drape` takes.

        frame_input: of as many garments; frames go on in it. rest: (d,) [rad] of joints that are left out where
        positions are given by name; joint_indices: of the names, or none: positions are then given by order alone.

        Returns an object with one method, `drape`, of the arguments joint_positions, look_at_unusual, gravity,
        effective_gravity, time, root and outs. It returns the list of clouds, which are new if outs is None. All but
        look_at_unusual is as for `Outfit.drape`. That is a function which is asked about joint positions that are no
        array (d,) of float32 or float64 and no dictionary of known joints, and about those far from 0, which may be
        degrees or not finite. It returns such an array, or raises.
        """
        return native.Frames(self._evaluator, frame_input.native, as_float32(rest), joint_indices or {})

    def evaluate(self, joint_positions: np.ndarray, inputs: np.ndarray, outs: Sequence[np.ndarray]) -> None:
        """Computes one frame: `bind_frame`, then its `step`."""
        self.bind_frame(joint_positions, inputs, outs).step()

    def forget(self) -> None:
        """The next frame goes on from none: layers look for each other anew."""
        self._evaluator.forget()

    def node_transforms(self, garment: int = 0) -> np.ndarray:
        """Garment node transforms of the last frame, (m, 3, 4) [linear | translation in m], root frame, float32; before
        layers are put in order. Zeros before the first frame."""
        return self._evaluator.node_transforms(garment).copy()

    def corrections(self, garment: int = 0) -> np.ndarray:
        """What the networks gave last, (m, 12) float32; zeros before the first frame."""
        return self._evaluator.corrections(garment).copy()

    def detail_offsets(self, garment: int = 0) -> np.ndarray:
        """Offsets of detail nodes of the last frame, (D, 3) float32 [m] that are added to the garment at rest before it
        is skinned; before layers are put in order. Zeros before the first frame; (0, 3) of a garment without detail."""
        return self._evaluator.detail_offsets(garment).copy()

    def clearance(self, garment: int = 0) -> np.ndarray:
        """How far samples of the cloth, and vertices between them, are from the skin in the last frame (s + t,) [m],
        float32; 1 where none is near. Empty where nothing is kept out of it."""
        out = np.empty(self._evaluator.clearances(garment), dtype=np.float32)
        self._evaluator.measure_clearance(garment, out)
        return out

    def stage_bytes(self, garment: int = 0) -> dict[str, int]:
        """Bytes that the last frame of a garment touched, or that a first one will: by stages "posing", "networks",
        "composition" (garment nodes, pace, contact), "skinning" and "normals".

        All that stages keep in memory, and the rows they write, (n, 6). An array counts once, in the first stage that
        needs it. What the frame had no need of does not count: the sway network of cloth that did not sway, other
        fabrics, what contact looks at only where cloth is in the skin. Layers in order touch more.
        """
        return self._evaluator.stage_bytes(garment)


def drape_poses(
    bound: BoundGarment, poses: Iterable[tuple[np.ndarray, np.ndarray]], *, precision: Precision | None = None
) -> list[np.ndarray]:
    """One garment by itself in poses (joint positions (d,) [rad], direction of gravity (3,)), each for itself: of each
    (n, 6) float32 vertices and normals. Raises as `Evaluator` does."""
    frames = Evaluator([bound], precision=precision).frames(FrameInput(1), bound.dof_rest)
    return [frames.drape(positions, as_float32, gravity, None, None, None, None)[0] for positions, gravity in poses]


class Skinner:
    """Skins one garment from garment nodes that somebody else computed, without having its networks. Not for use by two
    threads at once.

    Gives the vertices of the `Evaluator` that computed them, bit for bit.

    Raises ValueError when a shape or dtype is another than of `SkinningData`, an index out of range or a value not
    finite.
    """

    def __init__(self, data: SkinningData) -> None:
        self.vertex_count, self.node_count = len(data.vertices), len(data.node_rest)
        self._skinner = native.Skinner(data)

    def skin(self, node_transforms: np.ndarray, out: np.ndarray, detail_offsets: np.ndarray = NO_DETAIL) -> None:
        """Write x, y, z [m] and unit normals into `out`, (n, 6) or (n, 3) float32 as for `Evaluator.bind_frame`, from
        node_transforms (m, 3, 4) and, of a garment with detail, detail_offsets (D, 3) [m], float32 and C-contiguous.

        Raises TypeError or ValueError as `Evaluator.bind_frame` does, and for what is not finite.
        """
        try:
            self._skinner.skin(node_transforms, out, detail_offsets)
        except TypeError:
            got = _explain(node_transforms=node_transforms, detail_offsets=detail_offsets, out=out)
            raise TypeError(got) from None


def _explain(**arrays: object) -> str:
    """What the binding rejected, in place of its list of C++ signatures."""
    got = []
    for name, value in arrays.items():
        if isinstance(value, np.ndarray):
            access = "" if value.flags.writeable else "read-only "
            got.append(f"{name} {access}{value.dtype} of shape {value.shape}")
        else:
            got.append(f"{name} {type(value).__name__}")
    return f"arrays must be NumPy float32, C-contiguous, and out writable and 2-D; got {', '.join(got)}"

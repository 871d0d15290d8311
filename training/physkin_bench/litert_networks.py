"""The two per-frame networks as a LiteRT model, written by the schema that ai-edge-litert brings, and how to run it.

Dimensions: `p` pose vector, `u` bones that garment nodes follow, `m` garment nodes, `D` detail nodes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from physkin_core.model.mlp import Layer
from physkin_core.rig.rig import forward_kinematics, pose_vector
from physkin_core.runtime.bound_garment import BoundGarment
from physkin_core.runtime.evaluator import Evaluator

__all__ = ["NetworkCase", "litert_networks", "network_case", "weight_count"]

VERSION = 3
KINDS = {"mul": ("MUL", "Mul"), "add": ("ADD", "Add"), "sigmoid": ("LOGISTIC", "")}
"""Operation -> operator code and options of the schema."""


@dataclass(frozen=True)
class NetworkCase:
    """A bound garment's networks and what they are given. pose: (1, p) and bones: (1, 12 u) float32 inputs. expected:
    (1, 12 m + 3 D) float32, corrections and then offsets of detail nodes."""

    bound: BoundGarment
    pose: np.ndarray
    bones: np.ndarray
    expected: np.ndarray


def network_case(bound: BoundGarment, pose: np.ndarray, inputs: np.ndarray) -> NetworkCase:
    """At a pose (d,) float32 [rad], inputs (1, 13) as of `FrameInput.rows`, before cloth is kept out of the skin."""
    evaluator = Evaluator([bound.without_contact], precision="fp32")
    evaluator.evaluate(pose, inputs, [np.empty((len(bound.vertices), 3), dtype=np.float32)])
    q, heads = pose.astype(np.float64), bound.bone_heads.astype(np.float64)
    bones = forward_kinematics(bound.bone_parents, heads, bound.dof_bone, bound.dof_axis, q - bound.dof_rest)
    read = pose_vector(q, bound.dof_lower.astype(np.float64), bound.dof_upper.astype(np.float64), inputs[0, :3])
    return NetworkCase(
        bound,
        pose=read[None].astype(np.float32),
        bones=bones[bound.deformer_bones].reshape(1, -1).astype(np.float32),
        expected=np.concatenate([evaluator.corrections().ravel(), evaluator.detail_offsets().ravel()])[None],
    )


def weight_count(bound: BoundGarment) -> int:
    """Network weights, biases not counted: the multiply-adds of a frame."""
    layers = (*bound.pose_layers, *bound.deformer_layers, *bound.detail_layers)
    return sum(weight.size for weight, _ in layers) + bound.detail_offsets.size


def litert_networks(case: NetworkCase, *, int8: bool):
    """A call that runs them on one thread, and what gives its result. int8: network weights in 8 bits."""
    from ai_edge_litert.interpreter import Interpreter

    interpreter = Interpreter(model_content=_model(case, int8=int8), num_threads=1)
    interpreter.allocate_tensors()
    for detail in interpreter.get_input_details():
        interpreter.set_tensor(detail["index"], getattr(case, detail["name"]))
    outputs = [detail["index"] for detail in interpreter.get_output_details()]
    return interpreter.invoke, lambda: np.concatenate([interpreter.get_tensor(k) for k in outputs], axis=1)


def _model(case: NetworkCase, *, int8: bool) -> bytes:
    """The flatbuffer. The pose modulator's output layer is cut in two for each hidden layer of the node deformer, 1 +
    scale and shift, so that no engine has to add the one or to cut the vector."""
    import flatbuffers
    from ai_edge_litert import schema_py_generated as schema

    writer, bound = _Writer(schema, int8), case.bound

    def activate(x: int) -> int:
        return writer.add("mul", x, writer.add("sigmoid", x))

    x, y = writer.graph.inputs = [writer.tensor(getattr(case, name).shape, name=name) for name in ("pose", "bones")]
    *hidden, (weight, bias) = bound.pose_layers
    for layer in hidden:
        x = writer.dense(x, layer)
        x = activate(x) if len(layer[1]) else x
    start = 0
    for layer in bound.deformer_layers[:-1]:
        scale, shift = (slice(at, at + len(layer[1])) for at in (start, start + len(layer[1])))
        y = writer.add("mul", writer.dense(y, layer), writer.dense(x, (weight[scale], bias[scale] + np.float32(1))))
        y = activate(writer.add("add", y, writer.dense(x, (weight[shift], bias[shift]))))
        start = shift.stop
    writer.graph.outputs = [writer.dense(y, bound.deformer_layers[-1])]
    for layer in bound.detail_layers:
        last = bound.detail_offsets, np.zeros(len(bound.detail_offsets), dtype=np.float32)
        writer.graph.outputs += [writer.dense(activate(writer.dense(y, layer)), last)]
    builder = flatbuffers.Builder()
    builder.Finish(writer.model.Pack(builder), file_identifier=b"TFL3")
    return bytes(builder.Output())


class _Writer:
    """Appends tensors, constants and operators; each is known by the index of its output tensor."""

    def __init__(self, schema, int8: bool) -> None:
        self.schema, self.int8 = schema, int8
        self.model, self.graph = schema.ModelT(), schema.SubGraphT()
        self.model.version, self.model.subgraphs, self.model.operatorCodes = VERSION, [self.graph], []
        self.model.buffers = [schema.BufferT()]  # the first one is empty by convention
        self.graph.tensors, self.graph.operators = [], []

    def dense(self, x: int, layer: Layer) -> int:
        weight, bias = layer
        scale = None
        if self.int8:  # a scale an output; LiteRT rounds activations to 8 bits as it runs
            scale = (np.maximum(np.abs(weight).max(axis=1), 1e-30) / 127).astype(np.float32)
            weight = np.round(weight / scale[:, None]).astype(np.int8)
        inputs = [x, self._constant(weight, scale), self._constant(bias) if len(bias) else -1]
        return self._operator("FULLY_CONNECTED", "FullyConnected", inputs, len(weight))

    def add(self, kind: str, *inputs: int) -> int:
        return self._operator(*KINDS[kind], list(inputs), self.graph.tensors[inputs[0]].shape[1])

    def tensor(self, shape: tuple[int, ...], buffer: int = 0, name: str = "") -> int:
        tensor = self.schema.TensorT()
        tensor.shape, tensor.buffer = np.array(shape, dtype=np.int32), buffer
        tensor.name = name or f"tensor_{len(self.graph.tensors)}"
        self.graph.tensors.append(tensor)
        return len(self.graph.tensors) - 1

    def _constant(self, array: np.ndarray, scale: np.ndarray | None = None) -> int:
        buffer = self.schema.BufferT()
        buffer.data = np.frombuffer(np.ascontiguousarray(array).tobytes(), dtype=np.uint8)
        self.model.buffers.append(buffer)
        index = self.tensor(array.shape, len(self.model.buffers) - 1)
        if scale is not None:
            self.graph.tensors[index].type = self.schema.TensorType.INT8
            quantization = self.graph.tensors[index].quantization = self.schema.QuantizationParametersT()
            quantization.scale, quantization.zeroPoint = scale, np.zeros(len(scale), dtype=np.int64)
        return index

    def _operator(self, kind: str, options: str, inputs: list[int], size: int) -> int:
        code = self.schema.OperatorCodeT()
        code.builtinCode = code.deprecatedBuiltinCode = getattr(self.schema.BuiltinOperator, kind)
        code.version = 5 if self.int8 and kind == "FULLY_CONNECTED" else 1
        operator = self.schema.OperatorT()
        operator.opcodeIndex, operator.inputs = len(self.model.operatorCodes), inputs
        operator.outputs = [self.tensor((1, size))]
        if options:
            operator.builtinOptionsType = getattr(self.schema.BuiltinOptions, f"{options}Options")
            operator.builtinOptions = getattr(self.schema, f"{options}OptionsT")()
        self.model.operatorCodes.append(code)
        self.graph.operators.append(operator)
        return operator.outputs[0]

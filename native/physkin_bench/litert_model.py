"""A LiteRT (TensorFlow Lite) model of the folded graph, written with the schema that ai-edge-litert brings."""

from __future__ import annotations

import numpy as np

from physkin_bench.network_case import NetworkCase
from physkin_core.model.mlp import Layer

__all__ = ["litert_model"]

SCHEMA_VERSION = 3


def litert_model(case: NetworkCase, *, int8: bool) -> bytes:
    """The flatbuffer of a model with the inputs pose and bones and one output.

    int8: network weights as 8-bit integers with a scale an output; LiteRT then rounds activations to 8 bits as it runs.
    """
    graph = _Graph(int8)
    pose, bones = graph.input("pose", case.pose.shape), graph.input("bones", case.bones.shape)
    x = pose
    for layer in case.hidden:
        x = graph.activate(graph.dense(x, layer, case.activation), case.activation)
    modulation = [(graph.dense(x, scale), graph.dense(x, shift)) for scale, shift in case.heads]
    x = bones
    for layer, (scale, shift) in zip(case.deformer[:-1], modulation, strict=True):
        x = graph.modulate(graph.dense(x, layer), scale, shift, case.activation)
        x = graph.activate(x, case.activation)
    return graph.finish([pose, bones], graph.dense(x, case.deformer[-1]))


class _Graph:
    """Tensors are indices into the subgraph. With ReLU the operation before the activation carries it, fused."""

    def __init__(self, int8: bool) -> None:
        from ai_edge_litert import schema_py_generated as schema

        self._schema = schema
        self._int8 = int8
        self._model = schema.ModelT()
        self._model.version = SCHEMA_VERSION
        self._model.buffers = [schema.BufferT()]  # the first one is empty by convention
        self._model.operatorCodes = []
        self._graph = schema.SubGraphT()
        self._graph.tensors, self._graph.operators = [], []

    def input(self, name: str, shape: tuple[int, ...]) -> int:
        return self._tensor(shape, name=name)

    def dense(self, x: int, layer: Layer, activation: str = "") -> int:
        weight, bias = layer
        options = self._schema.FullyConnectedOptionsT()
        options.fusedActivationFunction = self._fused(activation)
        inputs = [x, self._network_weight(weight), self._constant(bias)]
        return self._operator("FULLY_CONNECTED", inputs, len(bias), options, "FullyConnectedOptions")

    def modulate(self, x: int, scale: int, shift: int, activation: str) -> int:
        size = self._graph.tensors[x].shape[1]
        x = self._operator("MUL", [x, scale], size, self._schema.MulOptionsT(), "MulOptions")
        options = self._schema.AddOptionsT()
        options.fusedActivationFunction = self._fused(activation)
        return self._operator("ADD", [x, shift], size, options, "AddOptions")

    def activate(self, x: int, activation: str) -> int:
        if activation == "relu":
            return x
        size = self._graph.tensors[x].shape[1]
        gate = self._operator("LOGISTIC", [x], size, None, "NONE")
        return self._operator("MUL", [x, gate], size, self._schema.MulOptionsT(), "MulOptions")

    def finish(self, inputs: list[int], output: int) -> bytes:
        import flatbuffers

        self._graph.inputs, self._graph.outputs = inputs, [output]
        self._model.subgraphs = [self._graph]
        builder = flatbuffers.Builder()
        builder.Finish(self._model.Pack(builder), file_identifier=b"TFL3")
        return bytes(builder.Output())

    def _fused(self, activation: str) -> int:
        functions = self._schema.ActivationFunctionType
        return functions.RELU if activation == "relu" else functions.NONE

    def _network_weight(self, weight: np.ndarray) -> int:
        if not self._int8:
            return self._constant(weight)
        scale = np.maximum(np.abs(weight).max(axis=1), 1e-30) / 127
        quantization = self._schema.QuantizationParametersT()
        quantization.scale = scale.astype(np.float32)
        quantization.zeroPoint = np.zeros(len(scale), dtype=np.int64)
        quantization.quantizedDimension = 0
        rounded = np.round(weight / scale[:, None]).astype(np.int8)
        return self._constant(rounded, self._schema.TensorType.INT8, quantization)

    def _constant(self, array: np.ndarray, kind: int = 0, quantization=None) -> int:
        buffer = self._schema.BufferT()
        buffer.data = np.frombuffer(np.ascontiguousarray(array).tobytes(), dtype=np.uint8)
        self._model.buffers.append(buffer)
        return self._tensor(array.shape, len(self._model.buffers) - 1, kind, quantization)

    def _tensor(self, shape, buffer: int = 0, kind: int = 0, quantization=None, name: str = "") -> int:
        tensor = self._schema.TensorT()
        tensor.shape = np.array(shape, dtype=np.int32)
        tensor.type, tensor.buffer, tensor.quantization = kind, buffer, quantization
        tensor.name = name or f"tensor_{len(self._graph.tensors)}"
        self._graph.tensors.append(tensor)
        return len(self._graph.tensors) - 1

    def _operator(self, code: str, inputs: list[int], size: int, options, options_kind: str) -> int:
        operator = self._schema.OperatorT()
        operator.opcodeIndex = self._operator_code(getattr(self._schema.BuiltinOperator, code))
        output = self._tensor((1, size))
        operator.inputs, operator.outputs = inputs, [output]
        operator.builtinOptionsType = getattr(self._schema.BuiltinOptions, options_kind)
        operator.builtinOptions = options
        self._graph.operators.append(operator)
        return output

    def _operator_code(self, builtin: int) -> int:
        codes = self._model.operatorCodes
        for index, code in enumerate(codes):
            if code.builtinCode == builtin:
                return index
        code = self._schema.OperatorCodeT()
        code.builtinCode = builtin
        code.deprecatedBuiltinCode = min(builtin, 127)
        code.version = 5 if self._int8 and builtin == self._schema.BuiltinOperator.FULLY_CONNECTED else 1
        codes.append(code)
        return len(codes) - 1

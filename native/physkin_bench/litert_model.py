"""The folded graph as a LiteRT model, written by the schema that ai-edge-litert brings."""

from __future__ import annotations

import numpy as np

from physkin_bench.network_case import NetworkCase
from physkin_core.model.mlp import Layer

__all__ = ["litert_model"]

VERSION = 3
KINDS = {"mul": ("MUL", "Mul"), "add": ("ADD", "Add"), "sigmoid": ("LOGISTIC", ""), "relu": ("RELU", "")}
"""Operation -> operator code and options of the schema."""


def litert_model(case: NetworkCase, *, int8: bool) -> bytes:
    """The flatbuffer of a model, inputs pose and bones, one output. int8: network weights in 8 bits."""
    import flatbuffers
    from ai_edge_litert import schema_py_generated as schema

    writer = _Writer(schema, int8)

    def activate(x: int) -> int:
        return writer.add("mul", x, writer.add("sigmoid", x))

    x, y = writer.graph.inputs = [writer.tensor(getattr(case, name).shape, name=name) for name in ("pose", "bones")]
    for layer in case.hidden:
        x = activate(writer.dense(x, layer))
    for layer, (scale, shift) in zip(case.deformer, case.heads):
        y = writer.add("mul", writer.dense(y, layer), writer.dense(x, scale))
        y = activate(writer.add("add", y, writer.dense(x, shift)))
    writer.graph.outputs = [writer.dense(y, case.deformer[-1])]
    writer.graph.outputs += [activate(writer.dense(y, layer)) for layer in case.detail]
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
        inputs = [x, self._constant(weight, scale), self._constant(bias)]
        return self._operator("FULLY_CONNECTED", "FullyConnected", inputs, len(bias))

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

"""The folded graph as a model of other engines: ONNX by `onnx`, LiteRT by the schema that ai-edge-litert brings."""

from __future__ import annotations

import numpy as np

from physkin_bench.network_case import NetworkCase
from physkin_core.model.mlp import Layer

__all__ = ["litert_model", "onnx_model"]

OPSET, IR_VERSION, LITERT_VERSION = 17, 8, 3


def _write(case: NetworkCase, writer: _Onnx | _LiteRT):
    """The whole graph; returns the output's value: a name or an index."""

    def activate(x):
        return writer.add("relu", x) if case.activation == "relu" else writer.add("mul", x, writer.add("sigmoid", x))

    x, y = writer.input("pose", case.pose), writer.input("bones", case.bones)
    for layer in case.hidden:
        x = activate(writer.dense(x, layer))
    for layer, (scale, shift) in zip(case.deformer, case.heads):
        y = writer.add("mul", writer.dense(y, layer), writer.dense(x, scale))
        y = activate(writer.add("add", y, writer.dense(x, shift)))
    return writer.dense(y, case.deformer[-1])


class _Onnx:
    KINDS = {"mul": "Mul", "add": "Add", "sigmoid": "Sigmoid", "relu": "Relu"}

    def __init__(self, onnx) -> None:
        self.onnx, self.nodes, self.constants, self.inputs = onnx, [], [], []

    def value(self, name: str, array: np.ndarray):
        return self.onnx.helper.make_tensor_value_info(name, self.onnx.TensorProto.FLOAT, array.shape)

    def input(self, name: str, array: np.ndarray) -> str:
        self.inputs.append(self.value(name, array))
        return name

    def dense(self, x: str, layer: Layer) -> str:
        names = [f"constant_{len(self.constants)}", f"constant_{len(self.constants) + 1}"]
        self.constants += [self.onnx.numpy_helper.from_array(array, name) for array, name in zip(layer, names)]
        return self._node("Gemm", [x, *names], transB=1)

    def add(self, kind: str, *inputs: str) -> str:
        return self._node(self.KINDS[kind], inputs)

    def _node(self, kind: str, inputs, **attributes) -> str:
        name = f"value_{len(self.nodes)}"
        self.nodes.append(self.onnx.helper.make_node(kind, inputs, [name], **attributes))
        return name


def onnx_model(case: NetworkCase) -> bytes:
    """The serialised model, inputs pose and bones, one output."""
    import onnx

    writer = _Onnx(onnx)
    output = writer.value(_write(case, writer), case.expected)
    graph = onnx.helper.make_graph(writer.nodes, "networks", writer.inputs, [output], writer.constants)
    model = onnx.helper.make_model(graph, opset_imports=[onnx.helper.make_opsetid("", OPSET)])
    model.ir_version = IR_VERSION
    onnx.checker.check_model(model)
    return model.SerializeToString()


class _LiteRT:
    KINDS = {"mul": ("MUL", "Mul"), "add": ("ADD", "Add"), "sigmoid": ("LOGISTIC", ""), "relu": ("RELU", "")}

    def __init__(self, schema, int8: bool) -> None:
        self.schema, self.int8, self.inputs = schema, int8, []
        self.model, self.graph = schema.ModelT(), schema.SubGraphT()
        self.model.version, self.model.subgraphs, self.model.operatorCodes = LITERT_VERSION, [self.graph], []
        self.model.buffers = [schema.BufferT()]  # the first one is empty by convention
        self.graph.tensors, self.graph.operators = [], []

    def input(self, name: str, array: np.ndarray) -> int:
        self.inputs.append(self._tensor(array.shape, name=name))
        return self.inputs[-1]

    def dense(self, x: int, layer: Layer) -> int:
        weight, bias = layer
        scale = None
        if self.int8:  # a scale an output; LiteRT rounds activations to 8 bits as it runs
            scale = (np.maximum(np.abs(weight).max(axis=1), 1e-30) / 127).astype(np.float32)
            weight = np.round(weight / scale[:, None]).astype(np.int8)
        inputs = [x, self._constant(weight, scale), self._constant(bias)]
        return self._operator("FULLY_CONNECTED", "FullyConnected", inputs, len(bias))

    def add(self, kind: str, *inputs: int) -> int:
        return self._operator(*self.KINDS[kind], list(inputs), self.graph.tensors[inputs[0]].shape[1])

    def _constant(self, array: np.ndarray, scale: np.ndarray | None = None) -> int:
        buffer = self.schema.BufferT()
        buffer.data = np.frombuffer(np.ascontiguousarray(array).tobytes(), dtype=np.uint8)
        self.model.buffers.append(buffer)
        index = self._tensor(array.shape, len(self.model.buffers) - 1)
        if scale is not None:
            self.graph.tensors[index].type = self.schema.TensorType.INT8
            quantization = self.graph.tensors[index].quantization = self.schema.QuantizationParametersT()
            quantization.scale, quantization.zeroPoint = scale, np.zeros(len(scale), dtype=np.int64)
        return index

    def _tensor(self, shape, buffer: int = 0, name: str = "") -> int:
        tensor = self.schema.TensorT()
        tensor.shape, tensor.buffer = np.array(shape, dtype=np.int32), buffer
        tensor.name = name or f"tensor_{len(self.graph.tensors)}"
        self.graph.tensors.append(tensor)
        return len(self.graph.tensors) - 1

    def _operator(self, kind: str, options: str, inputs: list[int], size: int) -> int:
        code = self.schema.OperatorCodeT()
        code.builtinCode = code.deprecatedBuiltinCode = getattr(self.schema.BuiltinOperator, kind)
        code.version = 5 if self.int8 and kind == "FULLY_CONNECTED" else 1
        operator = self.schema.OperatorT()
        operator.opcodeIndex, operator.inputs = len(self.model.operatorCodes), inputs
        operator.outputs = [self._tensor((1, size))]
        if options:
            operator.builtinOptionsType = getattr(self.schema.BuiltinOptions, f"{options}Options")
            operator.builtinOptions = getattr(self.schema, f"{options}OptionsT")()
        self.model.operatorCodes.append(code)
        self.graph.operators.append(operator)
        return operator.outputs[0]


def litert_model(case: NetworkCase, *, int8: bool) -> bytes:
    """The flatbuffer of a model, inputs pose and bones, one output. int8: network weights in 8 bits."""
    import flatbuffers
    from ai_edge_litert import schema_py_generated as schema

    writer = _LiteRT(schema, int8)
    writer.graph.outputs = [_write(case, writer)]
    writer.graph.inputs = writer.inputs
    builder = flatbuffers.Builder()
    builder.Finish(writer.model.Pack(builder), file_identifier=b"TFL3")
    return bytes(builder.Output())

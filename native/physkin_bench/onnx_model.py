"""An ONNX model of the folded graph, for ONNX Runtime and OpenVINO."""

from __future__ import annotations

import numpy as np

from physkin_bench.network_case import NetworkCase
from physkin_core.model.mlp import Layer

__all__ = ["onnx_model"]

OPSET = 17


def onnx_model(case: NetworkCase, *, int8_weights: bool = False) -> bytes:
    """The serialised model with the inputs pose and bones and the output corrections.

    int8_weights: network weights stored as 8-bit integers with a scale an output, dequantised in the graph.
    """
    import onnx

    graph = _Graph(onnx, int8_weights)
    x = "pose"
    for layer in case.hidden:
        x = graph.activate(graph.dense(x, layer), case.activation)
    modulation = [(graph.dense(x, scale), graph.dense(x, shift)) for scale, shift in case.heads]
    x = "bones"
    for layer, (scale, shift) in zip(case.deformer[:-1], modulation, strict=True):
        x = graph.add("Mul", [graph.dense(x, layer), scale])
        x = graph.activate(graph.add("Add", [x, shift]), case.activation)
    graph.add("Identity", [graph.dense(x, case.deformer[-1])], output="corrections")

    def value(name: str, array: np.ndarray):
        return onnx.helper.make_tensor_value_info(name, onnx.TensorProto.FLOAT, array.shape)

    inputs = [value("pose", case.pose), value("bones", case.bones)]
    made = onnx.helper.make_graph(
        graph.nodes, "networks", inputs, [value("corrections", case.expected)], graph.constants
    )
    model = onnx.helper.make_model(made, opset_imports=[onnx.helper.make_opsetid("", OPSET)])
    model.ir_version = 8
    onnx.checker.check_model(model)
    return model.SerializeToString()


class _Graph:
    """Values are names."""

    def __init__(self, onnx, int8_weights: bool) -> None:
        self._onnx = onnx
        self._int8_weights = int8_weights
        self.nodes, self.constants = [], []

    def dense(self, x: str, layer: Layer) -> str:
        weight, bias = layer
        product = self.add("MatMul", [x, self._network_weight(weight)])
        return self.add("Add", [product, self._constant(bias)])

    def activate(self, x: str, activation: str) -> str:
        if activation == "relu":
            return self.add("Relu", [x])
        return self.add("Mul", [x, self.add("Sigmoid", [x])])

    def add(self, kind: str, inputs: list[str], *, output: str = "", **attributes) -> str:
        output = output or f"value_{len(self.nodes)}"
        self.nodes.append(self._onnx.helper.make_node(kind, inputs, [output], **attributes))
        return output

    def _network_weight(self, weight: np.ndarray) -> str:
        if not self._int8_weights:
            return self._constant(weight.T)
        scale = (np.maximum(np.abs(weight).max(axis=1), 1e-30) / 127).astype(np.float32)
        rounded = np.round(weight / scale[:, None]).astype(np.int8)
        inputs = [self._constant(rounded.T), self._constant(scale), self._constant(np.zeros(len(scale), np.int8))]
        return self.add("DequantizeLinear", inputs, axis=1)

    def _constant(self, array: np.ndarray) -> str:
        name = f"constant_{len(self.constants)}"
        self.constants.append(self._onnx.numpy_helper.from_array(np.ascontiguousarray(array), name))
        return name

"""Engines that run the same folded networks on one thread: LiteRT, ONNX Runtime, OpenVINO, torch, NumPy."""

from __future__ import annotations

import contextlib
import io
import tempfile
from pathlib import Path

import numpy as np

from physkin_bench.litert_model import litert_model
from physkin_bench.network_case import NetworkCase
from physkin_bench.onnx_model import onnx_model
from physkin_bench.peers import Peer, Runner, hold_blas_to_one_thread

__all__ = ["NETWORK_PEERS"]

EXACT, ROUNDED = 1e-4, 5e-2
"""Tolerances of fp32 and int8 engines."""


def _litert(case: NetworkCase, *, int8: bool) -> Runner:
    from ai_edge_litert.interpreter import Interpreter

    interpreter = Interpreter(model_content=litert_model(case, int8=int8), num_threads=1)
    interpreter.allocate_tensors()
    for detail in interpreter.get_input_details():
        interpreter.set_tensor(detail["index"], getattr(case, detail["name"]))
    output = interpreter.get_output_details()[0]["index"]
    return Runner(interpreter.invoke, lambda: interpreter.get_tensor(output))


def _onnxruntime(case: NetworkCase, *, int8: bool) -> Runner:
    import onnxruntime

    model = onnx_model(case)
    if int8:
        model = _quantised_for_onnxruntime(model)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(model, options, providers=["CPUExecutionProvider"])
    result = np.empty(case.expected.shape, dtype=np.float32)
    values = [onnxruntime.OrtValue.ortvalue_from_numpy(array) for array in (case.pose, case.bones, result)]
    binding = session.io_binding()
    binding.bind_ortvalue_input("pose", values[0])
    binding.bind_ortvalue_input("bones", values[1])
    binding.bind_ortvalue_output("corrections", values[2])
    return Runner(lambda: session.run_with_iobinding(binding), lambda: values[2].numpy())


def _quantised_for_onnxruntime(model: bytes) -> bytes:
    import logging

    from onnxruntime.quantization import QuantType, quantize_dynamic

    with tempfile.TemporaryDirectory() as folder:
        source, target = Path(folder, "fp32.onnx"), Path(folder, "int8.onnx")
        source.write_bytes(model)
        root = logging.getLogger()
        level = root.level
        root.setLevel(logging.ERROR)  # it advises preprocessing, which this graph does not need
        try:
            quantize_dynamic(source, target, per_channel=True, weight_type=QuantType.QInt8)
        finally:
            root.setLevel(level)
        return target.read_bytes()


def _openvino(case: NetworkCase, *, int8: bool) -> Runner:
    import openvino

    core = openvino.Core()
    model = core.read_model(onnx_model(case, int8_weights=int8))
    properties = {
        "INFERENCE_NUM_THREADS": 1,
        "NUM_STREAMS": 1,
        "PERFORMANCE_HINT": "LATENCY",
        "INFERENCE_PRECISION_HINT": "f32",
    }
    request = core.compile_model(model, "CPU", properties).create_infer_request()
    request.set_tensor("pose", openvino.Tensor(case.pose))
    request.set_tensor("bones", openvino.Tensor(case.bones))
    # Two calls cost less than `infer`, which gathers the results into a dictionary.
    return Runner(lambda: (request.start_async(), request.wait()), lambda: request.get_output_tensor().data.copy())


def _torch_module(case: NetworkCase):
    import torch

    linear = torch.nn.functional.linear
    act = {"relu": torch.relu, "silu": torch.nn.functional.silu}[case.activation]

    class Networks(torch.nn.Module):
        def __init__(self) -> None:
            super().__init__()
            flat = [layer for pair in case.heads for layer in pair]
            self.hidden, self.heads, self.deformer = map(self._register, "abc", (case.hidden, flat, case.deformer))

        def _register(self, prefix, layers):
            names = []
            for index, layer in enumerate(layers):
                for kind, array in zip("wb", layer):
                    self.register_buffer(f"{prefix}{index}{kind}", torch.from_numpy(array.copy()))
                names.append((f"{prefix}{index}w", f"{prefix}{index}b"))
            return names

        def _layer(self, x, names):
            return linear(x, getattr(self, names[0]), getattr(self, names[1]))

        def forward(self, pose, bones):
            for layer in self.hidden:
                pose = act(self._layer(pose, layer))
            for layer, scale, shift in zip(self.deformer, self.heads[::2], self.heads[1::2]):
                bones = act(self._layer(pose, scale) * self._layer(bones, layer) + self._layer(pose, shift))
            return self._layer(bones, self.deformer[-1])

    return Networks().eval(), (torch.from_numpy(case.pose), torch.from_numpy(case.bones))


def _torch_runner(call, inputs) -> Runner:
    import torch

    torch.set_num_threads(1)
    result = [None]

    def run():
        with torch.inference_mode():
            result[0] = call(*inputs)

    def output():
        value = result[0]
        return (value[0] if isinstance(value, list | tuple) else value).numpy()

    return Runner(run, output)


def _torch_eager(case: NetworkCase) -> Runner:
    return _torch_runner(*_torch_module(case))


def _torch_aot_inductor(case: NetworkCase) -> Runner:
    """Autotuned: three times faster than without."""
    import torch
    from torch._inductor import aoti_compile_and_package, aoti_load_package, config

    torch.set_num_threads(1)
    module, inputs = _torch_module(case)
    settings = {"freezing": True, "max_autotune": True, "max_autotune_gemm_backends": "CPP,ATEN"}
    with (
        tempfile.TemporaryDirectory() as folder,
        torch.no_grad(),
        config.patch(settings),
        contextlib.redirect_stderr(io.StringIO()),  # it reports on every layer
    ):
        program = torch.export.export(module, inputs)
        package = aoti_load_package(aoti_compile_and_package(program, package_path=f"{folder}/networks.pt2"))
    return _torch_runner(package, inputs)


def _numpy(case: NetworkCase) -> Runner:
    hold_blas_to_one_thread()
    result = [None]

    def act(x):
        return np.maximum(x, 0) if case.activation == "relu" else x / (1 + np.exp(-x))

    def run():
        pose, bones = case.pose[0], case.bones[0]
        for weight, bias in case.hidden:
            pose = act(weight @ pose + bias)
        for (weight, bias), ((scale, one), (shift, zero)) in zip(case.deformer, case.heads):
            bones = act((scale @ pose + one) * (weight @ bones + bias) + (shift @ pose + zero))
        weight, bias = case.deformer[-1]
        result[0] = weight @ bones + bias

    return Runner(run, lambda: result[0])


NETWORK_PEERS = (
    Peer("litert_fp32", ("ai-edge-litert",), lambda case: _litert(case, int8=False), EXACT),
    Peer("litert_int8", ("ai-edge-litert",), lambda case: _litert(case, int8=True), ROUNDED),
    Peer("onnxruntime_fp32", ("onnxruntime", "onnx"), lambda case: _onnxruntime(case, int8=False), EXACT),
    Peer("onnxruntime_int8", ("onnxruntime", "onnx"), lambda case: _onnxruntime(case, int8=True), ROUNDED),
    Peer("openvino_fp32", ("openvino", "onnx"), lambda case: _openvino(case, int8=False), EXACT),
    Peer("openvino_int8", ("openvino", "onnx"), lambda case: _openvino(case, int8=True), ROUNDED),
    Peer("torch_eager", ("torch",), _torch_eager, EXACT),
    Peer("torch_aot_inductor", ("torch",), _torch_aot_inductor, EXACT),
    Peer("numpy", ("numpy", "threadpoolctl"), _numpy, EXACT),
)

"""ONNX sessions: bound buffers, devices and their options, errors."""

import os
import subprocess
import sys
import types

import numpy as np
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper

from tests.support.networks.onnx_models import write_dfine, write_model, write_rectangle_finder
from track_range.detection.catalogue.lookup import find_model
from track_range.detection.models import devices, providers
from track_range.detection.models.dequantize import float_network
from track_range.detection.models.onnx_session import ModelError, OnnxSession, Runtime


def test_bound_network_reads_its_buffer(tmp_path):
    path = write_rectangle_finder(tmp_path / "m.onnx", side_px=96, grey=0.0)
    session = OnnxSession(path, Runtime(device="cpu", n_threads=1))
    network = session.bound((96, 96))
    for x1, x2 in ((10, 30), (50, 90)):
        network.blob[:] = 0
        network.blob[:, :, 20:40, x1:x2] = 1
        (rows,) = network.run()
        np.testing.assert_allclose(rows[0, 0, :4], [(x1 + x2) / 2, 30, x2 - x1, 20], rtol=1e-5)
        np.testing.assert_array_equal(rows, session.run(network.blob)[0])
    assert network.output_shapes == {"output0": (1, 567, 6)}


def test_int8_network_is_exact_on_every_cpu():
    """Distributions of box sides, stride 8, compared with those of the same network step by step in
    float: rounding differs by 3 % of their deviation, sums that saturate at 16 bit by 8 %.
    """
    path = find_model("road").path
    blob = np.random.default_rng(0).random((1, 3, 96, 160), np.float32)
    blob[:, :, 30:60, 40:90] = 0.1
    options = ort.SessionOptions()
    options.graph_optimization_level = ort.GraphOptimizationLevel.ORT_DISABLE_ALL
    in_float = ort.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])
    expected = in_float.run(None, {in_float.get_inputs()[0].name: blob})
    sides = OnnxSession(path, Runtime(device="cpu")).run(blob)[4]
    assert sides.shape == (1, 240, 32)
    assert np.sqrt(np.mean((sides - expected[4]) ** 2)) < 0.05 * expected[4].std()


class DeviceBinding:
    """An IOBinding that copies inputs when they are bound, as onnxruntime does for a network on a
    GPU."""

    def __init__(self, binding):
        self.binding, self.copies, self.n_bound = binding, {}, 0

    def __getattr__(self, name):
        return getattr(self.binding, name)

    def bind_cpu_input(self, name, array):
        self.copies[name] = array.copy()
        self.n_bound += 1
        self.binding.bind_cpu_input(name, self.copies[name])


class DeviceSession(ort.InferenceSession):
    def io_binding(self):
        return DeviceBinding(super().io_binding())

    def run_with_iobinding(self, iobinding, run_options=None):
        super().run_with_iobinding(iobinding.binding, run_options)


@pytest.mark.parametrize("device", ["cuda", "tensorrt"])
def test_inputs_on_a_gpu_are_copied_in_each_run(device, tmp_path, monkeypatch):
    path = write_rectangle_finder(tmp_path / "m.onnx", side_px=96, grey=0.0)
    monkeypatch.setattr(ort, "InferenceSession", DeviceSession)
    session = OnnxSession(path, Runtime(device="cpu", n_threads=1))
    session.device = device
    network = session.bound((96, 96))
    other = np.zeros_like(network.blob)
    for x1, x2 in ((10, 30), (50, 90)):
        for blob in (network.blob, other, other):
            blob[:] = 0
            blob[:, :, 20:40, x1:x2] = 1
            (rows,) = network.run(blob)
            np.testing.assert_allclose(rows[0, 0, :4], [(x1 + x2) / 2, 30, x2 - x1, 20], rtol=1e-5)
            x1 += 1


def test_inputs_on_the_cpu_are_bound_once(tmp_path, monkeypatch):
    path = write_rectangle_finder(tmp_path / "m.onnx", side_px=96, grey=0.0)
    monkeypatch.setattr(ort, "InferenceSession", DeviceSession)
    network = OnnxSession(path, Runtime(device="cpu", n_threads=1)).bound((96, 96))
    network.run()
    network.run()
    assert network._binding.n_bound == 1


def test_boxes_are_scaled_to_the_input(tmp_path):
    inputs = {"images": ("N", 3, 32, 96), "orig_target_sizes": ("N", 2)}
    logits, boxes = np.array([[3.0, -3.0]]), np.array([[0.5, 0.5, 0.5, 1.0]])
    session = OnnxSession(
        write_dfine(tmp_path / "m.onnx", logits, boxes, inputs=inputs, n_selected=1)
    )
    network = session.bound((32, 96))
    for outputs in (network.run(), session.run(np.zeros((1, 3, 32, 96), np.float32))):
        np.testing.assert_allclose(outputs[1], [[[24, 0, 72, 32]]])
    assert network.integer_outputs == {"labels"}
    assert session.input_shape == (None, 3, 32, 96)


def test_unsupported_input_size(tmp_path):
    session = OnnxSession(write_model(tmp_path / "m.onnx", np.zeros((1, 2, 3))))
    with pytest.raises(ModelError, match=r"m\.onnx: .*failed"):
        session.bound((32, 32))
    with pytest.raises(ModelError, match=r"m\.onnx: .*failed"):
        session.run(np.zeros((1, 3, 32, 32), np.float32))


def test_half_precision_in_and_out(tmp_path):
    session = OnnxSession(write_model(tmp_path / "m.onnx", np.full((1, 2, 3), 0.5), is_half=True))
    network = session.bound((64, 64))
    assert network.blob.dtype == np.float16
    (rows,) = network.run()
    assert (rows.dtype, rows.max()) == (np.float32, 0.5)


class CpuSession(ort.InferenceSession):
    """A session on the CPU that notes the providers it was asked for; of them, `failing` raise."""

    requested, failing = [], ()

    def __init__(self, path, options, providers=None, **given):
        self.requested.append((options, providers))
        if providers and providers[0][0] in self.failing:
            place = (
                "/onnxruntime_src/core/cuda_call.cc:123 void onnxruntime::Call(int, const T&) "
                "[with T = char] "
            )
            raise RuntimeError(f"{place}CUDA failure 100: no CUDA-capable device is detected\nmore")
        super().__init__(path, options, providers=["CPUExecutionProvider"], **given)


@pytest.fixture
def cpu_session(monkeypatch, tmp_path):
    monkeypatch.setattr(ort, "InferenceSession", CpuSession)
    monkeypatch.setattr(CpuSession, "requested", [])
    monkeypatch.setenv("TRACK_RANGE_CACHE", str(tmp_path))
    providers._load_cuda.cache_clear()
    return CpuSession


NAMES = ["TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider"]


@pytest.mark.parametrize(
    ("available", "device", "expected", "words"),
    [
        (NAMES[2:], "auto", NAMES[2:], None),
        (NAMES, "auto", NAMES[1:], None),
        (NAMES, "cpu", NAMES[2:], None),
        # the session is on the CPU
        (NAMES, "cuda", NAMES[1:], "libraries cannot be loaded; install onnxruntime-gpu"),
        (NAMES, "tensorrt", NAMES, "libraries cannot be loaded"),
        (NAMES[1:], "tensorrt", NAMES[1:], "TensorRT"),
        (NAMES[2:], "cuda", NAMES[2:], "install onnxruntime-gpu"),
        (NAMES[2:], "openvino", NAMES[2:], "onnxruntime-ep-openvino"),
        (NAMES[2:], "coreml", NAMES[2:], "onnxruntime on macOS"),
        (NAMES[2:], "directml", NAMES[2:], "install onnxruntime-directml in place of onnxruntime"),
    ],
)
def test_only_available_providers_are_requested(
    tmp_path, monkeypatch, cpu_session, available, device, expected, words
):
    path = write_model(tmp_path / "m.onnx", np.zeros((1, 2, 3)))
    monkeypatch.setattr(ort, "get_available_providers", lambda: available)
    session = OnnxSession(path, Runtime(device=device))
    ((options, requested),) = cpu_session.requested
    assert [name for name, _ in requested] == expected
    assert (session.device, options.enable_mem_pattern) == ("cpu", True)
    if words is None:
        assert session.notes == ()
    else:
        (note,) = session.notes
        assert f"--device {device} is not available (" in note
        assert words in note
        assert note.endswith("); using cpu.")
    if expected == NAMES:
        assert requested[0][1]["trt_fp16_enable"]
        assert requested[0][1]["trt_engine_cache_path"] == str(tmp_path / "engines")


def test_a_device_that_fails_when_it_is_opened(tmp_path, monkeypatch, cpu_session):
    path = write_model(tmp_path / "m.onnx", np.zeros((1, 2, 3)))
    monkeypatch.setattr(ort, "get_available_providers", lambda: NAMES)
    monkeypatch.setattr(cpu_session, "failing", NAMES[:2])
    session = OnnxSession(path, Runtime(device="tensorrt"))
    assert [requested[0][0] for _, requested in cpu_session.requested] == NAMES
    reason = "CUDA failure 100: no CUDA-capable device is detected"
    assert session.notes == (f"--device tensorrt is not available ({reason}); using cpu.",)
    path.write_bytes(b"x")
    with pytest.raises(ModelError, match=r"m\.onnx: "):
        OnnxSession(path, Runtime(device="tensorrt"))


@pytest.mark.parametrize("is_bound", [True, False])
def test_a_device_that_fails_in_its_first_run(tmp_path, monkeypatch, is_bound):
    path = write_rectangle_finder(tmp_path / "m.onnx", side_px=96, grey=0.0)

    class Failing(ort.InferenceSession):
        n_runs = 0

        def run(self, *given, **options):
            Failing.n_runs += 1
            if Failing.n_runs == 1:
                raise RuntimeError("no kernel image is available")
            return super().run(*given, **options)

    monkeypatch.setattr(ort, "InferenceSession", Failing)
    session = OnnxSession(path, Runtime(device="cpu"))
    session.device = "cuda"
    blob = np.zeros((1, 3, 96, 96), np.float32)
    blob[:, :, 20:40, 10:30] = 1
    (rows,) = session.bound((96, 96)).run(blob) if is_bound else session.run(blob)
    np.testing.assert_allclose(rows[0, 0, :4], [20, 30, 20, 20], rtol=1e-5)
    assert session.notes == (
        "--device cuda failed in its first run (no kernel image is available); using the CPU.",
    )
    assert session.device == "cpu"
    session.device, Failing.n_runs = "cuda", 0
    with pytest.raises(ModelError, match="no kernel image"):  # only the first run may fail
        session.run(blob)


def test_a_provider_of_a_separate_package(tmp_path, monkeypatch):
    """The CPU's provider stands for that of the package."""
    module, registered = types.ModuleType("ep"), []
    module.get_ep_name, module.get_library_path = lambda: "CPUExecutionProvider", lambda: "libep.so"
    accelerator = devices.Accelerator("CPUExecutionProvider", "ep-package", "ep")
    monkeypatch.setattr(
        providers, "ACCELERATORS", {**devices.ACCELERATORS, "openvino": accelerator}
    )
    monkeypatch.setattr(ort, "get_available_providers", list)
    monkeypatch.setattr(
        ort, "register_execution_provider_library", lambda *given: registered.append(given)
    )
    path = write_rectangle_finder(tmp_path / "m.onnx", side_px=96, grey=0.0)
    providers._is_registered.cache_clear()
    assert providers.why_missing("openvino") == "install ep-package"
    monkeypatch.setitem(sys.modules, "ep", module)
    providers._is_registered.cache_clear()
    for _ in range(2):
        session = OnnxSession(path, Runtime(device="openvino"))
        assert (session.device, session.notes) == ("openvino", ())
    assert registered == [("CPUExecutionProvider", "libep.so")]
    assert session.run(np.zeros((1, 3, 96, 96), np.float32))[0].shape == (1, 567, 6)
    monkeypatch.setattr(ort, "get_ep_devices", list)
    assert providers.why_missing("openvino") == "ep-package supports no hardware of this machine"
    providers._is_registered.cache_clear()


def test_networks_of_int8_are_float_on_gpus(tmp_path, monkeypatch, cpu_session):
    """A weight per channel and an input, rounded: 1 x 2 x 4 -> channels times 0.5 and -1.5."""
    half = [
        helper.make_tensor("s", TensorProto.FLOAT, [2], [0.25, 0.5]),
        helper.make_tensor("z", TensorProto.INT8, [2], [0, 1]),
    ]
    one = [
        helper.make_tensor("a", TensorProto.FLOAT, [], [0.5]),
        helper.make_tensor("b", TensorProto.INT8, [], [0]),
    ]
    weight = helper.make_tensor("w", TensorProto.INT8, [2, 1, 1, 1], [2, -2])
    nodes = [
        helper.make_node("QuantizeLinear", ["images", "a", "b"], ["q"]),
        helper.make_node("DequantizeLinear", ["q", "a", "b"], ["x"]),
        helper.make_node("DequantizeLinear", ["w", "s", "z"], ["v"], axis=0),
        helper.make_node("Conv", ["x", "v"], ["out"]),
    ]
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 1, 1, 4))
    out = helper.make_tensor_value_info("out", TensorProto.FLOAT, (1, 2, 1, 4))
    graph = helper.make_graph(nodes, "g", [image], [out], [*half, *one, weight])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    path = tmp_path / "m.onnx"
    path.write_bytes(model.SerializeToString())
    monkeypatch.setattr(ort, "get_available_providers", lambda: NAMES)
    values = np.array([0.1, 0.3, 1.0, 3.0], np.float32)
    for device, expected in (("cpu", [0.0, 0.5, 1.0, 3.0]), ("cuda", values)):
        (outputs,) = OnnxSession(path, Runtime(device=device)).run(np.tile(values, (1, 3, 1, 1)))
        np.testing.assert_allclose(
            outputs[0, :, 0], np.outer([0.5, -1.5], expected), rtol=1e-5, atol=1e-6
        )
    assert float_network(write_model(tmp_path / "float.onnx", np.zeros((1, 2, 3)))) is None
    # rounded in the network
    weights = helper.make_tensor("w", TensorProto.FLOAT, [2, 1, 1, 1], [0.3, -0.7])
    nodes[2:3] = [
        helper.make_node("QuantizeLinear", ["w", "a", "b"], ["r"]),
        helper.make_node("DequantizeLinear", ["r", "a", "b"], ["v"]),
    ]
    graph = helper.make_graph(nodes, "g", [image], [out], [*half, *one, weights])
    path.write_bytes(
        helper.make_model(
            graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8
        ).SerializeToString()
    )
    assert float_network(path) is None


def test_sessions_of_the_cpu_do_not_import_onnx(tmp_path):
    """The import of onnx takes 0.4 s of each start."""
    code = (
        "import sys; from pathlib import Path; from track_range.detection.models.onnx_session "
        "import OnnxSession\nOnnxSession(Path(sys.argv[1])); print('onnx' in sys.modules)"
    )
    path = write_model(tmp_path / "m.onnx", np.zeros((1, 2, 3)))
    done = subprocess.run(
        [sys.executable, "-c", code, path], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"


@pytest.mark.parametrize(("n_limited", "given", "n_threads"), [(0, 0, 0), (3, 0, 3), (3, 5, 5)])
def test_number_of_threads(tmp_path, monkeypatch, cpu_session, n_limited, given, n_threads):
    monkeypatch.setattr(providers, "n_limited_cores", lambda: n_limited)
    OnnxSession(write_model(tmp_path / "m.onnx", np.zeros((1, 2, 3))), Runtime(n_threads=given))
    assert cpu_session.requested[0][0].intra_op_num_threads == n_threads


@pytest.mark.parametrize(
    ("shape", "word"),
    [
        ((1, 3, 65536, 65536), "8192 pixels"),
        ((1, 3, 8192, 8193), "8192 pixels"),
        ((100_000, 3, 64, 64), "8192 pixels"),
        ((8, 3, 8192, 8192), "values"),
        ((1, 3, 0, 64), "pixels"),
        ((1, 3 * 64 * 64), "one input"),
    ],
)
def test_implausible_inputs(tmp_path, shape, word):
    path = write_model(tmp_path / "m.onnx", np.zeros((1, 2, 3)), input_shape=shape)
    with pytest.raises(ModelError, match=rf"m\.onnx: .*{word}") as error:
        OnnxSession(path)
    assert len(str(error.value).replace(str(path), "")) <= 300


def test_input_of_integers(tmp_path):
    image, out = (
        helper.make_tensor_value_info(name, TensorProto.INT32, (1, 3, 8, 8)) for name in ("a", "b")
    )
    graph = helper.make_graph([helper.make_node("Identity", ["a"], ["b"])], "g", [image], [out])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    (tmp_path / "m.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(ModelError, match=r"m\.onnx: .*int32"):
        OnnxSession(tmp_path / "m.onnx")


def with_external_weights(path, location):
    tensor = TensorProto(
        name="c", data_type=TensorProto.FLOAT, dims=[1, 2, 3], data_location=TensorProto.EXTERNAL
    )
    for key, value in (("location", location), ("offset", "0"), ("length", "24")):
        tensor.external_data.add(key=key, value=value)
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, 8, 8))
    out = helper.make_tensor_value_info("out", TensorProto.FLOAT, (1, 2, 3))
    graph = helper.make_graph(
        [helper.make_node("Identity", ["c"], ["out"])], "g", [image], [out], [tensor]
    )
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    path.write_bytes(model.SerializeToString())


def test_external_weights_are_read_from_the_folder_only(tmp_path):
    folder = tmp_path / "models"
    folder.mkdir()
    for file in (tmp_path / "secret.bin", folder / "weights.bin"):
        np.arange(6, dtype=np.float32).tofile(file)
    (folder / "link.bin").symlink_to("../secret.bin")
    os.mkfifo(folder / "pipe.bin")
    path = folder / "m.onnx"
    with_external_weights(path, "weights.bin")
    (values,) = OnnxSession(path, Runtime(device="cpu")).run(np.zeros((1, 3, 8, 8), np.float32))
    assert values.ravel().tolist() == [0, 1, 2, 3, 4, 5]
    for location in (
        "../secret.bin",
        str(tmp_path / "secret.bin"),
        "link.bin",
        "pipe.bin",
        "none.bin",
        "/dev/zero",
    ):
        with_external_weights(path, location)
        with pytest.raises(ModelError, match=r"folder|pipe|no such file"):
            OnnxSession(path)


@pytest.mark.parametrize("content", [b"", b"\0" * 100, b"location", bytes(range(256)) * 4])
def test_damaged_models(tmp_path, content):
    (tmp_path / "m.onnx").write_bytes(content)
    with pytest.raises(ModelError, match=r"m\.onnx: ") as error:
        OnnxSession(tmp_path / "m.onnx")
    assert len(str(error.value).replace(str(tmp_path), "")) <= 300


def test_a_model_that_is_a_named_pipe(tmp_path):
    os.mkfifo(tmp_path / "m.onnx")
    with pytest.raises(ModelError, match=r"m\.onnx: .*pipe"):
        OnnxSession(tmp_path / "m.onnx")

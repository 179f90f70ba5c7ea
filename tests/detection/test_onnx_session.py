"""ONNX sessions: bound buffers, devices and their options, errors."""

import os

import numpy as np
import onnxruntime as ort
import pytest
from onnx import TensorProto, helper

from tests.detection.onnx_models import write_dfine, write_model, write_rectangle_finder
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


class DeviceBinding:
    """An IOBinding that copies inputs when they are bound, as onnxruntime does for a network on a GPU."""

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
    session = OnnxSession(write_dfine(tmp_path / "m.onnx", logits, boxes, inputs=inputs, n_selected=1))
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


def test_only_available_providers_are_requested(tmp_path, monkeypatch):
    requested = {}

    class Session(ort.InferenceSession):
        def __init__(self, path, options, providers):
            requested["providers"] = providers
            super().__init__(path, options, providers=["CPUExecutionProvider"])

    path = write_model(tmp_path / "m.onnx", np.zeros((1, 2, 3)))
    monkeypatch.setattr(ort, "InferenceSession", Session)
    providers = ["TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider"]
    for available, device, expected in (
        (providers[2:], "auto", providers[2:]),
        (providers, "auto", providers[1:]),
        (providers, "cpu", providers[2:]),
        (providers, "cuda", providers[1:]),
        (providers, "tensorrt", providers),
        (providers[1:], "tensorrt", providers[1:]),
    ):
        monkeypatch.setattr(ort, "get_available_providers", lambda available=available: available)
        session = OnnxSession(path, Runtime(device=device, engine_folder=tmp_path))
        assert [name for name, _ in requested["providers"]] == expected
        notes = [note for note in session.notes if f"--device {device} is not available" in note]
        assert len(notes) == (device in ("cuda", "tensorrt"))  # the substitute session always runs on the CPU
    monkeypatch.setattr(ort, "get_available_providers", lambda: providers)
    OnnxSession(path, Runtime(device="tensorrt", engine_folder=tmp_path))
    options = requested["providers"][0][1]
    assert options["trt_fp16_enable"]
    assert options["trt_engine_cache_path"] == str(tmp_path)


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
    image, out = (helper.make_tensor_value_info(name, TensorProto.INT32, (1, 3, 8, 8)) for name in ("a", "b"))
    graph = helper.make_graph([helper.make_node("Identity", ["a"], ["b"])], "g", [image], [out])
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)], ir_version=8)
    (tmp_path / "m.onnx").write_bytes(model.SerializeToString())
    with pytest.raises(ModelError, match=r"m\.onnx: .*int32"):
        OnnxSession(tmp_path / "m.onnx")


def with_external_weights(path, location):
    tensor = TensorProto(name="c", data_type=TensorProto.FLOAT, dims=[1, 2, 3], data_location=TensorProto.EXTERNAL)
    for key, value in (("location", location), ("offset", "0"), ("length", "24")):
        tensor.external_data.add(key=key, value=value)
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, 8, 8))
    out = helper.make_tensor_value_info("out", TensorProto.FLOAT, (1, 2, 3))
    graph = helper.make_graph([helper.make_node("Identity", ["c"], ["out"])], "g", [image], [out], [tensor])
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
    for location in ("../secret.bin", str(tmp_path / "secret.bin"), "link.bin", "pipe.bin", "none.bin", "/dev/zero"):
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

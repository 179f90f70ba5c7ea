"""ONNX sessions: bound buffers, devices and their options, errors."""

import numpy as np
import onnxruntime as ort
import pytest

from tests.detection.onnx_models import write_model, write_rectangle_finder
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

"""Sessions: buffers that are really the network's, devices and their options, failures in one sentence."""

import numpy as np
import onnxruntime as ort
import pytest

from tests.detection.onnx_models import write_model, write_rectangle_finder
from track_range.detection.models.onnx_session import ModelError, OnnxSession, Runtime


def test_a_bound_network_reads_its_own_buffer_each_time(tmp_path):
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


def test_a_size_that_the_network_does_not_take(tmp_path):
    session = OnnxSession(write_model(tmp_path / "m.onnx", np.zeros((1, 2, 3))))
    with pytest.raises(ModelError, match=r"m\.onnx: the network failed \("):
        session.bound((32, 32))
    with pytest.raises(ModelError, match=r"m\.onnx: the network failed \("):
        session.run(np.zeros((1, 3, 32, 32), np.float32))


def test_half_precision_in_and_out(tmp_path):
    session = OnnxSession(write_model(tmp_path / "m.onnx", np.full((1, 2, 3), 0.5), is_half=True))
    network = session.bound((64, 64))
    assert network.blob.dtype == np.float16
    (rows,) = network.run()
    assert (rows.dtype, rows.max()) == (np.float32, 0.5)


def test_devices_are_asked_for_only_where_this_onnxruntime_has_them(tmp_path, monkeypatch):
    asked = {}

    class Session(ort.InferenceSession):
        def __init__(self, path, options, providers):
            asked["providers"] = providers
            super().__init__(path, options, providers=["CPUExecutionProvider"])

    path = write_model(tmp_path / "m.onnx", np.zeros((1, 2, 3)))
    monkeypatch.setattr(ort, "InferenceSession", Session)
    every = ["TensorrtExecutionProvider", "CUDAExecutionProvider", "CPUExecutionProvider"]
    for there, device, wanted in (
        (every[2:], "auto", every[2:]),
        (every, "auto", every[1:]),
        (every, "cpu", every[2:]),
        (every, "cuda", every[1:]),
        (every, "tensorrt", every),
        (every[1:], "tensorrt", every[1:]),
    ):
        monkeypatch.setattr(ort, "get_available_providers", lambda there=there: there)
        session = OnnxSession(path, Runtime(device=device, engine_folder=tmp_path))
        assert [name for name, _ in asked["providers"]] == wanted
        told = [note for note in session.notes if f"--device {device} is not to be had" in note]
        assert len(told) == (device in ("cuda", "tensorrt"))  # the stand-in runs on the CPU whatever it is asked for
    monkeypatch.setattr(ort, "get_available_providers", lambda: every)
    OnnxSession(path, Runtime(device="tensorrt", engine_folder=tmp_path))
    options = asked["providers"][0][1]
    assert options["trt_fp16_enable"]
    assert options["trt_engine_cache_path"] == str(tmp_path)

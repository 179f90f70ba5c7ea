"""Notes of a run on its inputs, in summary.json."""

from __future__ import annotations

import json

import pytest

from tests.support.networks.onnx_models import write_mean_network
from track_range.detection.models.onnx_session import OnnxSession, Runtime


def test_notes_of_the_reid_network(tmp_path, cli, film):
    network = write_mean_network(tmp_path / "reid.onnx", input_shape=["batch", 3, 60, 30])
    notes = OnnxSession(network, Runtime(device="cuda")).notes
    if not notes:
        pytest.skip("CUDA is available, so there is no note")
    video = film(tmp_path / "film.mp4", [0.0, 0.1, 0.2])
    (tmp_path / "boxes.txt").write_text(
        "0 1 Car 0 0 0 10 10 40 40 -1 -1 -1 -1000 -1000 -1000 -10 0.9\n"
    )
    inputs = ("--mono", video, "--detections", tmp_path / "boxes.txt", "--focal-px", 60)
    options = ("--reid", network, "--device", "cuda", "--no-overlay", "--lanes", "off")
    status, _, complaint = cli(*inputs, *options, "--out", tmp_path / "out")
    assert status == 0, complaint
    assert json.loads((tmp_path / "out/summary.json").read_text())["notes"].count(notes[0]) == 1


def test_notes_on_unused_options_and_empty_detections(tmp_path, cli, film):
    video = film(tmp_path / "film.mp4", [0.0, 0.1])
    (tmp_path / "boxes.txt").touch()
    inputs = ("--mono", video, "--detections", tmp_path / "boxes.txt", "--focal-px", 60)
    options = (
        "--align",
        tmp_path / "none.yaml",
        "--letterbox",
        "stretch",
        "--size",
        320,
        "--lanes",
        "off",
    )
    status, _, complaint = cli(*inputs, *options, "--no-overlay", "--out", tmp_path / "out")
    assert status == 0, complaint
    notes = " ".join(json.loads((tmp_path / "out/summary.json").read_text())["notes"])
    for words in (
        "--align is not used",
        "--letterbox, --size are not used with --detections",
        "boxes.txt is empty",
    ):
        assert words in notes
    inputs = ("--mono", video, "--detections", tmp_path / "boxes.txt", "--focal-px", 60)
    assert cli(*inputs, "--lanes", "off", "--no-overlay", "--out", tmp_path / "plain")[0] == 0
    assert "not used" not in (tmp_path / "plain/summary.json").read_text()

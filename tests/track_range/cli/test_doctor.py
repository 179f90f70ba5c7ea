"""`track-range doctor`: its report, and what it says of a broken installation."""

import json
import math
import re
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.networks.depth_networks import encoded, write_depth, write_stereo
from track_range.cli.commands import doctor
from track_range.detection.catalogue import lookup


@pytest.mark.slow
def test_report_as_json(cli):
    status, text, _ = cli("doctor", "--json")
    report = json.loads(text)
    assert (status, report["ok"]) == (0, True)
    assert Path(report["folders"]["package"]).name == "track_range"
    assert set(report) == {
        "ok",
        "system",
        "versions",
        "inference",
        "codecs",
        "extras",
        "folders",
        "checks",
    }
    assert re.match(r"\d+\.\d+", report["versions"]["numpy"])
    assert re.fullmatch(r"\d+\.\d ms per image", report["inference"]["device cpu"])
    assert set(report["checks"].values()) == {"ok"}


# corners in px, score
BOXES = np.array([[10.0, 20, 50, 60, 0.9], [60, 20, 90, 60, 0.6], [10, 60, 40, 90, 0.3]])


def device_results(**tested):
    """A test of devices with these results."""
    return lambda device: doctor._Tested(
        *tested.get(device, (math.nan, np.zeros((0, 5)), f"not available (install {device})"))
    )


@pytest.fixture
def only_quick_checks(monkeypatch):
    """The checks without the run and without running the detector."""
    monkeypatch.setattr(doctor, "tested", device_results(cpu=(10.0, BOXES)))
    quick = {name: check for name, check in doctor.CHECKS.items() if name != "short run"}
    monkeypatch.setattr(doctor, "CHECKS", quick)


@pytest.mark.usefixtures("only_quick_checks")
def test_report_as_text(cli):
    status, text, _ = cli("doctor")
    assert status == 0
    for words in ("onnxruntime", "libx264 yes", "model cache", "GB free"):
        assert words in text


@pytest.mark.usefixtures("only_quick_checks")
def test_failed_check(cli, monkeypatch):
    monkeypatch.setattr(doctor, "ENCODERS", ("libx264", "no-such-encoder"))
    status, text, complaint = cli("doctor")
    assert status == 1
    assert "libx264 yes, no-such-encoder no" in text
    assert "no-such-encoder" in complaint
    assert len(complaint.strip().splitlines()) == 1


@pytest.mark.usefixtures("only_quick_checks")
@pytest.mark.parametrize(
    ("boxes", "is_right", "words"),
    [
        (
            BOXES[[2, 1, 0]] + [0, 0, 2.5, -1, -0.08],
            True,
            "boxes up to 2.5 px and scores up to 0.08 off the CPU's",
        ),
        (BOXES + np.eye(5)[0] * 3.5, False, "boxes up to 3.5 px and scores up to 0.00"),
        (BOXES - [0, 0, 0, 0, 0.12], False, "boxes up to 0.0 px and scores up to 0.12"),
        # the third one is no clear object
        (BOXES[:2], True, "boxes up to 0.0 px and scores up to 0.00"),
        (BOXES[:1], False, "boxes up to 50.0 px"),
        (BOXES[:0], False, "boxes up to inf px"),
        (np.full((1, 5), math.nan), False, "boxes up to nan px"),
    ],
)
def test_devices(cli, monkeypatch, boxes, is_right, words):
    monkeypatch.setattr(doctor, "tested", device_results(cpu=(10.0, BOXES), cuda=(1.5, boxes)))
    status, text, complaint = cli("doctor", "--json")
    report = json.loads(text)
    assert status == (0 if is_right else 1)
    assert report["inference"]["device cpu"] == "10.0 ms per image"
    assert report["inference"]["device openvino"] == "not available (install openvino)"
    assert report["inference"]["device cuda"].startswith(f"1.5 ms per image; {words}")
    assert ("the boxes found on cuda" in complaint) == (not is_right)
    assert is_right == (report["checks"]["devices"] == "ok")


@pytest.mark.usefixtures("only_quick_checks")
def test_several_distributions_of_a_package(cli, monkeypatch):
    found = {"opencv-python-headless": "5.0", "opencv-python": "4.9"}
    monkeypatch.setattr(
        doctor, "installed_versions", lambda name: found if "opencv" in name else {name: "1"}
    )
    monkeypatch.setattr(doctor, "conflicts", lambda: ("Uninstall both.",))
    status, text, _ = cli("doctor", "--json")
    report = json.loads(text)
    assert report["versions"]["opencv-python-headless"] == "5.0, 4.9 (opencv-python)"
    assert (status, report["checks"]["packages"]) == (1, "Uninstall both.")


@pytest.mark.usefixtures("only_quick_checks")
def test_full_disk(cli, monkeypatch):
    monkeypatch.setattr(doctor, "MIN_FREE_BYTES", 10**18)
    status, text, complaint = cli("doctor", "--json")
    assert (status, json.loads(text)["ok"]) == (1, False)
    assert "disk space" in complaint


def test_failing_check_does_not_hide_others(monkeypatch, cli):
    def broken():
        raise OSError("no such file")

    monkeypatch.setattr(doctor, "CHECKS", {"short run": broken, "disk space": lambda: ""})
    status, text, _ = cli("doctor", "--json")
    assert status == 1
    assert json.loads(text)["checks"] == {"short run": "OSError: no such file", "disk space": "ok"}


@pytest.mark.usefixtures("only_quick_checks")
def test_broken_installation_is_described(cli, monkeypatch):
    monkeypatch.setitem(sys.modules, "av", None)
    monkeypatch.setattr(lookup, "DEFAULT_MODEL", "no-such-model")
    status, text, complaint = cli("doctor", "--json")
    report = json.loads(text)
    assert status == 1
    assert "H.264 encoder" in complaint
    assert "unknown" in report["versions"]["FFmpeg"]
    assert "no-such-model" in report["inference"]["default detector"]


@pytest.mark.usefixtures("only_quick_checks")
def test_cache_not_yet_created(cli, monkeypatch, tmp_path):
    monkeypatch.setenv("TRACK_RANGE_CACHE", str(tmp_path / "cache"))
    _, text, _ = cli("doctor", "--json")
    assert "not created yet" in json.loads(text)["folders"]["model cache"]


def test_a_depth_network_is_described(cli, tmp_path):
    model = write_depth(tmp_path / "made.onnx", settings="multiple: 14\narea: 20000\nfocal_px: 300")
    image = tmp_path / "image.png"
    cv2.imwrite(str(image), encoded(np.linspace(40.0, 5.0, 90)[:, None].repeat(160, axis=1)))
    arguments = ("doctor", model, "--image", image, "--focal-px", "150")
    status, text, _ = cli(*arguments)
    assert status == 0
    for words in (
        "depth network (from made.yaml)",
        "182x112 for images of 160x90 (stretch",
        "depth times f / 300",
        "upper third",
        "ms per image (on cpu)",
    ):
        assert words in text
    model_as_json = json.loads(cli(*arguments, "--json")[1])["model"]
    assert model_as_json["scale"]["value"] == "metric"
    assert re.match(r"[\d.]+ \([\d.]+ to [\d.]+\) m", model_as_json["upper third"]["value"])


def test_a_stereo_network_needs_two_images(cli, tmp_path):
    image = tmp_path / "image.png"
    cv2.imwrite(str(image), encoded(np.full((60, 80), 20.0), 1 / 256))
    model = write_stereo(tmp_path / "made.onnx")
    status, _, error = cli("doctor", model, "--image", image)
    assert (status, "expected 2 for a stereo network, found 1" in error) == (1, True)
    status, text, _ = cli("doctor", model, "--image", image, "--image", image)
    assert (status, "lower third" in text, "20 (20 to 20) px" in text) == (0, True, True)


def test_a_detector_is_described(cli):
    status, text, _ = cli("doctor", lookup.find_model(lookup.DEFAULT_MODEL).path)
    assert status == 0
    for words in ("detector", "road classes", "letterbox"):
        assert words in text


def test_a_network_that_is_neither_is_an_error(cli, tmp_path):
    model = write_depth(tmp_path / "made.onnx")
    model.with_suffix(".yaml").unlink()
    status, _, error = cli("doctor", model)
    assert status == 1
    for words in ("made.onnx", "write made.yaml with `format: depth-anything`", "no detector"):
        assert words in error


def test_a_wrong_key_beside_a_network_is_one_sentence(cli, tmp_path):
    model = write_depth(tmp_path / "made.onnx", settings="metrik: true")
    error = cli("doctor", model)[2]
    assert error.strip().endswith("made.yaml: 'metrik': this key is unknown; did you mean metric?")


def test_an_image_needs_a_model(cli, tmp_path):
    status, _, error = cli("doctor", "--image", tmp_path / "image.png")
    assert (status, "expected a MODEL" in error) == (2, True)

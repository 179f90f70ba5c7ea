"""`track-range doctor`: its report, and what it says of a broken installation."""

import json
import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from track_range.cli.commands import doctor
from track_range.detection.models import lookup


@pytest.mark.slow
def test_report_as_json(cli):
    status, text, _ = cli("doctor", "--json")
    report = json.loads(text)
    assert (status, report["ok"]) == (0, True)
    assert Path(report["folders"]["package"]).name == "track_range"
    assert set(report) == {"ok", "system", "versions", "inference", "codecs", "extras", "folders", "checks"}
    assert re.match(r"\d+\.\d+", report["versions"]["numpy"])
    assert re.fullmatch(r"\d+\.\d ms per image", report["inference"]["device cpu"])
    assert set(report["checks"].values()) == {"ok"}


def device_results(**tested):
    """A test of devices with these results."""
    return lambda device: doctor._Tested(*tested.get(device, (math.nan, (), f"not available (install {device})")))


@pytest.fixture
def only_quick_checks(monkeypatch):
    """The checks without the run and without running the detector."""
    monkeypatch.setattr(doctor, "tested", device_results(cpu=(10.0, (np.ones(4), np.full(9, 2.0)))))
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
@pytest.mark.parametrize(("other", "is_right"), [(2.08, True), (2.12, False), (math.nan, False)])
def test_devices(cli, monkeypatch, other, is_right):
    """The first output is equal, and the second 4 or 6 % from the CPU's."""
    cpu, cuda = (10.0, (np.ones(4), np.full(9, 2.0))), (1.5, (np.ones(4), np.full(9, other)))
    monkeypatch.setattr(doctor, "tested", device_results(cpu=cpu, cuda=cuda))
    status, text, complaint = cli("doctor", "--json")
    report = json.loads(text)
    assert status == (0 if is_right else 1)
    assert report["inference"]["device cpu"] == "10.0 ms per image"
    assert report["inference"]["device openvino"] == "not available (install openvino)"
    assert report["inference"]["device cuda"].startswith("1.5 ms per image, outputs ")
    assert ("outputs on cuda" in complaint) == (not is_right)
    assert is_right == (report["checks"]["devices"] == "ok")
    if other == 2.08:
        assert report["inference"]["device cuda"].endswith("outputs 4 % from the CPU's")


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

"""`track-range doctor`: its report, and what it says of a broken installation."""

import json
import re
import sys
from pathlib import Path

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
    assert "CPUExecutionProvider" in report["inference"]["providers"]
    assert set(report["checks"].values()) == {"ok"}


@pytest.fixture
def only_quick_checks(monkeypatch):
    """The checks without the run."""
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

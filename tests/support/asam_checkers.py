"""ASAM's checkers of OpenDRIVE and OpenSCENARIO, which have an environment of their own."""

import os
import subprocess
from pathlib import Path
from xml.etree import ElementTree

import pytest

PROJECT = Path(__file__).resolve().parents[2]
_BUNDLES = {".xodr": ("qc_opendrive", "xodrBundle"), ".xosc": ("qc_openscenario", "xoscBundle")}
_CONFIG = (
    '<?xml version="1.0" encoding="UTF-8"?><Config><Param name="InputFile" value="{}"/>'
    '<CheckerBundle application="{}"><Param name="resultFile" value="{}"/></CheckerBundle></Config>'
)


def issues_of(file, tmp_path):
    """Descriptions of the issues that ASAM's checker finds in a file; skips the test without it."""
    program, bundle = _BUNDLES[file.suffix]
    folder = Path(os.environ.get("TRACK_RANGE_VALIDATORS", PROJECT / ".venv" / "validators"))
    checker = folder / "bin" / program
    if not checker.is_file():
        pytest.skip(
            f"ASAM's checkers not available: no {checker} (`make setup` installs it; or set "
            "TRACK_RANGE_VALIDATORS)"
        )
    config, result = tmp_path / "checker.xml", tmp_path / "checker.xqar"
    config.write_text(_CONFIG.format(file, bundle, result))
    subprocess.run([checker, "-c", config], check=True, capture_output=True)
    root = ElementTree.parse(result).getroot()  # noqa: S314 - a file of this test
    states = [checker.get("status") for checker in root.iter("Checker")]
    assert states.count("completed") >= 15
    assert "error" not in states
    return [issue.get("description") for issue in root.iter("Issue")]

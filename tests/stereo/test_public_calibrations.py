"""The table of public kinds of calibrations: every value of the rig is read right."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.support.recordings.calibration_files import CALIBRATIONS, Calibration, differences
from track_range.stereo.rig_formats.reading import load_calibration, load_rig


@pytest.mark.parametrize("row", CALIBRATIONS, ids=lambda row: row.kind)
def test_values(tmp_path: Path, row: Calibration) -> None:
    path = row.write(tmp_path, row.rig)
    rig, _ = load_rig(path, size_px=row.rig.left.size_px)
    assert {name: value for name, value in differences(rig, row.rig).items() if value > 1e-6} == {}
    load_calibration(path)  # rig show without a size


def test_no_kind_twice() -> None:
    assert len({row.kind for row in CALIBRATIONS}) == len(CALIBRATIONS) > 45

"""Tests of the drives with drawn cameras, and of the errors of estimated cameras."""

import numpy as np
import pytest

from benchmarks.accuracy.cameras.self_calibration import _summed, edge_error_px
from benchmarks.inputs.camera_drives import CameraDrive
from track_range.stereo.geometry.camera import PinholeCamera


def test_cameras_differ_from_drive_to_drive_and_stay_the_same_for_a_seed():
    drives = [CameraDrive.drawn("winding", seed) for seed in range(700, 720)]
    assert drives[3].rig.left == CameraDrive.drawn("winding", 703).rig.left
    fields_deg = [
        2 * np.degrees(np.arctan(drive.rig.left.width_px / 2 / drive.rig.left.fx_px))
        for drive in drives
    ]
    assert 44 < min(fields_deg) < 55
    assert 85 < max(fields_deg) < 96
    spread = np.std([np.log(drive.car_size) for drive in drives])
    assert 0.04 < spread < 0.11
    assert all(14 < drive.turn_deg < 65 for drive in drives)
    assert CameraDrive.drawn("town", 700).turn_deg == 0.0


def test_wide_lens_sees_110_degrees():
    camera = CameraDrive.wide(700).rig.left
    middle_px = (camera.height_px - 1) / 2
    left, right = camera.recorded_rays(np.array([[0.0, middle_px], [1279.0, middle_px]]))
    assert np.degrees(np.arccos(left @ right)) == pytest.approx(110.0, abs=0.1)


def test_edge_error_of_a_focal_length_that_is_a_hundredth_too_long():
    true = PinholeCamera.of_focal_length(1000.0, (1280, 720))
    found = PinholeCamera.of_focal_length(1010.0, (1280, 720))
    assert edge_error_px(true, true) == pytest.approx(0.0, abs=1e-9)
    # The edges are 639.5 px from the middle, and at most 734 px with their ends.
    assert 6.39 < edge_error_px(true, found) < 7.35


def test_groups_have_medians_of_drives_and_fractions_of_rows():
    def drive(log_error, n, n_2):
        counts = {"rows": n, "known": n, "1_sigma": n_2, "2_sigma": n_2}
        quantities = {
            f"{name}_{key}": value
            for name, unit in (
                ("fused", "pct"),
                ("stereo", "pct"),
                ("closing", "mps"),
                ("ego", "mps"),
            )
            for key, value in {**counts, f"median_{unit}": 2.0, f"sigma_{unit}": 1.0}.items()
        }
        return {"log_error": log_error, "sigma": 0.02, "open_s": 1.0, **quantities}

    figures = _summed([drive(0.01, 100, 90), drive(-0.03, 300, 270), drive(0.05, 100, 40)])
    assert figures["focal_median_pct"] == pytest.approx(3.0)
    assert figures["focal_bias_pct"] == pytest.approx(1.0)
    assert figures["focal_within_1_sigma"] == pytest.approx(1 / 3)
    assert figures["focal_within_2_sigma"] == pytest.approx(2 / 3)
    assert figures["fused_within_2_sigma"] == 0.8

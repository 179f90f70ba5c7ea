"""Tests of camera faults, each measured on the images."""

from functools import cache

import cv2
import numpy as np
import pytest

from track_range.recording.sources.open_video import open_video
from track_range.simulation.camera.fault_options import Faults
from track_range.simulation.camera.faults import kept_frames, rig_in_file
from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import Renderer, kitti_like_rig, noise_steps
from track_range.simulation.settings import DriveOptions
from track_range.simulation.world.scenarios import make_scenario
from track_range.stereo.geometry.rig import StereoRig

RIG = kitti_like_rig(width_px=620, height_px=188)
SMALL = kitti_like_rig(width_px=310, height_px=94)


@pytest.fixture(scope="module")
def scene():
    return make_scenario("city", seed=1, seconds=1.0)


@cache
def right(scene, *, is_large=False, **faults):
    """The right image, float64, without noise; a rig is not hashable, so its size is the
    argument."""
    rig = RIG if is_large else SMALL
    return (
        Renderer(scene, rig, noise_grey=0, faults=Faults(**faults))
        .render(0.2, side="right")
        .astype(np.float64)
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("faults", "expected"),
    [({"row_offset_px": 1.5}, (0.0, 1.5)), ({"disparity_offset_px": 2.25}, (-2.25, 0.0))],
)
def test_offsets_shift_the_right_image(scene, faults, expected):
    plain, moved = (right(scene, is_large=True, **values).mean(axis=2) for values in ({}, faults))
    offsets = np.arange(-0.3, 0.31, 0.02)
    for axis in (0, 1):
        costs = []
        for offset in offsets:
            shift = np.array([[1.0, 0, expected[0]], [0, 1.0, expected[1]]])
            shift[axis, 2] += offset
            warped = cv2.warpAffine(plain, shift, plain.shape[::-1], flags=cv2.INTER_CUBIC)
            costs.append(np.square(warped - moved)[10:-10, 10:-10].mean())
        assert offsets[int(np.argmin(costs))] == pytest.approx(0, abs=0.05)


@pytest.mark.slow
def test_faults_do_not_change_the_left_image(scene):
    faults = Faults(gain=1.3, row_offset_px=2, disparity_offset_px=1, late_s=0.1)
    plain, faulty = (
        Renderer(scene, SMALL, faults=value).render(0.2) for value in (Faults(), faults)
    )
    np.testing.assert_array_equal(plain, faulty)


@pytest.mark.slow
def test_gain_of_the_right_image(scene):
    plain, bright = right(scene), right(scene, gain=1.25)
    inside = (plain > 20) & (plain < 200)
    np.testing.assert_allclose(bright[inside], 1.25 * plain[inside], atol=1)


@pytest.mark.slow
def test_blur_reduces_detail(scene):
    sharp, blurred = (
        cv2.Laplacian(image, cv2.CV_64F).std()
        for image in (right(scene), right(scene, blur_px=1.5))
    )
    assert blurred < 0.4 * sharp


@pytest.mark.slow
def test_rain_streaks_have_disparities(scene):
    dry, wet = (
        [
            Renderer(scene, RIG, noise_grey=0, faults=Faults(rain=rain)).render(0.2, side=side)
            for side in ("left", "right")
        ]
        for rain in (0.0, 0.6)
    )
    streaks = [np.abs(w.astype(int) - d).max(axis=2) > 6 for w, d in zip(wet, dry, strict=True)]
    assert 0.01 < streaks[0].mean() < 0.5
    rows, columns = (np.abs(np.diff(streaks[0].astype(int), axis=axis)).sum() for axis in (0, 1))
    assert columns > 1.5 * rows  # taller than wide
    assert (streaks[0] ^ streaks[1]).mean() > 0.01


@pytest.mark.parametrize("sigma", [1.0, 2.0, 12.0, 40.0])
def test_standard_deviation_of_noise(sigma):
    steps = noise_steps(sigma).astype(float)
    assert steps.std() == pytest.approx(np.hypot(sigma, 0.29), rel=0.03)
    assert abs(steps.mean()) < 0.01


@pytest.mark.slow
def test_late_right_camera_keeps_its_timestamps(tmp_path):
    drive = write_drive(
        tmp_path, scenario="highway", seconds=0.2, rig=SMALL, options=DriveOptions(late_s=0.5)
    )
    frames = list(open_video(drive.right))
    assert [frame.time_s for frame in frames] == pytest.approx([0.0, 0.1], abs=1e-4)
    renderer = Renderer(make_scenario("highway", seconds=0.2), SMALL, noise_grey=0)
    grey = frames[0].image.astype(float).mean(axis=2)
    later, now = (
        np.abs(grey - renderer.render(t, side="right").mean(axis=2)).mean() for t in (0.5, 0.0)
    )
    assert later < 0.5 * now


@pytest.mark.slow
def test_dropped_frames_leave_gaps_in_time(tmp_path):
    options = DriveOptions(drop_fraction=0.4, noise_grey=0)
    drive = write_drive(tmp_path, seed=5, seconds=2.0, rig=SMALL, options=options)
    left_s, right_s = (
        [frame.time_s for frame in open_video(path)] for path in (drive.left, drive.right)
    )
    assert 6 <= len(left_s) <= 18
    assert left_s != right_s
    assert left_s[0] == right_s[0] == 0.0
    rows = [line.split(",") for line in drive.table.read_text().splitlines()[1:]]
    times = {int(row[0]): float(row[1]) for row in rows}
    assert [times[frame] for frame in sorted(times)] == pytest.approx(left_s, abs=1e-3)
    speeds = [float(line.split(",")[0]) for line in drive.ego_speed.read_text().splitlines()[1:]]
    assert speeds == pytest.approx(left_s, abs=1e-3)


@pytest.mark.parametrize("fraction", [0.0, 0.1, 0.5])
def test_share_of_dropped_frames(fraction):
    left, kept = (
        kept_frames(Faults(drop_fraction=fraction), 4000, 3, is_right=right)
        for right in (False, True)
    )
    assert kept[0] == 0
    assert 1 - len(kept) / 4000 == pytest.approx(fraction, abs=0.03)
    assert kept != left or fraction == 0


def test_errors_of_a_wrong_rig():
    rig = StereoRig.rectified(SMALL.left, 0.5)
    baseline, focal, principal, correct = (
        rig_in_file(rig, Faults(wrong_rig=name))
        for name in ("baseline", "focal", "principal", None)
    )
    assert baseline.baseline_m == pytest.approx(0.525)
    assert focal.left.fx_px == pytest.approx(1.04 * rig.left.fx_px)
    assert principal.left.cx_px == pytest.approx(rig.left.cx_px + 15)
    assert correct.left == rig.left

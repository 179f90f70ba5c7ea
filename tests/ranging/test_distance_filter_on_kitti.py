"""Distance filter on real motion: labelled cars, ranged by box height, without noise and with 2 px
of noise."""

import numpy as np
import pytest

from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.truth.reference_distance import surface_distance_m

FOCAL_PX, CENTRE_PX, STEP_S, HEIGHT_M = 721.5377, np.array([609.5593, 172.854]), 0.1036, 1.55
REACH = 5
"""Number of frames before and after, half a second, for the true speed."""


class Cars:
    """Fully visible cars at 10-90 m of one sequence, frame by frame."""

    def __init__(self, path):
        labels = read_kitti(path)
        labels = labels.select(
            (labels.kitti_type == "Car")
            & (labels.truncated == 0)
            & (labels.occluded <= 1)
            & labels.has_3d_box
        )
        centre = (labels.xyxy_px[:, :2] + labels.xyxy_px[:, 2:]) / 2
        rays = np.concatenate([(centre - CENTRE_PX) / FOCAL_PX, np.ones((len(labels), 1))], axis=1)
        true_m = surface_distance_m(
            rays,
            labels.location_m,
            size_hwl_m=labels.size_hwl_m,
            rotation_y_rad=labels.rotation_y_rad,
        )
        rows = (true_m > 10) & (true_m < 90)
        self.frame, self.track_id, self.true_m = (
            labels.frame[rows],
            labels.track_id[rows] + 1,
            true_m[rows],
        )
        self.height_px = (labels.xyxy_px[:, 3] - labels.xyxy_px[:, 1])[rows]
        at = {
            (int(f), int(i)): d
            for f, i, d in zip(self.frame, self.track_id, self.true_m, strict=True)
        }
        ends = [
            [at.get((int(f) + s, int(i)), np.nan) for s in (-REACH, REACH)] for f, i in self.pairs()
        ]
        self.rate_mps = np.diff(np.array(ends), axis=1)[:, 0] / (2 * REACH * STEP_S)

    def pairs(self):
        return zip(self.frame, self.track_id, strict=True)

    def filtered(self, noise_px):
        """(N,) measured and filtered distances, their sigmas, and rates."""
        height_px = self.height_px + np.random.default_rng(9).normal(
            0, noise_px * np.sqrt(2), len(self.height_px)
        )
        measured_m = FOCAL_PX * HEIGHT_M / np.maximum(height_px, 5)
        sigma_m = measured_m * np.hypot(0.08, 1.5 * np.sqrt(2) / np.maximum(height_px, 5))
        filtered_m, found_sigma_m, rate_mps = np.full((3, len(measured_m)), np.nan)
        one = DistanceFilters({"a": 0.6})
        for number in np.unique(self.frame):
            rows = np.flatnonzero(self.frame == number)
            measured = Ranges(self.track_id[rows], measured_m[rows], sigma_m[rows])
            frame = one.update({"a": measured}, number * STEP_S)["a"]
            filtered_m[rows], found_sigma_m[rows] = frame.ranges.distance_m, frame.ranges.sigma_m
            rate_mps[rows] = frame.rate_mps
        return measured_m, filtered_m, found_sigma_m, rate_mps


@pytest.fixture(scope="module")
def drives(shared_data):
    folder = shared_data / "kitti_labels" / "label_02"
    if not folder.is_dir():
        pytest.skip(f"real data not here: no folder {folder}")
    return [Cars(folder / f"{name}.txt") for name in ("0001", "0009", "0011")]


def figures_of(drives, noise_px):
    """Mean relative errors before and after filtering, shares within 1 and 2 sigma, median closing
    speed error."""
    results = [drive.filtered(noise_px) for drive in drives]
    measured_m, filtered_m, sigma_m, rate_mps = (
        np.concatenate(column) for column in zip(*results, strict=True)
    )
    true_m = np.concatenate([drive.true_m for drive in drives])
    error_mps = rate_mps - np.concatenate([drive.rate_mps for drive in drives])
    in_sigmas = np.abs(filtered_m - true_m) / sigma_m
    return (
        np.mean(np.abs(measured_m / true_m - 1)),
        np.mean(np.abs(filtered_m / true_m - 1)),
        (np.mean(in_sigmas < 1), np.mean(in_sigmas < 2)),
        np.nanmedian(np.abs(error_mps)),
    )


def test_box_noise_is_filtered_out(drives):
    before, after, (within_1, within_2), closing_mps = figures_of(drives, 2.0)
    assert 0.4 < after / before < 0.82
    assert 0.5 < within_1 < 0.85
    assert within_2 > 0.9
    assert closing_mps < 1.0


def test_exact_boxes_are_not_degraded(drives):
    before, after, _, closing_mps = figures_of(drives, 0.0)
    assert 0.95 < after / before < 1.03
    assert closing_mps < 0.6

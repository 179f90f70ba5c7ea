"""Tests of the error model of simulated detections, measured on many frames."""

import numpy as np
import pytest

from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.simulation.camera.playback import Flaws, play_back

SIZE_PX = (1240, 376)
N_FRAMES = 4000


def truth_of(height_px=100.0, *, kitti_type="Car", occluded=0, n_frames=N_FRAMES):
    n = n_frames
    return KittiLabels(
        frame=np.arange(n),
        track_id=np.full(n, 3),
        kitti_type=np.full(n, kitti_type),
        truncated=np.zeros(n),
        occluded=np.full(n, occluded),
        xyxy_px=np.tile([600.0, 150.0, 700.0, 150.0 + height_px], (n, 1)),
        size_hwl_m=np.ones((n, 3)),
        location_m=np.ones((n, 3)),
        rotation_y_rad=np.zeros(n),
        score=np.full(n, np.nan),
    )


def simulated(truth, *, seed=0, **flaws):
    return play_back(
        truth, seed=seed, image_size_px=SIZE_PX, flaws=Flaws(**flaws) if flaws else None
    )


def test_truth_without_flaws():
    truth = truth_of(n_frames=50)
    detections = simulated(
        truth, edge_min_px=0.0, edge_fraction=0.0, miss=0.0, run=0.0, false_per_frame=0.0
    )
    np.testing.assert_array_equal(detections.xyxy_px, truth.xyxy_px)
    np.testing.assert_array_equal(detections.frame, truth.frame)
    assert (detections.track_id == -1).all()
    assert not detections.has_3d_box.any()


def test_edge_errors_have_the_given_sigma():
    detections = simulated(truth_of(), edge_fraction=0.015, false_per_frame=0.0)
    error_px = detections.xyxy_px - (600.0, 150.0, 700.0, 250.0)
    # 1.5 % of 100 px; the standard error of a deviation of 4 x 3900 draws is under 1 %, and of the
    # mean 0.012 px.
    assert error_px.std() == pytest.approx(1.5, rel=0.04)
    assert np.abs(error_px.mean(axis=0)).max() < 0.1


@pytest.mark.parametrize(("height_px", "sigma_px"), [(20.0, 0.7), (220.0, 2.0)])
def test_edge_errors_have_limits(height_px, sigma_px):
    detections = simulated(truth_of(height_px), false_per_frame=0.0)
    assert (detections.xyxy_px[:, 0] - 600).std() == pytest.approx(sigma_px, rel=0.07)


@pytest.mark.parametrize(
    ("height_px", "occluded", "miss"),
    # Large: 0.02. 25 px: 0.25 / 2 more. Partly occluded: 0.12 more.
    [(100.0, 0, 0.02), (25.0, 0, 0.145), (100.0, 1, 0.14)],
)
def test_small_and_occluded_objects_are_missed_more(height_px, occluded, miss):
    detections = simulated(truth_of(height_px, occluded=occluded), run=0.0, false_per_frame=0.0)
    assert 1 - len(detections) / N_FRAMES == pytest.approx(miss, abs=4 * np.sqrt(miss / N_FRAMES))


def test_misses_come_in_runs_of_two_or_three():
    detections = simulated(truth_of(), miss=0.0, run=0.01, false_per_frame=0.0)
    gaps = np.diff(detections.frame) - 1
    gaps = gaps[gaps > 0]
    # A run that starts during another one extends it, which is rare.
    assert np.isin(gaps, (2, 3)).mean() > 0.9
    assert 1 - len(detections) / N_FRAMES == pytest.approx(0.025, abs=0.009)
    assert {2, 3} <= set(gaps.tolist())


def test_runs_end_with_their_track():
    first, second = truth_of(n_frames=300), truth_of(n_frames=300)
    both = KittiLabels(
        *(np.concatenate([getattr(t, f) for t in (first, second)]) for f in KittiLabels.__slots__)
    )
    both = KittiLabels(
        **{f: getattr(both, f) for f in KittiLabels.__slots__ if f != "track_id"}
        | {"track_id": np.repeat([3, 4], 300)}
    )
    detections = simulated(both, miss=0.0, run=0.02, false_per_frame=0.0)
    n_detected = np.bincount(detections.frame, minlength=300)
    # a run of one object does not hide the other
    assert (n_detected == 1).sum() > 5 * max((n_detected == 0).sum(), 1)


@pytest.mark.parametrize(
    ("kitti_type", "expected"),
    [("Van", "Car"), ("Truck", "Truck"), ("Pedestrian", "Pedestrian"), ("Cyclist", "Cyclist")],
)
def test_detected_types(kitti_type, expected):
    detections = simulated(truth_of(kitti_type=kitti_type, n_frames=30), false_per_frame=0.0)
    assert set(detections.kitti_type.tolist()) == {expected}


@pytest.mark.parametrize(("kitti_type", "occluded"), [("DontCare", -1), ("Car", 2)])
def test_dont_care_and_occluded_objects_are_not_detected(kitti_type, occluded):
    assert (
        len(
            simulated(
                truth_of(kitti_type=kitti_type, occluded=occluded, n_frames=50), false_per_frame=0.0
            )
        )
        == 0
    )


def test_rate_and_scores_of_false_detections():
    detections = simulated(truth_of(occluded=2), false_per_frame=0.1)
    assert len(detections) / N_FRAMES == pytest.approx(0.1, abs=0.02)
    assert detections.score.min() >= 0.3
    assert detections.score.max() <= 0.55
    assert (np.diff(detections.frame) >= 0).all()
    assert (detections.xyxy_px[:, 2:] <= np.array(SIZE_PX) - 1).all()
    assert (detections.xyxy_px[:, :2] >= 0).all()


def test_scores_fall_with_size():
    large, small = (
        simulated(truth_of(height), false_per_frame=0.0).score for height in (100.0, 15.0)
    )
    assert min(large.min(), small.min()) >= 0.3
    assert max(large.max(), small.max()) <= 0.95
    assert 0.1 < large.mean() - small.mean() < 0.3


def test_same_seed_gives_the_same_detections():
    truth = truth_of(n_frames=40)
    first, same, other = (simulated(truth, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first.xyxy_px, same.xyxy_px)
    assert not np.array_equal(first.xyxy_px, other.xyxy_px)


def test_no_truth_gives_no_detections():
    assert len(simulated(truth_of(n_frames=0))) == 0

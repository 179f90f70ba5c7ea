"""Scale of an uncalibrated pair, by hand and over many simulated tracks."""

import numpy as np
import pytest

from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.patch_stereo import FocalBaseline, SizeScaledRanger
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.matching.patch_matches import PatchMatches
from track_range.tracking.tracks import Tracks

IMAGE = np.zeros((200, 320, 3), np.uint8)


def by_size(ids, distance_m, sigma=0.05):
    distance_m = np.array(distance_m, float)
    return Ranges(np.array(ids), distance_m, sigma * distance_m)


def tracks_of(*ids):
    n = len(ids)
    return Tracks(
        np.array(ids),
        np.tile([100.0, 60, 200, 140], (n, 1)),
        np.full(n, 2),
        np.ones(n),
        np.ones(n, bool),
    )


def test_unknown_before_the_first_track():
    scale = FocalBaseline()
    scale.learn(np.array([np.nan, 10.0, 2.0]), by_size([1, 2, 3], [10.0, np.nan, 100.0]))
    assert scale.n_tracks == 0
    assert np.isnan(scale.estimate()).all()


def test_one_track_by_hand():
    """30 px at 12 m: K = 360 px m; sigma is 0.08 for the class and 1.25 * 0.15 for one track."""
    scale = FocalBaseline()
    scale.learn(np.array([30.0]), by_size([7], [12.0]))
    focal_baseline, sigma = scale.estimate()
    assert focal_baseline == pytest.approx(360.0)
    assert sigma == pytest.approx(np.hypot(0.08, 1.25 * 0.15))


def test_median_over_many_tracks():
    """Sizes with a scatter of 10 % and every sixth match on the background: the error of K is
    within its sigma."""
    rng = np.random.default_rng(5)
    scale = FocalBaseline()
    for _ in range(12):
        ids = np.arange(1, 31)
        depth_m = 10.0 + ids
        disparity_px = 400.0 / depth_m * np.where(ids % 6 == 0, 0.4, 1.0)
        own = np.exp(0.1 * np.sin(12.9898 * ids) * np.sqrt(2))
        scale.learn(disparity_px, by_size(ids, depth_m * own * np.exp(rng.normal(0, 0.03, 30))))
    focal_baseline, sigma = scale.estimate()
    assert focal_baseline == pytest.approx(400.0, rel=0.08)
    assert focal_baseline != pytest.approx(400.0, rel=1e-6)
    assert 0.08 < sigma < 0.13


def test_weight_of_a_track_is_limited():
    long, short = FocalBaseline(), FocalBaseline()
    for scale, n in ((long, 200), (short, 10)):
        for _ in range(n):
            scale.learn(np.array([20.0]), by_size([1], [20.0]))
        for track_id in (2, 3):
            for _ in range(10):
                scale.learn(np.array([20.0]), by_size([track_id], [16.0]))
    assert long.estimate() == pytest.approx(short.estimate())
    assert long.estimate()[0] == pytest.approx(320.0, rel=0.02)


class FixedMatcher:
    """A matcher that returns given disparities."""

    def __init__(self, *disparity_px):
        self.disparity_px = np.array(disparity_px)

    def match(self, left, right, xyxy_px, prior_px, by_size=None):
        n = len(xyxy_px)
        return PatchMatches.of(self.disparity_px, np.full(n, 0.1), np.zeros(n, np.int64))


def test_track_without_a_size_uses_the_common_scale():
    ranger = SizeScaledRanger(FixedMatcher(24.0, 12.0, -3.0), focal_px=720.0, focal_sigma=0.25)
    frame, tracks = Frame(0, 0.0, IMAGE, IMAGE), tracks_of(1, 2, 3)
    assert np.isnan(ranger.measure(tracks, frame).distance_m).all()
    assert (ranger.notes, ranger.summary()) == ((), {})
    ranges = ranger.measure_with(
        tracks, frame, {"mono": by_size([1, 2, 3], [15.0, np.nan, np.nan])}
    )
    np.testing.assert_allclose(ranges.distance_m, [15.0, 30.0, np.nan])
    scale_sigma = ranger.scale.estimate()[1]
    assert ranges.sigma_m[1] == pytest.approx(30.0 * np.hypot(scale_sigma, np.hypot(0.1, 1.0) / 12))
    learnt = ranger.summary()["learnt_scale"]
    assert learnt == {
        "focal_px": 720.0,
        "baseline_m": pytest.approx(0.5),
        "relative_sigma": pytest.approx(np.hypot(scale_sigma, 0.25)),
        "n_tracks": 1,
    }
    assert "0.50 m" in ranger.notes[0]


def test_nothing_is_measured_without_a_right_image():
    ranges = SizeScaledRanger(FixedMatcher(24.0), focal_px=720.0).measure(
        tracks_of(1), Frame(0, 0.0, IMAGE, None)
    )
    assert np.isnan(ranges.distance_m).all()

from dataclasses import replace

import numpy as np
import pytest

from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.dense_stereo import DenseRanger
from track_range.ranging.methods.patch_stereo import StereoRanger
from track_range.ranging.methods.triangulation import Triangulation, disparities_by_size
from track_range.ranging.size_models.drive_scale import DriveScale, ScaleEvidence
from track_range.stereo.geometry.alignment import UNCORRECTED_SIGMA_PX, Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matcher import PatchMatcher
from track_range.stereo.matching.patch_matches import ExpectedDisparity, Outcome, PatchMatches
from track_range.tracking.tracks import Tracks

RIG = StereoRig.rectified(PinholeCamera(1000.0, 1000.0, 159.5, 99.5, 320, 200), 0.5)


def tracks_of(*ids, box=(100, 60, 200, 140)):
    n = len(ids)
    return Tracks(
        np.array(ids),
        np.tile(np.array(box, float), (n, 1)),
        np.full(n, 2),
        np.ones(n),
        np.ones(n, bool),
    )


def test_depth_and_sigma_by_hand():
    ranges = Triangulation(RIG).ranges(
        tracks_of(1, 2, 3),
        np.array([10.0, -1.0, np.nan]),
        np.array([0.1, 0.1, np.nan]),
        Alignment(residual_px=0.0),
    )
    assert ranges.distance_m[0] == pytest.approx(50.0)  # 1000 px * 0.5 m / 10 px
    assert ranges.sigma_m[0] == pytest.approx(0.5)  # 50^2 / 500 * 0.1
    assert np.isnan(ranges.distance_m[1:]).all()


def test_disparities_are_aligned_before_triangulation():
    """The box centre is column 150, 9.5 px from the axis: the curvature term is (9.5 / 160)^2 of
    that at the edge."""
    alignment = Alignment(offset_px=0.5, curvature_px=-1.6, residual_px=0.4)
    ranges = Triangulation(RIG).ranges(tracks_of(1), np.array([9.5]), np.array([0.3]), alignment)
    disparity_px = 9.5 + 0.5 - 1.6 * (9.5 / 160) ** 2
    assert ranges.distance_m == pytest.approx([500 / disparity_px])
    assert ranges.sigma_m == pytest.approx([500 / disparity_px**2 * 0.5])  # hypot(0.3, 0.4)


@pytest.mark.parametrize(
    ("of_frame_px", "given_px", "disparity_px"),
    [(None, None, 10.5), (0.25, None, 10.25), (0.25, 1.0, 11.0), (None, 1.0, 11.0)],
)
def test_a_given_alignment_comes_first_then_that_of_the_frame_then_that_of_the_rig(
    of_frame_px, given_px, disparity_px
):
    def shift(offset_px):
        return None if offset_px is None else Alignment(offset_px=offset_px, residual_px=0.0)

    rig = replace(RIG, alignment=shift(0.5))
    frame = replace(frame_at(0.0), alignment=shift(of_frame_px))
    ranges = StereoRanger(rig, Recorder(), alignment=shift(given_px)).measure(tracks_of(1), frame)
    assert ranges.distance_m == pytest.approx([500 / disparity_px])


def test_sigma_includes_an_unmeasured_alignment():
    ranges = StereoRanger(RIG, Recorder()).measure(tracks_of(1), frame_at(0.0))
    assert ranges.sigma_m == pytest.approx([50.0**2 / 500 * np.hypot(0.1, UNCORRECTED_SIGMA_PX)])


class Recorder:
    """A matcher that returns 10 px for every box and records the priors and the disparities by
    size."""

    def __init__(self):
        self.priors = []
        self.by_size = None

    def match(self, left, right, xyxy_px, prior_px, by_size=None):
        self.priors.append(prior_px.tolist())
        self.by_size = by_size
        n = len(xyxy_px)
        return PatchMatches.of(np.full(n, 10.0), np.full(n, 0.1), np.zeros(n, np.int64))


def frame_at(time_s, right=True):
    image = np.zeros((200, 320, 3), np.uint8)
    return Frame(round(10 * time_s), time_s, image, image if right else None)


def test_prior_is_the_last_disparity_until_it_expires():
    matcher = Recorder()
    ranger = StereoRanger(RIG, matcher)
    ranger.measure(tracks_of(1), frame_at(0.0))
    ranger.measure(tracks_of(2, 1), frame_at(0.1))
    ranger.measure(tracks_of(2), frame_at(0.2))
    ranger.measure(tracks_of(1, 2), frame_at(1.15))
    np.testing.assert_equal(matcher.priors, [[np.nan], [np.nan, 10.0], [10.0], [np.nan, np.nan]])


def test_full_range_is_searched_every_second():
    matcher = Recorder()
    ranger = StereoRanger(RIG, matcher)
    for step in range(25):
        ranger.measure(tracks_of(1), frame_at(step * 0.1))
    assert [i for i, prior in enumerate(matcher.priors) if np.isnan(prior[0])] == [0, 11, 22]


def test_predicted_boxes_are_not_measured():
    tracks = tracks_of(1, 2)
    hidden = Tracks(
        tracks.track_id, tracks.xyxy_px, tracks.class_id, tracks.score, np.array([True, False])
    )
    matcher = Recorder()
    ranges = StereoRanger(RIG, matcher).measure(hidden, frame_at(0.0))
    np.testing.assert_allclose(ranges.distance_m, [50.0, np.nan])
    assert len(matcher.priors[0]) == 1


def test_nothing_is_measured_without_a_right_image():
    assert np.isnan(
        StereoRanger(RIG, Recorder()).measure(tracks_of(1), frame_at(0.0, right=False)).distance_m
    ).all()
    dense = DenseRanger(RIG)
    assert np.isnan(dense.measure(tracks_of(1), frame_at(0.0, right=False)).distance_m).all()
    dense.close()


def test_dense_ranging_of_a_textured_wall():
    noise = np.random.default_rng(0).integers(0, 255, (200, 360), np.uint8)
    grey = [np.ascontiguousarray(noise[:, shift : shift + 320]) for shift in (0, 20)]
    left, right = (np.repeat(image[:, :, None], 3, axis=2) for image in grey)
    dense = DenseRanger(RIG)
    frame = Frame(0, 0.0, left, right)
    dense.start(frame)
    ranges = dense.measure(tracks_of(1), frame)
    dense.close()
    assert ranges.distance_m == pytest.approx([25.0], rel=0.01)  # 500 / 20 px
    assert dense.background_s > 0


def test_dense_sigma_includes_the_alignment():
    left = np.random.default_rng(0).integers(0, 255, (200, 320, 3), np.uint8)
    same = Frame(0, 0.0, left, np.roll(left, -20, axis=1))
    ranges = []
    for residual_px in (1.5, 0.0):
        dense = DenseRanger(RIG, alignment=Alignment(residual_px=residual_px))
        ranges.append(dense.measure(tracks_of(1), same))
        dense.close()
    assert ranges[0].distance_m == pytest.approx(ranges[1].distance_m)
    assert ranges[0].sigma_m[0] > 3 * ranges[1].sigma_m[0]


def test_unmatched_boxes_are_counted_by_reason():
    ranger = StereoRanger(RIG, PatchMatcher())
    for step in range(2):
        # black images
        assert np.isnan(ranger.measure(tracks_of(1, 2), frame_at(0.1 * step)).distance_m).all()
    assert ranger.outcomes == {Outcome.NO_TEXTURE: 4}


def test_disparities_by_size():
    """500 px m at 25 m are 20 px; the relative sigma is that of the distance, and larger for boxes
    cut by a border."""
    boxes = np.array(
        [
            [100, 60, 200, 140],
            [0, 60, 90, 140],
            [230, 60, 319, 140],
            [100, 0, 200, 90],
            [100, 90, 200, 199],
        ],
        float,
    )
    by_size = Ranges(np.arange(5), np.full(5, 25.0), np.full(5, 2.5))
    expected = disparities_by_size(by_size, boxes, RIG, (200, 320))
    np.testing.assert_allclose(expected.disparity_px, 20.0)
    np.testing.assert_allclose(expected.log_sigma, [0.1] + [np.hypot(0.1, 0.4)] * 4)
    unknown = disparities_by_size(
        Ranges(np.array([1]), *np.full((2, 1), np.nan)), boxes[:1], RIG, (200, 320)
    )
    assert np.isnan(unknown.disparity_px).all()


def test_sizes_of_observed_tracks_are_passed_on():
    tracks = tracks_of(1, 2, 3)
    observed = np.array([True, False, True])
    tracks = Tracks(tracks.track_id, tracks.xyxy_px, tracks.class_id, tracks.score, observed)
    mono = Ranges(np.array([1, 2, 3]), np.array([25.0, 10.0, np.nan]), np.array([2.5, 1.0, np.nan]))
    matcher = Recorder()
    ranges = StereoRanger(RIG, matcher).measure_with(tracks, frame_at(0.0), {"mono": mono})
    np.testing.assert_allclose(matcher.by_size.disparity_px, [20.0, np.nan])
    np.testing.assert_allclose(ranges.distance_m, [50.0, np.nan, 50.0])
    StereoRanger(RIG, matcher).measure(tracks, frame_at(0.0))
    assert matcher.by_size is None


def test_stereo_measures_the_scale_of_the_drive():
    """Sizes say 40 m where stereo measures 50 m: a factor of 1.25, of which each class gets a
    part."""
    scale = DriveScale()
    ranger = StereoRanger(RIG, Recorder())
    tracks = tracks_of(*range(1, 9))
    by_size_m = np.full(8, 40.0)
    for k in range(5):
        by_size = Ranges(tracks.track_id, by_size_m, 0.08 * by_size_m)
        mono = scale.corrected(by_size, tracks.class_id)
        evidence = ranger.measure_at_scale(
            tracks, frame_at(0.1 * k), {"mono": mono}, scale
        ).evidence
        scale = scale.after([ScaleEvidence(tracks.class_id, by_size), evidence], 0.1 * k)
    assert 1.15 < mono.distance_m[0] / 40.0 < 1.25


def test_matched_boxes_are_counted_by_surfaces():
    class SurfaceMatcher(Recorder):
        """A matcher that returns 10 px and other numbers of surfaces; the last box has no match."""

        def match(self, *arguments):
            matches = super().match(*arguments)
            matches.n_surfaces[:] = [1, 2, 2, 3][: len(matches.n_surfaces)]
            matches.probability[:] = [1.0, 0.9, 0.7, 0.4][: len(matches.n_surfaces)]
            matches.disparity_px[3:] = np.nan
            return matches

    ranger = StereoRanger(RIG, SurfaceMatcher())
    assert ranger.matches is None
    for step in range(2):
        ranges = ranger.measure(tracks_of(1, 2, 3, 4), frame_at(0.1 * step))
    np.testing.assert_array_equal(ranges.details["surfaces"], [1, 2, 2, np.nan])
    np.testing.assert_array_equal(ranges.details["probability"], [1.0, 0.9, 0.7, np.nan])
    without = ranger.measure(tracks_of(1, 2, 3, 4), replace(frame_at(0.2), right=None))
    assert (len(without.details), without.distance_m.tolist()) == (
        0,
        pytest.approx([np.nan] * 4, nan_ok=True),
    )
    assert ranger.summary()["stereo_surfaces"] == {"1": 2, "2": 4}
    assert ranger.matches.n_surfaces.tolist() == [1, 2, 2, 3]
    assert StereoRanger(RIG, Recorder()).summary() == {
        "stereo_unmatched": {},
        "stereo_surfaces": {},
    }


def test_results_of_some_boxes_are_replaced():
    matches = PatchMatches.of(
        np.full(3, np.nan), np.full(3, np.nan), np.full(3, int(Outcome.NO_FIT))
    )
    assert (matches.n_surfaces.tolist(), np.isnan(matches.probability).all()) == ([0, 0, 0], True)
    better = PatchMatches(
        np.array([9.0]), np.array([0.2]), np.array([0]), np.array([2]), np.array([0.8])
    )
    matches.put(np.array([1]), better)
    np.testing.assert_equal(matches.disparity_px, [np.nan, 9.0, np.nan])
    np.testing.assert_equal(matches.probability, [np.nan, 0.8, np.nan])
    assert (matches.outcome.tolist(), matches.n_surfaces.tolist()) == ([7, 0, 7], [0, 2, 0])


def test_expected_disparities_of_some_boxes():
    expected = ExpectedDisparity(np.array([10.0, 20.0, 30.0]), np.array([0.1, 0.2, 0.3])).select(
        np.array([2, 0])
    )
    assert (expected.disparity_px.tolist(), expected.log_sigma.tolist()) == (
        [30.0, 10.0],
        [0.3, 0.1],
    )
    assert np.isnan(ExpectedDisparity.unknown(2).disparity_px).tolist() == [True, True]

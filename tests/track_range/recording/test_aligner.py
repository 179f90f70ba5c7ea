"""The aligner of a pair: which frames it returns, with which alignment and right image, for frames
that are read ahead and for frames that come one by one."""

import time
from collections.abc import Iterable
from dataclasses import replace

import numpy as np
import pytest

from tests.support.images.rendered_pairs import RIG as SLOW_RIG, of_drive, shifted, turned
from tests.track_range.recording.road_pairs import RIG, road
from track_range.foundation.background import InProcess
from track_range.recording.cameras.auto_alignment import PairAlignment, given_alignment
from track_range.recording.cameras.calibration import RecordingCalibration, calibration_of
from track_range.recording.pairs.aligner import (
    LIVE,
    ONE_BY_ONE,
    RECORDED,
    AlignedFrame,
    PairAligner,
)
from track_range.recording.pairs.pair_monitor import MAX_CHECKED_PAIRS
from track_range.recording.video.frame import RecordedFrame
from track_range.stereo.geometry.alignment import UNCALIBRATED_SIGMA_PX, Alignment
from track_range.stereo.geometry.rig import RigError, StereoRig

GIVEN = PairAlignment(measured=Alignment(offset_px=6.3, residual_px=0.1), is_applied=True, rig=RIG)


def calibrated(rig: StereoRig = RIG) -> RecordingCalibration:
    return calibration_of(rig, (rig.left.size_px, rig.right.size_px))


def standing(n: int, *, step_s: float = 1.0, is_swapped: bool = False) -> list[RecordedFrame]:
    images = (road(-1), road(1))
    pair = images[::-1] if is_swapped else images
    return [RecordedFrame(number, number * step_s, pair) for number in range(n)]


def looked(aligner: PairAligner, recorded: Iterable[RecordedFrame]) -> int:
    """Reads ahead until the aligner can start; the number of times the first frames were read."""
    n_looks = 0
    while aligner.is_looking:
        n_looks += 1
        for frame in recorded:
            if not aligner.look(frame):
                break
        aligner.start()
    return n_looks


def stepped(aligner: PairAligner, recorded: Iterable[RecordedFrame]) -> list[AlignedFrame]:
    results = []
    for frame in recorded:
        results += aligner.add(frame)
        aligner.estimate()
    aligner.use_estimates()
    return results


def test_frames_one_by_one_have_no_right_image_until_the_pair_is_explained() -> None:
    aligner = PairAligner(calibrated(), ONE_BY_ONE)
    results = stepped(aligner, standing(MAX_CHECKED_PAIRS + 1))
    assert [one.frame.right is not None for one in results] == [False] * 9 + [True] * 2
    assert [one.finding is not None for one in results] == [False] * 9 + [True] * 2
    assert results[-1].finding is not None
    assert results[-1].finding.fault == "fits"
    # the vehicle stands, so that the alignment is not known
    assert aligner.calibration.alignment is None
    assert {one.frame.alignment for one in results} == {None}


def test_a_given_alignment_needs_no_explanation_of_a_first_pair_that_looks_right() -> None:
    aligner = PairAligner(calibrated(), ONE_BY_ONE, GIVEN)
    results = stepped(aligner, standing(3))
    assert [one.frame.right is not None for one in results] == [True] * 3
    # 6 px are corrected by the rectification
    assert results[0].frame.alignment == replace(
        GIVEN.measured, offset_px=GIVEN.measured.offset_px - 6
    )
    assert aligner.calibration.alignment == GIVEN


@pytest.mark.slow
def test_nobody_waits_for_the_check_in_a_process() -> None:
    background = InProcess()
    aligner = PairAligner(calibrated(), ONE_BY_ONE, background=background)
    first, *_ = results = stepped(aligner, standing(1))
    assert (first.frame.right, first.finding) == (None, None)
    for again in range(1, 600):
        results = stepped(aligner, [replace(one, time_s=again) for one in standing(1)])
        if aligner.finding is not None:
            break
        time.sleep(0.1)
    background.close()
    assert results[-1].finding is not None
    assert results[-1].finding.fault == "fits"
    assert results[-1].frame.right is not None


def test_a_given_alignment_and_a_black_first_image() -> None:
    (first, *rest) = standing(3)
    black = replace(first, images=(first.images[0], np.zeros_like(first.images[1])))
    aligner = PairAligner(calibrated(), ONE_BY_ONE, GIVEN)
    assert {one.frame.right for one in stepped(aligner, [black, *rest])} == {None}


@pytest.mark.parametrize("policy", [RECORDED, LIVE])
def test_frames_that_are_read_ahead_are_all_returned_with_their_alignment(policy) -> None:
    recorded = standing(12, step_s=0.1)
    aligner = PairAligner(calibrated(), policy)
    assert looked(aligner, recorded) == 1
    frames = list(aligner.frames(recorded))
    assert [frame.index for frame in frames] == list(range(12))
    assert all(frame.right is not None for frame in frames)
    assert aligner.finding is not None
    assert aligner.finding.fault == "fits"
    (alignment,) = {frame.alignment for frame in frames}
    assert alignment is not None
    assert "stationary" in alignment.source
    assert aligner.notes == ()


def test_one_look_at_a_given_alignment_and_none_without_checks() -> None:
    recorded = standing(12, step_s=0.1)
    assert looked(PairAligner(calibrated(), RECORDED, GIVEN), recorded) == 1
    unchecked = PairAligner(calibrated(), replace(RECORDED, has_checks=False), GIVEN)
    assert (unchecked.is_looking, unchecked.sync, unchecked.finding) == (False, None, None)
    assert next(unchecked.frames(recorded)).alignment == GIVEN.of_frames


def test_swapped_images_are_an_error_read_ahead_and_one_by_one() -> None:
    recorded = standing(MAX_CHECKED_PAIRS, is_swapped=True)
    with pytest.raises(RigError, match="swap the two videos"):
        looked(PairAligner(calibrated(), RECORDED), recorded)
    with pytest.raises(RigError, match="stereo-layout"):
        looked(PairAligner(calibrated(), RECORDED, is_packed=True), recorded)
    aligner = PairAligner(calibrated(), ONE_BY_ONE)
    with pytest.raises(RigError, match="swap the two videos"):
        stepped(aligner, recorded)
    with pytest.raises(RigError, match="swap the two videos"):  # and with each later frame
        aligner.add(replace(recorded[-1], index=20, time_s=20.0))


def test_rows_of_a_standing_pair_are_corrected_before_the_estimate() -> None:
    images = (road(-1), road(1, 5))
    recorded = [RecordedFrame(number, number / 10, images) for number in range(12)]
    aligner = PairAligner(calibrated(), RECORDED)
    assert looked(aligner, recorded) == 2  # the second time with the correction
    assert aligner.calibration.alignment is not None
    assert aligner.calibration.alignment.measured.row_offset_px == pytest.approx(5.0, abs=0.3)
    assert aligner.notes == ()  # the note on rows is that of the calibration


def without_rig(rig: StereoRig) -> RecordingCalibration:
    calibration = calibrated(rig)
    assert calibration.rig is not None
    return replace(calibration, rig=replace(calibration.rig, baseline_sigma=1.0))


def test_a_standing_pair_without_a_rig_gets_equal_rows_and_a_wide_error() -> None:
    images = (road(-1), road(1, 5))
    recorded = [RecordedFrame(number, number / 10, images) for number in range(12)]
    aligner = PairAligner(without_rig(RIG), RECORDED)
    assert looked(aligner, recorded) == 2
    alignment = next(aligner.frames(recorded)).alignment
    assert alignment is not None
    assert alignment.row_offset_px == pytest.approx(5.0, abs=0.3)
    assert alignment.residual_px == UNCALIBRATED_SIGMA_PX


@pytest.mark.slow
def test_a_pair_without_a_rig_is_aligned_by_its_motion() -> None:
    recorded = drive_after_a_stop(4.0)[60:]
    aligner = PairAligner(without_rig(SLOW_RIG), RECORDED)
    looked(aligner, recorded)
    alignment = aligner.calibration.alignment
    assert alignment is not None
    assert alignment.applied.offset_px == pytest.approx(-4.0, abs=0.3)
    assert alignment.applied.residual_px < 0.5


def test_images_of_other_scenes_without_a_rig_are_not_matched() -> None:
    rng = np.random.default_rng(3)
    size = (RIG.left.height_px, RIG.left.width_px, 3)
    noise = rng.integers(0, 255, (2, *size), np.uint8)
    recorded = [RecordedFrame(number, number / 10, (noise[0], noise[1])) for number in range(12)]
    aligner = PairAligner(without_rig(RIG), RECORDED)
    looked(aligner, recorded)
    assert aligner.calibration.rig is None
    assert aligner.notes == ()  # the calibration has the note


def drive_after_a_stop(offset_px: float) -> list[RecordedFrame]:
    """6 s at rest, then some in motion, with disparities that are too large."""
    pairs = [(left, shifted(right, -offset_px)) for left, right in of_drive()]
    pairs = [pairs[0]] * 60 + (pairs + pairs[-2:0:-1]) * 2
    return [RecordedFrame(number, number / 10, pair) for number, pair in enumerate(pairs)]


@pytest.mark.slow
def test_an_error_found_after_a_stop_is_corrected_one_by_one_and_ends_stereo_of_others() -> None:
    recorded = drive_after_a_stop(30.0)
    aligner = PairAligner(calibrated(SLOW_RIG), ONE_BY_ONE)
    results = stepped(aligner, recorded)
    faults = [None if one.finding is None else one.finding.fault for one in results]
    at = faults.index("verged")
    assert at > 60
    assert [one.frame.right is not None for one in results[at - 1 : at + 2]] == [True, False, True]
    # corrected by the rectification from the next frame on
    assert results[at].calibration.rectifier is results[0].calibration.rectifier
    assert results[at + 1].calibration.rectifier is not results[0].calibration.rectifier
    corrected = results[at + 1].calibration.alignment
    assert corrected is not None
    assert corrected.measured.offset_px == pytest.approx(-30.0, abs=4.0)
    assert "corrected" in " ".join(aligner.notes)

    ahead = PairAligner(calibrated(SLOW_RIG), replace(LIVE, has_checks=True))
    looked(ahead, recorded[:50])
    frames = list(ahead.frames(recorded))
    assert [frame.right is not None for frame in frames[at - 1 : at + 2]] == [True, False, False]
    assert "found only after the vehicle moved" in " ".join(ahead.notes)


@pytest.mark.slow
def test_images_that_are_upside_down_are_turned_back() -> None:
    pairs = [(turned(left), turned(right)) for left, right in of_drive()]
    recorded = [RecordedFrame(number, number / 10, pair) for number, pair in enumerate(pairs)]
    ahead = PairAligner(calibrated(SLOW_RIG), RECORDED)
    assert looked(ahead, recorded) == 2
    np.testing.assert_array_equal(next(ahead.frames(recorded)).left, of_drive()[0][0])
    given = given_alignment("off", SLOW_RIG)
    for aligner in (
        PairAligner(calibrated(SLOW_RIG), ONE_BY_ONE, given),
        PairAligner(calibrated(SLOW_RIG), ONE_BY_ONE),
    ):
        results = stepped(aligner, [*recorded, replace(recorded[0], index=9, time_s=0.9)])
        assert [one.frame.right is None for one in results[6:]] == [True, False]
        np.testing.assert_array_equal(results[-1].frame.left, of_drive()[0][0])


@pytest.mark.slow
def test_a_refused_pair_has_no_stereo() -> None:
    recorded = [
        RecordedFrame(number, number / 10, (left, left.copy()))
        for number, (left, _) in enumerate(of_drive())
    ]
    ahead = PairAligner(calibrated(SLOW_RIG), RECORDED)
    looked(ahead, recorded)
    assert ahead.calibration.rig is None
    results = stepped(PairAligner(calibrated(SLOW_RIG), ONE_BY_ONE), recorded)
    assert results[-1].finding is not None
    assert results[-1].finding.fault == "refused"
    assert {one.frame.right for one in results} == {None}

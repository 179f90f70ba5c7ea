"""Explanations of faulty pairs: a rendered drive with each fault, and KITTI's drives and pairs in
both orders."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.images.rendered_pairs import (
    RIG,
    Pairs,
    mirrored,
    of_drive,
    rendered,
    shifted,
    turned,
    warped,
)
from track_range.foundation.arrays import Image
from track_range.recording.pairs.pair_monitor import PairMonitor
from track_range.recording.recording import open_recording
from track_range.stereo.alignment.pair_evidence import Motion, PairEvidence
from track_range.stereo.alignment.pair_finding import PairFinding, find_fault
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_rig


def yawed(image: Image, deg: float) -> Image:
    k = RIG.right.matrix
    return warped(
        image, k @ cv2.Rodrigues(np.array([0.0, math.radians(deg), 0.0]))[0] @ np.linalg.inv(k)
    )


def found(pairs: Pairs, rig: StereoRig = RIG) -> PairFinding:
    evidence = PairEvidence(rig.left)
    for left, right in pairs:
        evidence.add(left, right)
    return find_fault(evidence.figures(), rig)


@pytest.mark.slow
def test_true_pair_fits() -> None:
    assert found(of_drive()) == PairFinding("fits")


@pytest.mark.slow
@pytest.mark.parametrize("offset_px", [-30.0, -12.0, 15.0, 30.0])
def test_shifted_images_are_corrected(offset_px: float) -> None:
    finding = found([(left, shifted(right, -offset_px)) for left, right in of_drive()])
    assert finding.fault == "verged"
    assert finding.prior.yaw_deg == 0.0
    assert finding.prior.offset_px == pytest.approx(-offset_px, abs=2 * finding.prior.residual_px)
    assert 1.0 < finding.prior.residual_px < 4.0


@pytest.mark.slow
@pytest.mark.parametrize("offset_px", [-41.0, 41.0])
def test_offset_that_far_points_do_not_have_is_no_fault(offset_px: float) -> None:
    """As a near bus that moves causes, in whose frame most points are."""
    evidence = PairEvidence(RIG.left)
    for left, right in of_drive():
        evidence.add(left, right)
    motion = Motion(1500, 6, 0.46, offset_px, 1.0, 0.08)
    assert (
        find_fault(replace(evidence.figures(), motion=motion, turned_motion=None), RIG).fault
        == "fits"
    )


@pytest.mark.slow
@pytest.mark.parametrize("yaw_deg", [-3.0, 3.0])
def test_turned_camera_is_corrected(yaw_deg: float) -> None:
    finding = found([(left, yawed(right, yaw_deg)) for left, right in of_drive()])
    assert finding.fault == "verged"
    assert finding.prior.yaw_deg == pytest.approx(-yaw_deg, abs=0.35)
    assert "the right camera is turned by" in finding.sentence


@pytest.mark.slow
def test_rows_are_corrected_without_a_message() -> None:
    finding = found([(left, shifted(right, 0.0, 8.0)) for left, right in of_drive()])
    assert (finding.fault, finding.sentence) == ("fits", "")
    assert finding.prior.row_offset_px == pytest.approx(8.0, abs=0.2)


@pytest.mark.slow
def test_swapped_videos_and_videos_upside_down_differ() -> None:
    assert found([(right, left) for left, right in of_drive()]).fault == "swapped"
    assert found([(turned(left), turned(right)) for left, right in of_drive()]).fault == "turned"


@pytest.mark.slow
def test_swapped_videos_of_a_standing_vehicle() -> None:
    left, right = of_drive()[0]
    assert found([(left, right)] * 3).fault == "fits"
    assert found([(right, left)] * 3).fault == "swapped"
    assert found([(turned(left), turned(right))] * 3).fault == "turned"
    # without motion, other faults look the same
    assert not found([(left, shifted(right, 25.0))] * 3).has_stereo


@pytest.mark.slow
@pytest.mark.parametrize(("offset_px", "fault"), [(0.0, "fits"), (30.0, "verged")])
def test_the_first_motion_after_a_stop_is_checked_again(offset_px: float, fault: str) -> None:
    pairs = [(left, shifted(right, -offset_px)) for left, right in of_drive()]
    monitor = PairMonitor(RIG)
    for number in range(60):  # 6 s at rest
        monitor.add(Frame(number, number / 10, *pairs[0]))
    assert monitor.finding == PairFinding("fits")
    for number, (left, right) in enumerate((pairs + pairs[-2:0:-1]) * 3, 61):
        monitor.add(Frame(number, number / 10, left, right))
    assert monitor.finding.fault == fault
    assert ("px too large" in monitor.finding.sentence) == (fault == "verged")


@pytest.mark.slow
def test_recordings_go_on_without_stereo_where_the_first_motion_contradicts_the_rig(
    tmp_path: Path,
) -> None:
    pairs = [(left, shifted(right, -30.0)) for left, right in of_drive()]
    shown = [pairs[0]] * 90 + (pairs + pairs[-2:0:-1]) * 3  # 9 s at rest
    for side, name in enumerate(("left", "right")):
        (tmp_path / name).mkdir()
        for number, pair in enumerate(shown):
            cv2.imwrite(str(tmp_path / name / f"{number:06d}.png"), pair[side])
    recording = open_recording(tmp_path / "left", tmp_path / "right", rig=RIG)
    has_stereo = [frame.right is not None for frame in recording.frames]
    assert all(has_stereo[:90])
    assert not any(has_stereo[115:])
    (note,) = [note for note in recording.notes if "px too large" in note]
    assert "found only after the vehicle moved" in note


@pytest.mark.slow
@pytest.mark.parametrize(
    ("side", "changed", "words"),
    [
        (0, turned, ("left video is upside down",)),
        (1, turned, ("right video is upside down",)),
        (0, mirrored, ("left video is mirrored",)),
        (1, mirrored, ("right video is mirrored",)),
    ],
)
def test_one_turned_or_mirrored_video_is_named(
    side: int, changed: object, words: tuple[str, ...]
) -> None:
    assert callable(changed)
    pairs = [
        (changed(left), right) if side == 0 else (left, changed(right))
        for left, right in of_drive(n=4)
    ]
    finding = found(pairs)
    assert finding.fault == "refused"
    assert all(word in finding.sentence for word in words)


@pytest.mark.slow
def test_one_camera_and_different_scenes_are_refused() -> None:
    lossy = [
        np.asarray(cv2.imdecode(cv2.imencode(".jpg", left)[1], cv2.IMREAD_COLOR), np.uint8)
        for left, _ in of_drive()
    ]
    same = found([(left, again) for (left, _), again in zip(of_drive(), lossy, strict=True)])
    assert same.fault == "refused"
    assert "one camera" in same.sentence
    rng = np.random.default_rng(0)
    noise = [rng.integers(0, 256, lossy[0].shape[:2], dtype=np.uint8) for _ in lossy]
    smooth = [np.asarray(cv2.GaussianBlur(image, (0, 0), 1.5), np.uint8) for image in noise]
    other = found([(left, right) for (left, _), right in zip(of_drive(), smooth, strict=True)])
    assert other.fault == "refused"
    assert "different scenes" in other.sentence


@pytest.mark.slow
@pytest.mark.parametrize("lag", [-2, 1, 2])
def test_a_lag_is_no_fault_of_the_rig(lag: int) -> None:
    drive, n = rendered(), 9
    pairs = [(drive[i][0], drive[i - lag][1]) for i in range(max(lag, 0), n + min(lag, 0))]
    finding = found(pairs)
    assert finding.fault == "unsteady" if abs(lag) > 1 else finding.fault in ("fits", "unsteady")
    assert finding.sentence == ""


def test_images_without_texture_are_unknown() -> None:
    flat = np.full((188, 620, 3), 90, np.uint8)
    assert found([(flat, flat)] * 3) == PairFinding("unknown")


def test_exposure_is_no_fault_of_the_rig() -> None:
    dark = [
        (left, np.asarray(cv2.convertScaleAbs(right, alpha=0.5), np.uint8))
        for left, right in of_drive()
    ]
    assert found(dark) == PairFinding("fits")


def kitti_2015_pairs(folder: Path) -> Pairs:
    names = [path.name for path in sorted((folder / "kitti2015" / "image_2").glob("*.png"))]
    return [
        (
            image(folder / "kitti2015" / "image_2" / name),
            image(folder / "kitti2015" / "image_3" / name),
        )
        for name in names
    ]


def image(path: Path) -> Image:
    return np.asarray(cv2.imread(str(path)), np.uint8)


def test_kitti_2015_pairs_in_both_orders(shared_data: Path) -> None:
    pairs = kitti_2015_pairs(shared_data)
    left = pairs[0][0]
    rig, _ = load_rig(
        shared_data / "kitti2015" / "calib.txt", size_px=(left.shape[1], left.shape[0])
    )
    assert len(pairs) == 16
    n_swapped = 0
    for left, right in pairs:
        assert found([(left, right[: left.shape[0], : left.shape[1]])], rig).fault == "fits"
        swapped = found([(right, left)], rig)
        assert not swapped.has_stereo
        n_swapped += swapped.fault == "swapped"
    assert n_swapped >= 12


def video_pairs(folder: Path, *, n: int) -> Pairs:
    videos = [cv2.VideoCapture(str(folder / f"{side}.mp4")) for side in ("left", "right")]
    return [
        (np.asarray(videos[0].read()[1], np.uint8), np.asarray(videos[1].read()[1], np.uint8))
        for _ in range(n)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    "name", ["kitti_stereo/0003", "kitti_stereo/0005", "kitti_odometry/gray51"]
)
def test_kitti_videos_with_faults(shared_data: Path, name: str) -> None:
    pairs = video_pairs(shared_data / name, n=7)
    height_px, width_px = pairs[0][0].shape[:2]
    rig, _ = load_rig(
        shared_data / name / "calib.txt", size_px=(width_px, height_px), is_grey="gray" in name
    )
    evidence = PairEvidence(rig.left)
    for left, right in pairs:
        evidence.add(left, right)
    figures = evidence.figures()
    assert find_fault(figures, rig) == PairFinding("fits")
    assert abs(figures.view.row_offset_px) < 0.5
    assert found([(right, left) for left, right in pairs], rig).fault == "swapped"
    assert found([(turned(left), turned(right)) for left, right in pairs], rig).fault == "turned"
    offset = found([(left, shifted(right, 40.0)) for left, right in pairs], rig).prior
    assert offset.offset_px == pytest.approx(40.0, abs=2 * offset.residual_px)

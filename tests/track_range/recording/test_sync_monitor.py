"""Tests of the check that left and right show the same moment, on a vehicle that approaches
walls."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.images.approach import SIZE_PX, approach
from track_range.recording.pairs.sync_monitor import SyncMonitor
from track_range.recording.recording import open_recording
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import StereoRig

N = 32


def moments(*parts: Iterable[int]) -> list[int]:
    """Numbers of the moments that the images of one side show."""
    return [number for part in parts for number in part][:N]


GOOD = list(range(N))


def frames(left: list[int], right: list[int], hz: float = 10.0) -> list[Frame]:
    n = min(len(left), len(right))
    return [
        Frame(i, i / hz, approach(left[i]), approach(right[i], is_right=True)) for i in range(n)
    ]


def paired_by(monitor: SyncMonitor, pairs: list[Frame]) -> list[Frame]:
    ready = [frame for pair in pairs for frame in monitor.add(pair)]
    return [*ready, *monitor.flush()]


def errors(left: list[int], monitor: SyncMonitor, pairs: list[Frame]) -> list[int | None]:
    """By how many moments the right images are later than the left ones; None = stereo is off."""
    numbers = {id(approach(number, is_right=True)): number for number in range(N + 8)}
    paired = paired_by(monitor, pairs)
    assert [frame.index for frame in paired] == [frame.index for frame in pairs]
    assert all(out.left is given.left for out, given in zip(paired, pairs, strict=True))
    return [
        None if frame.right is None else numbers[id(frame.right)] - moment
        for frame, moment in zip(paired, left, strict=False)
    ]


@pytest.mark.parametrize("n_ahead", [0, 4])
def test_good_pair_is_left_as_it_is(n_ahead: int) -> None:
    monitor, pairs = SyncMonitor(n_ahead), frames(GOOD, GOOD)
    assert all(out is given for out, given in zip(paired_by(monitor, pairs), pairs, strict=True))
    assert monitor.notes == ()
    assert monitor.summary() == {}


@pytest.mark.parametrize("k", [1, 2, 5])
@pytest.mark.parametrize("side", ["left", "right"])
def test_dropped_frames(k: int, side: str) -> None:
    bad = moments(range(12), range(12 + k, N + k))
    left, right = (bad, GOOD) if side == "left" else (GOOD, bad)
    monitor = SyncMonitor(4)
    error = errors(left, monitor, frames(left, right))
    assert error[:12] == [0] * 12
    assert error[12 + 10 + k : N - k] == [0] * (N - 2 * k - 22)  # found at the next regular check
    (note,) = [note for note in monitor.notes if "lags" in note]
    late = "right" if side == "left" else "left"  # the other one then shows earlier moments
    assert f"the {late} video lags by {k} frame" in note
    finding = next(finding for finding in monitor.findings if finding.kind == "lag")
    assert 12 <= finding.frame <= 22 + k
    assert (finding.side, finding.lag_frames, finding.action) == (late, k, "re-paired")


@pytest.mark.parametrize(("left_at", "right_at"), [(0, 1), (0, 2), (3, 0)])
def test_lag_from_the_start(left_at: int, right_at: int) -> None:
    """All frames are re-paired, except those whose partners do not exist."""
    left, right = GOOD[left_at:], GOOD[right_at:]
    error = errors(left, SyncMonitor(4), frames(left, right))
    n_missing, n = max(left_at, right_at), min(len(left), len(right))
    paired = error[:-n_missing] if left_at else error[n_missing:]
    assert paired == [0] * (n - n_missing)
    assert None in (error[0], error[-1])


def test_frozen_side_has_no_stereo_and_then_no_lag() -> None:
    right = moments(range(14), [13] * 4, range(18, N))
    monitor = SyncMonitor(4)
    error = errors(GOOD, monitor, frames(GOOD, right))
    assert error == [0] * 14 + [None] * 4 + [0] * (N - 18)
    (note,) = monitor.notes
    assert "The right video repeats its last image" in note
    assert "frame 14 (1.40 s)" in note
    assert "4 frames" in note
    assert monitor.summary()["synchronisation"] == [
        {
            "frame": 14,
            "time_s": 1.4,
            "side": "right",
            "kind": "repeated",
            "lag_frames": 0,
            "frames": 4,
        }
        | {"action": "stereo off"}
    ]


def test_camera_without_a_signal_has_no_stereo_for_that_long() -> None:
    monitor = SyncMonitor(6)
    black = [
        replace(frame, right=np.full_like(frame.right, 7)) if 14 <= frame.index < 20 else frame
        for frame in frames(GOOD, GOOD)
    ]
    assert [frame.index for frame in paired_by(monitor, black) if frame.right is None] == list(
        range(14, 20)
    )
    (note,) = monitor.notes
    assert "The right images are black or uniform" in note
    assert "from frame 14 (1.40 s) on, 6 frames" in note


def test_inserted_frame_is_followed_by_a_lag() -> None:
    left = moments(range(14), [13], range(14, N))
    error = errors(left, SyncMonitor(4), frames(left, GOOD))
    assert error[:14] == [0] * 14
    assert error[14] is None
    assert error[17:] == [0] * (N - 17)


def test_lag_that_ends() -> None:
    right = moments(range(10), range(11, 21), [20], range(21, N))
    monitor = SyncMonitor(4)
    error = errors(GOOD, monitor, frames(GOOD, right))
    assert error[-4:] == [0] * 4
    # 11 of them
    assert 5 <= sum(finding.frames for finding in monitor.findings if finding.kind == "lag") <= 18


def test_stream_has_no_stereo_while_the_right_side_is_late() -> None:
    right = moments(range(10), [9], range(10, N))
    monitor = SyncMonitor()
    error = errors(GOOD, monitor, frames(GOOD, right))
    assert error[10] is None
    assert error[14:] == [None] * (N - 14)
    assert "stereo distances of these frames are off" in monitor.notes[-1]


def test_both_sides_that_repeat_frames_are_synchronised() -> None:
    slow = [number // 2 for number in range(N)]
    monitor = SyncMonitor(4)
    assert errors(slow, monitor, frames(slow, slow)) == [0] * N
    assert monitor.notes == ()


def test_standing_vehicle_is_synchronised() -> None:
    rng = np.random.default_rng(5)

    def noisy(is_right: bool) -> np.ndarray:
        image = approach(5, is_right=is_right) + rng.normal(0, 2, (260, 480))
        return np.clip(image, 0, 255).astype(np.uint8)

    pairs = [Frame(i, i / 10, noisy(False), noisy(True)) for i in range(20)]
    monitor = SyncMonitor(4)
    assert all(frame.right is not None for frame in paired_by(monitor, pairs))
    assert monitor.notes == ()


def test_one_camera_is_passed_on() -> None:
    single = [Frame(n, n / 10, np.zeros((9, 9), np.uint8), None) for n in range(20)]
    assert paired_by(SyncMonitor(4), single) == single


def test_recording_with_a_dropped_frame(tmp_path: Path) -> None:
    right = moments(range(12), range(13, N + 1))
    for name, numbers in (("left", GOOD), ("right", right)):
        (tmp_path / name).mkdir()
        for i, number in enumerate(numbers):
            path = tmp_path / name / f"{i:06d}.png"
            cv2.imwrite(
                str(path),
                cv2.cvtColor(approach(number, is_right=name == "right"), cv2.COLOR_GRAY2BGR),
            )
    rig = StereoRig.rectified(PinholeCamera.of_focal_length(400.0, SIZE_PX), 0.5)
    recording = open_recording(tmp_path / "left", tmp_path / "right", rig=rig, align="off")
    frames = list(recording.frames)
    assert [frame.index for frame in frames] == GOOD
    for frame in (*frames[:12], *frames[24:]):
        assert frame.right is not None
        expected = approach(frame.index, is_right=True)
        assert (whole_image(frame.right)[:, :, 0] == expected).all()
    (note,) = [note for note in recording.notes if "synchronised" in note]
    assert "the left video lags by 1 frame" in note
    assert recording.sync is not None
    assert [finding["lag_frames"] for finding in recording.sync.summary()["synchronisation"]] == [1]

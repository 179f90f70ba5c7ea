from __future__ import annotations

import re
import threading
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from track_range.video.frame import VideoError
from track_range.video.pairing import StereoVideo
from track_range.video.reader import VideoReader

Level = Callable[..., np.ndarray]


@pytest.fixture(scope="module")
def eye(tmp_path_factory: pytest.TempPathFactory, level: Level) -> Callable[[list[float]], VideoReader]:
    """A folder whose images have these times after 13:10:00, written once per list."""
    image = cv2.imencode(".png", level(0, width_px=16, height_px=8))[1].tobytes()

    def make(times_s: list[float]) -> VideoReader:
        folder = tmp_path_factory.mktemp("eye")
        for number in range(len(times_s)):
            (folder / f"{number}.png").write_bytes(image)
        lines = "".join(f"2011-09-26 13:10:{time_s:09.6f}\n" for time_s in times_s)
        (folder / "timestamps.txt").write_text(lines, encoding="ascii")
        return VideoReader(folder)

    return make


Eye = Callable[[list[float]], VideoReader]


def times(n: int, *, rate_hz: float = 10.0, first_s: float = 1.0) -> list[float]:
    return [first_s + number / rate_hz for number in range(n)]


def indices(video: StereoVideo) -> list[tuple[int, int]]:
    return [(left.index, right.index) for left, right in video]


def n_unused(video: StereoVideo, side: str) -> int:
    """Frames of one side that the notes name as not used."""
    counts = (re.findall(rf"(\d+) frames? of the {side} (?:one|video)", note) for note in video.notes)
    return sum(int(n) for found in counts for n in found)


def test_videos_in_step_pair_frame_by_frame(eye: Eye) -> None:
    video = StereoVideo(eye(times(12)), eye(times(12)))
    assert indices(video) == [(number, number) for number in range(12)]
    assert video.notes == ()


def test_a_small_lag_still_pairs_and_a_large_one_does_not(eye: Eye) -> None:
    left = eye(times(5))
    assert indices(StereoVideo(left, eye(times(5, first_s=1.02)))) == [(n, n) for n in range(5)]
    assert indices(StereoVideo(left, eye(times(5, first_s=0.98)))) == [(n, n) for n in range(5)]
    with pytest.raises(VideoError, match=r"their nearest frames are 0.030 s apart, and 0.025 s is the most"):
        indices(StereoVideo(left, eye(times(5, first_s=1.03))))


def test_a_right_video_that_starts_later(eye: Eye) -> None:
    video = StereoVideo(eye(times(10)), eye(times(7, first_s=1.3)))
    assert indices(video) == [(number + 3, number) for number in range(7)]
    assert video.notes == (
        "The right video starts 0.30 s later than the left one: 3 frames of the left one before that not used.",
    )


def test_a_right_video_that_ends_earlier(eye: Eye) -> None:
    video = StereoVideo(eye(times(30)), eye(times(8)))
    assert indices(video) == [(number, number) for number in range(8)]
    assert video.notes == (
        "The right video ends 2.20 s earlier than the left one: 22 frames of the left one after that not used.",
    )


def test_a_left_video_inside_the_right_one(eye: Eye) -> None:
    video = StereoVideo(eye(times(3, first_s=2.0)), eye(times(20)))
    assert indices(video) == [(0, 10), (1, 11), (2, 12)]
    assert video.notes == (
        "The left video starts 1.00 s later than the right one: 10 frames of the right one before that not used.",
        "The left video ends 0.70 s earlier than the right one: 7 frames of the right one after that not used.",
    )


def test_dropped_frames_do_not_shift_the_rest(eye: Eye) -> None:
    left_s, right_s = times(10), times(10)
    del left_s[4], right_s[7]
    video = StereoVideo(eye(left_s), eye(right_s))
    assert indices(video) == [(0, 0), (1, 1), (2, 2), (3, 3), (4, 5), (5, 6), (7, 7), (8, 8)]
    assert video.notes == (
        "1 frame of the left video without a right one within 25.0 ms not used.",
        "1 frame of the right video without a left one within 25.0 ms not used.",
    )


def test_different_rates_pair_where_they_meet(eye: Eye) -> None:
    video = StereoVideo(eye(times(10)), eye(times(28, rate_hz=30.0)))
    assert indices(video) == [(number, 3 * number) for number in range(10)]
    assert (n_unused(video, "left"), n_unused(video, "right")) == (0, 18)
    assert video.notes[0] == (
        "The left video runs at 10.00 and the right one at 30.00 frames per second: only frames within 8.3 ms of each "
        "other are paired."
    )


def test_the_nearest_frame_wins(eye: Eye) -> None:
    video = StereoVideo(eye([1.0, 1.1, 1.180, 1.2, 1.3]), eye([1.0, 1.1, 1.203, 1.3]))
    assert indices(video) == [(0, 0), (1, 1), (3, 2), (4, 3)]
    assert (n_unused(video, "left"), n_unused(video, "right")) == (1, 0)


def test_nothing_in_common_names_both_spans(eye: Eye) -> None:
    left, right = eye(times(5)), eye(times(5, first_s=20.0))
    left_s, right_s = left.first_time_s, right.first_time_s
    with pytest.raises(VideoError) as raised:
        indices(StereoVideo(left, right))
    message = str(raised.value)
    assert f"{left.path} ({left_s:.2f} s to {left_s + 0.4:.2f} s)" in message
    assert f"{right.path} ({right_s:.2f} s to {right_s + 0.4:.2f} s) have no frames of one instant" in message


@given(data=st.data())
@settings(deadline=None, max_examples=25)
def test_pairs_are_near_in_order_and_add_up(eye: Eye, data: st.DataObject) -> None:
    def drawn() -> list[float]:
        steps = data.draw(st.lists(st.integers(4, 30), min_size=2, max_size=14))
        return [1 + sum(steps[:n]) / 100 for n in range(len(steps))]

    left, right = eye(drawn()), eye(drawn())
    video = StereoVideo(left, right)
    pairs = list(video)  # both start at 1 s, so that there is a pair
    assert all(abs(a.time_s - b.time_s) <= video.tolerance_s + 1e-5 for a, b in pairs)
    for side in (0, 1):
        order = [pair[side].index for pair in pairs]
        assert order == sorted(set(order))
    assert len(pairs) + n_unused(video, "left") == left.n_frames
    assert len(pairs) + n_unused(video, "right") == right.n_frames


def test_iterating_again_starts_anew(eye: Eye) -> None:
    video = StereoVideo(eye(times(6)), eye(times(5, first_s=1.1)))
    pairs = iter(video)
    next(pairs)
    pairs.close()
    assert len(indices(video)) == 5
    assert n_unused(video, "left") == 1


def test_leaving_early_stops_both_decoders(eye: Eye) -> None:
    pairs = iter(StereoVideo(eye(times(30)), eye(times(30))))
    next(pairs)
    assert sum(thread.name == "prefetch" for thread in threading.enumerate()) == 2
    pairs.close()
    assert not any(thread.name == "prefetch" for thread in threading.enumerate())


def test_a_fault_of_one_eye_reaches_the_caller(eye: Eye) -> None:
    right = eye(times(6))
    (right.path / "3.png").write_bytes(b"damaged")
    pairs = iter(StereoVideo(eye(times(6)), right))
    assert [next(pairs)[0].index for _ in range(3)] == [0, 1, 2]
    with pytest.raises(VideoError, match=r"3.png: this image is damaged"):
        next(pairs)
    assert not any(thread.name == "prefetch" for thread in threading.enumerate())


def test_the_start_offset_of_a_stream_decides(tmp_path: Path, film: Callable[..., Path]) -> None:
    left = VideoReader(film(tmp_path / "left.mp4", times(10, first_s=0.0)))
    right = VideoReader(film(tmp_path / "right.mp4", times(8, first_s=0.3)))
    video = StereoVideo(left, right)
    assert indices(video) == [(number + 3, number) for number in range(7)]
    assert (n_unused(video, "left"), n_unused(video, "right")) == (3, 1)


def test_a_right_video_that_was_cut_short(tmp_path: Path, film: Callable[..., Path]) -> None:
    images = list(np.random.default_rng(3).integers(0, 256, (40, 48, 64, 3), np.uint8))
    left, right = (film(tmp_path / f"{side}.mkv", times(40), images=images) for side in ("left", "right"))
    right.write_bytes(right.read_bytes()[: right.stat().st_size // 2])
    video = StereoVideo(VideoReader(left), VideoReader(right))
    n = len(indices(video))
    assert 10 <= n <= 30
    assert f"The right video ends {(40 - n) / 10:.2f} s earlier than the left one" in video.notes[0]
    assert f"reading ended after {n} frames" in video.right.notes[0]


def test_real_pair(shared_data: Path) -> None:
    left, right = (VideoReader(shared_data / "kitti_stereo" / "0003" / f"{side}.mp4") for side in ("left", "right"))
    video = StereoVideo(left, right)
    pairs = list(video)
    assert [(a.index, b.index) for a, b in pairs] == [(number, number) for number in range(16)]
    assert not np.array_equal(pairs[0][0].image, pairs[0][1].image)
    assert video.notes == ()

from __future__ import annotations

import re
import threading
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.recording.pairs.recorded_pair import RecordedPair
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoError
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.stereo.alignment.common_moment import ClockOffset

Level = Callable[..., np.ndarray]


@pytest.fixture(scope="module")
def view(
    tmp_path_factory: pytest.TempPathFactory, level: Level
) -> Callable[[list[float]], RecordedVideo]:
    """Makes a reader of an image folder with the given times, in seconds after 13:10:00."""
    image = cv2.imencode(".png", level(0, width_px=16, height_px=8))[1].tobytes()

    def make(times_s: list[float]) -> RecordedVideo:
        folder = tmp_path_factory.mktemp("view")
        for number in range(len(times_s)):
            (folder / f"{number}.png").write_bytes(image)
        lines = "".join(f"2011-09-26 13:10:{time_s:09.6f}\n" for time_s in times_s)
        (folder / "timestamps.txt").write_text(lines, encoding="ascii")
        return open_video(folder)

    return make


View = Callable[[list[float]], RecordedVideo]


def times(n: int, *, rate_hz: float = 10.0, first_s: float = 1.0) -> list[float]:
    return [first_s + number / rate_hz for number in range(n)]


def indices(video: RecordedPair) -> list[tuple[int, int]]:
    return [(left.index, right.index) for left, right in video]


def n_unused(video: RecordedPair, side: str) -> int:
    """Number of frames of one side that the notes report as skipped."""
    counts = (
        re.findall(rf"(\d+) (?:earlier |later )?{side} frames?\b", note) for note in video.notes
    )
    return sum(int(n) for numbers in counts for n in numbers)


@pytest.mark.parametrize(
    ("has_origin", "first_s", "offset_s"),
    [
        ((True, True), 1.3, 0.0),
        ((False, True), 1.3, -0.3),
        ((True, False), 3.0, -2.0),
        ((False, False), 1.3, 0.0),  # one clock
        ((False, False), 50.0, -49.0),
    ],
)
def test_clocks_without_an_origin(
    view: View, has_origin: tuple[bool, bool], first_s: float, offset_s: float
) -> None:
    left, right = view(times(10)), view(times(10, first_s=first_s))
    right.select(0.0, origin_s=left.first_time_s)
    left.has_origin, right.has_origin = has_origin
    video = RecordedPair(left, right)
    assert right.offset_s == pytest.approx(offset_s)
    n_later = 0 if offset_s else round(10 * (first_s - 1.0))
    assert indices(video) == [(n + n_later, n) for n in range(10 - n_later)]
    assert any("without a common origin" in note for note in video.notes) == bool(offset_s)


@pytest.mark.parametrize(("value_s", "is_used"), [(0.2, False), (0.4, True)])
def test_offset_of_images_is_as_fine_as_the_slower_video(
    view: View, value_s: float, is_used: bool
) -> None:
    pair = RecordedPair(view(times(40, rate_hz=20.0)), view(times(10, rate_hz=5.0)))
    assert pair.use_offset(ClockOffset("found", value_s)) is is_used
    assert pair.right.offset_s == (value_s if is_used else 0.0)


def test_synchronised_videos(view: View) -> None:
    video = RecordedPair(view(times(12)), view(times(12)))
    assert indices(video) == [(number, number) for number in range(12)]
    assert video.notes == ()


def test_small_and_large_lag(view: View) -> None:
    left = view(times(5))
    assert indices(RecordedPair(left, view(times(5, first_s=1.02)))) == [(n, n) for n in range(5)]
    assert indices(RecordedPair(left, view(times(5, first_s=0.98)))) == [(n, n) for n in range(5)]
    with pytest.raises(VideoError, match=r"none nearer than 0.030 s"):
        indices(RecordedPair(left, view(times(5, first_s=1.03))))


def test_right_video_starts_later(view: View) -> None:
    video = RecordedPair(view(times(10)), view(times(7, first_s=1.3)))
    assert indices(video) == [(number + 3, number) for number in range(7)]
    (note,) = video.notes
    assert "right video starts 0.30 s later" in note
    assert n_unused(video, "left") == 3


def test_right_video_ends_earlier(view: View) -> None:
    video = RecordedPair(view(times(30)), view(times(8)))
    assert indices(video) == [(number, number) for number in range(8)]
    (note,) = video.notes
    assert "right video ends 2.20 s earlier" in note
    assert n_unused(video, "left") == 22


def test_left_video_inside_the_right_one(view: View) -> None:
    video = RecordedPair(view(times(3, first_s=2.0)), view(times(20)))
    assert indices(video) == [(0, 10), (1, 11), (2, 12)]
    start, end = video.notes
    assert "1.00 s later" in start
    assert "10 earlier right frames" in start
    assert "0.70 s earlier" in end
    assert "7 later right frames" in end


def test_dropped_frames_do_not_shift_the_rest(view: View) -> None:
    left_s, right_s = times(10), times(10)
    del left_s[4], right_s[7]
    video = RecordedPair(view(left_s), view(right_s))
    assert indices(video) == [(0, 0), (1, 1), (2, 2), (3, 3), (4, 5), (5, 6), (7, 7), (8, 8)]
    assert len(video.notes) == 2
    assert (n_unused(video, "left"), n_unused(video, "right")) == (1, 1)


def test_different_frame_rates(view: View) -> None:
    video = RecordedPair(view(times(10)), view(times(28, rate_hz=30.0)))
    assert indices(video) == [(number, 3 * number) for number in range(10)]
    assert (n_unused(video, "left"), n_unused(video, "right")) == (0, 18)
    assert "10.00" in video.notes[0]
    assert "8.3 ms" in video.notes[0]


def test_nearest_frame_is_paired(view: View) -> None:
    video = RecordedPair(view([1.0, 1.1, 1.180, 1.2, 1.3]), view([1.0, 1.1, 1.203, 1.3]))
    assert indices(video) == [(0, 0), (1, 1), (3, 2), (4, 3)]
    assert (n_unused(video, "left"), n_unused(video, "right")) == (1, 0)


def test_no_common_times(view: View) -> None:
    left, right = view(times(5)), view(times(5, first_s=20.0))
    left_s, right_s = left.first_time_s, right.first_time_s
    with pytest.raises(VideoError) as raised:
        indices(RecordedPair(left, right))
    message = str(raised.value)
    assert f"{left.path} ({left_s:.2f} s to {left_s + 0.4:.2f} s)" in message
    assert f"{right.path} ({right_s:.2f} s to {right_s + 0.4:.2f} s): expected" in message


@given(data=st.data())
@settings(deadline=None, max_examples=25)
def test_pairs_of_random_times(view: View, data: st.DataObject) -> None:
    def random_times() -> list[float]:
        steps = data.draw(st.lists(st.integers(4, 30), min_size=2, max_size=14))
        return [1 + sum(steps[:n]) / 100 for n in range(len(steps))]

    left, right = view(random_times()), view(random_times())
    video = RecordedPair(left, right)
    pairs = list(video)  # both start at 1 s, so that there is a pair
    assert all(abs(a.time_s - b.time_s) <= video.tolerance_s + 1e-5 for a, b in pairs)
    for side in (0, 1):
        order = [pair[side].index for pair in pairs]
        assert order == sorted(set(order))
    assert len(pairs) + n_unused(video, "left") == left.n_frames
    assert len(pairs) + n_unused(video, "right") == right.n_frames


def test_second_iteration_restarts(view: View) -> None:
    video = RecordedPair(view(times(6)), view(times(5, first_s=1.1)))
    pairs = iter(video)
    next(pairs)
    pairs.close()
    assert len(indices(video)) == 5
    assert n_unused(video, "left") == 1


def test_closing_early_stops_both_decoders(view: View) -> None:
    pairs = iter(RecordedPair(view(times(30)), view(times(30))))
    next(pairs)
    assert sum(thread.name.startswith("read ") for thread in threading.enumerate()) == 2
    pairs.close()
    assert not any(thread.name.startswith("read ") for thread in threading.enumerate())


def test_error_of_one_video_reaches_the_caller(view: View) -> None:
    right = view(times(6))
    (right.path / "3.png").unlink()
    pairs = iter(RecordedPair(view(times(6)), right))
    assert [next(pairs)[0].index for _ in range(3)] == [0, 1, 2]
    with pytest.raises(VideoError, match=r"3.png: the image was deleted"):
        next(pairs)
    assert not any(thread.name.startswith("read ") for thread in threading.enumerate())


def test_start_offset_of_a_stream(tmp_path: Path, film: Callable[..., Path]) -> None:
    left = open_video(film(tmp_path / "left.mp4", times(10, first_s=0.0)))
    right = open_video(film(tmp_path / "right.mp4", times(8, first_s=0.3)))
    video = RecordedPair(left, right)
    assert indices(video) == [(number + 3, number) for number in range(7)]
    assert (n_unused(video, "left"), n_unused(video, "right")) == (3, 1)


def test_truncated_right_video(tmp_path: Path, film: Callable[..., Path]) -> None:
    images = list(np.random.default_rng(3).integers(0, 256, (40, 48, 64, 3), np.uint8))
    left, right = (
        film(tmp_path / f"{side}.mkv", times(40), images=images) for side in ("left", "right")
    )
    right.write_bytes(right.read_bytes()[: right.stat().st_size // 2])
    video = RecordedPair(open_video(left), open_video(right))
    n = len(indices(video))
    assert 10 <= n <= 30
    assert f"{(40 - n) / 10:.2f} s earlier" in video.notes[0]
    assert f"{n} frames" in video.right.notes[0]


def test_real_pair(shared_data: Path) -> None:
    left, right = (
        open_video(shared_data / "kitti_stereo" / "0003" / f"{side}.mp4")
        for side in ("left", "right")
    )
    video = RecordedPair(left, right)
    pairs = list(video)
    assert [(a.index, b.index) for a, b in pairs] == [(number, number) for number in range(16)]
    assert not np.array_equal(pairs[0][0].image, pairs[0][1].image)
    assert video.notes == ()

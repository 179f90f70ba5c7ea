"""Tests of reading live streams, single and as a pair."""

from __future__ import annotations

import itertools
import re
import socket
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from tests.support.recordings.live_servers import (
    N_LEVELS,
    RATE_HZ,
    cameras,
    number_of,
    served,
    sound,
)
from tests.support.results.overlay_results import result
from track_range.recording.pairs.live_pair import LivePair
from track_range.recording.sources.live import live_video
from track_range.recording.sources.live.address import LiveAddress
from track_range.recording.sources.live.live_video import LiveVideo
from track_range.recording.video.frame import VideoError
from track_range.views.live_view.view import LiveView


def wait_for_frames(reader: LiveVideo, n: int) -> None:
    """Wait until `n` more frames have arrived."""
    arrival, n_expected = threading.Event(), reader.n_received + n
    reader.notify(arrival)
    while reader.n_received < n_expected:
        assert arrival.wait(20)
        arrival.clear()


def test_frames_are_in_order_with_the_streams_time_steps() -> None:
    with cameras(1) as (camera,):
        reader = LiveVideo(LiveAddress(camera.url))
        assert (reader.width_px, reader.height_px, reader.is_grey, reader.fps) == (
            64,
            48,
            True,
            RATE_HZ,
        )
        assert reader.n_frames is None
        frames = list(itertools.islice(reader, 6))
    index, time_s = (
        np.array([getattr(frame, name) for frame in frames]) for name in ("index", "time_s")
    )
    assert (np.diff(index) > 0).all()
    assert (np.diff(time_s) > 0).all()
    shown = np.array([number_of(frame.image) for frame in frames])
    assert (np.diff(shown) % N_LEVELS == np.diff(index)).all()
    assert time_s[0] >= reader.first_time_s


def test_slow_reader_gets_the_newest_frame() -> None:
    with cameras(1) as (camera,):
        reader = LiveVideo(LiveAddress(camera.url))
        frames = iter(reader)
        first = next(frames)
        wait_for_frames(reader, 12)
        second = next(frames)
        assert reader.notes == ()
        frames.close()
    assert second.index >= first.index + 12
    n_received = reader.n_received
    (note,) = reader.notes
    assert note.startswith(f"{camera.url}: ")
    assert f"{n_received - 2} dropped" in note


def test_each_third_frame() -> None:
    with cameras(1) as (camera,):
        reader = LiveVideo(LiveAddress(camera.url), every=3)
        index = [frame.index for frame in itertools.islice(reader, 3)]
    assert all(number % 3 == 0 for number in index)
    assert sorted(set(index)) == index
    n_wanted = -(-reader.n_received // 3)
    assert reader.notes == () if n_wanted == 3 else f"{n_wanted - 3} dropped" in reader.notes[0]


def test_right_frames_are_chosen_by_their_partner() -> None:
    with cameras(1) as (camera,):
        reader = LiveVideo(LiveAddress(camera.url), every=3, is_partner=True)
        index = [frame.index for frame in itertools.islice(reader, 6)]
    assert any(number % 3 for number in index)  # each frame may be the partner
    n_dropped = max(-(-reader.n_received // 3) - 6, 0)
    assert [f" {n_dropped} dropped" in note for note in reader.notes] == [True] * (n_dropped > 0)


def test_stream_is_read_to_its_end() -> None:
    with cameras(1, 120) as (camera,):
        reader = LiveVideo(LiveAddress(camera.url))
        frames = list(reader)
    assert number_of(frames[-1].image) == 119 % N_LEVELS
    assert reader.is_over
    assert reader.is_closed
    assert reader.notes[0].startswith(f"{camera.url}: ")
    assert f"{reader.n_received} frames" in reader.notes[0]


@pytest.mark.parametrize(
    ("address", "word"),
    [("http://[::1/x", "opened"), ("/dev/video999", "camera"), ("/dev/null", "camera")],
)
def test_unusable_addresses(address: str, word: str) -> None:
    with pytest.raises(VideoError, match=rf"^{re.escape(address)}: .*{word}"):
        LiveVideo(LiveAddress(address))


NOISE = np.random.default_rng(3).integers(0, 255, 200_000, np.uint8).tobytes()


@pytest.mark.parametrize(
    ("content", "word"),
    [(sound(), "no video"), (NOISE, "(opened|received)")],
    ids=("sound", "noise"),
)
def test_unusable_streams(content: bytes, word: str) -> None:
    with served(content) as url, pytest.raises(VideoError, match=rf"^{url}: .*{word}"):
        LiveVideo(LiveAddress(url))


def test_unplugged_camera() -> None:
    with cameras(1, 120, is_torn=True) as (camera,):
        reader = LiveVideo(LiveAddress(camera.url))
        frames = iter(reader)
        next(frames)
        with pytest.raises(VideoError, match=rf"^{camera.url}: .*lost after \d+ frames"):
            list(frames)
    assert reader.is_closed


def test_part_of_a_stream() -> None:
    with cameras(1) as (camera,):
        reader = LiveVideo(LiveAddress(camera.url), start_s=0.2, duration_s=0.3)
        times_s = np.array([frame.time_s for frame in reader]) - reader.first_time_s
    assert times_s.min() >= 0.2 - 1e-6
    assert times_s.max() < 0.5
    assert len(times_s) > 3


def test_connection_refused() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(VideoError, match=rf"^tcp://127.0.0.1:{port}: .*refused"):
        LiveVideo(LiveAddress(f"tcp://127.0.0.1:{port}"))


def test_stream_stops_sending(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(live_video, "SILENCE_S", 0.5)
    with cameras(1) as (camera,):
        reader = LiveVideo(LiveAddress(camera.url))
        camera.interval_s = 50
        with pytest.raises(VideoError, match=rf"^{camera.url}: .*lost"):
            list(reader)


def test_credentials_are_not_in_messages() -> None:
    with pytest.raises(VideoError) as raised:
        LiveVideo(LiveAddress("rtsp://me:secret@127.0.0.1:1/x"))
    assert "secret" not in str(raised.value)


def test_live_view_stream_and_change_of_size() -> None:
    small, large = (np.full((height, 64, 3), 90, np.uint8) for height in (48, 96))
    sizes, over = [small], threading.Event()

    def offer_on(view: LiveView) -> None:
        while not over.wait(0.02):
            view.offer(result([], image=sizes[-1]))

    with LiveView("127.0.0.1", 0) as view:
        offering = threading.Thread(target=offer_on, args=(view,))
        offering.start()
        try:
            frames = iter(LiveVideo(LiveAddress(f"{view.page.url}stream.mjpg")))
            assert next(frames).image.shape == (48, 64, 3)
            sizes.append(large)
            with pytest.raises(VideoError, match=r"expected .*64x48"):
                list(frames)
        finally:
            over.set()
            offering.join(20)


def test_pair_is_the_newest_within_the_tolerance() -> None:
    with cameras(2) as (one, other):
        left, right = (LiveVideo(LiveAddress(camera.url)) for camera in (one, other))
        pair = LivePair(left, right)
        pairs = iter(pair)
        first = next(pairs)
        wait_for_frames(left, 12)
        second = next(pairs)
        assert pair.notes == ()
        pairs.close()
        pair.close()
    for left_frame, right_frame in (first, second):
        assert abs(left_frame.time_s - right_frame.time_s) <= pair.tolerance_s == 0.5 / RATE_HZ
    # not the next frame; the newest pair may lag behind the newest frame
    assert second[0].index > first[0].index + 8
    assert left.n_taken <= 4 < left.n_received
    assert "2 pairs" in pair.notes[0]


@pytest.mark.slow
def test_pair_ends_with_one_stream() -> None:
    with cameras(1, 150) as (one,), cameras(1) as (other,):
        pair = LivePair(LiveVideo(LiveAddress(one.url)), LiveVideo(LiveAddress(other.url)))
        assert 0 < len(list(pair)) <= 150
        pair.close()


@pytest.mark.slow
def test_pair_fails_with_one_stream() -> None:
    with cameras(1) as (one,), cameras(1, 200, is_torn=True) as (other,):
        pair = LivePair(LiveVideo(LiveAddress(one.url)), LiveVideo(LiveAddress(other.url)))
        with pytest.raises(VideoError, match=rf"^{other.url}: .*lost"):
            list(pair)
        pair.close()


def test_pair_is_read_twice() -> None:
    """First the frames for the alignment, then the run, which continues with the newest frames and
    times from 0."""
    with cameras(2) as (one, other):
        pair = LivePair(*(LiveVideo(LiveAddress(camera.url)) for camera in (one, other)))
        first = list(itertools.islice(pair, 3))
        first_time_s = pair.left.first_time_s
        run = list(itertools.islice(pair, 3))
        assert run[0][0].index > first[-1][0].index
        assert first_time_s < pair.left.first_time_s <= run[0][0].time_s
        pair.close()


def test_part_of_a_pair() -> None:
    with cameras(2) as (one, other):
        readers = (
            LiveVideo(LiveAddress(camera.url), start_s=0.1, duration_s=3.0)
            for camera in (one, other)
        )
        pair = LivePair(*readers)
        times_s = np.array([left.time_s for left, _ in pair]) - pair.left.first_time_s
        pair.close()
    assert times_s.min() >= 0.1 - 1e-6
    assert times_s.max() < 3.1


@pytest.mark.slow
def test_streams_without_a_common_time() -> None:
    with cameras(2, 200) as (one, other):
        pair = LivePair(*(LiveVideo(LiveAddress(camera.url)) for camera in (one, other)))
        pair.tolerance_s = 0.0
        with pytest.raises(VideoError, match=r"expected pairs"):
            list(pair)
        pair.close()


def test_playlist_of_a_server_opens_no_file(tmp_path: Path, film: Callable[..., Path]) -> None:
    segment = film(tmp_path / "segment.ts", [number / 10 for number in range(10)])
    playlist = f"#EXTM3U\n#EXT-X-TARGETDURATION:1\n#EXTINF:1,\nfile://{segment}\n#EXT-X-ENDLIST\n"
    with served(playlist.encode()) as address, pytest.raises(VideoError, match="opened"):
        LiveVideo(LiveAddress(address))

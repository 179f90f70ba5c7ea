"""Live streams, alone and as a pair: always the newest, everything counted, every end told."""

from __future__ import annotations

import itertools
import socket
import threading

import numpy as np
import pytest

from tests.track_range.live_servers import N_LEVELS, RATE_HZ, cameras, number_of, served, sound
from tests.track_range.overlay_results import result
from track_range.live_view.view import LiveView
from track_range.video.frame import VideoError
from track_range.video.live import reader as live_reader
from track_range.video.live import stream as live_stream
from track_range.video.live.address import LiveAddress
from track_range.video.live.pair import LivePair
from track_range.video.live.reader import LiveReader
from track_range.video.live.stream import LiveStream


def let_come(reader: LiveReader, n: int) -> None:
    """Wait until so many more images have come."""
    news, wanted = reader.stream.news(), reader.stream.n_received + n
    while reader.stream.n_received < wanted:
        assert news.wait(20)
        news.clear()


def test_images_come_in_order_with_the_streams_own_steps_of_time() -> None:
    with cameras(1) as (camera,):
        reader = LiveReader(LiveAddress(camera.url))
        assert (reader.width_px, reader.height_px, reader.is_grey, reader.fps) == (64, 48, True, RATE_HZ)
        assert reader.n_frames is None
        frames = list(itertools.islice(reader, 6))
    index, time_s = (np.array([getattr(frame, name) for frame in frames]) for name in ("index", "time_s"))
    assert (np.diff(index) > 0).all()
    assert (np.diff(time_s) > 0).all()
    shown = np.array([number_of(frame.image) for frame in frames])
    assert (np.diff(shown) % N_LEVELS == np.diff(index)).all()
    assert time_s[0] >= reader.first_time_s


def test_a_slow_reader_sees_the_newest_image_and_is_told_what_it_missed() -> None:
    with cameras(1) as (camera,):
        reader = LiveReader(LiveAddress(camera.url))
        frames = iter(reader)
        first = next(frames)
        let_come(reader, 12)
        second = next(frames)
        assert reader.notes == ()
        frames.close()
    assert second.index >= first.index + 12
    n_received = reader.stream.n_received
    (note,) = reader.notes
    assert note.startswith(f"{camera.url}: {n_received} frames received, 2 processed, {n_received - 2} dropped")


def test_a_stream_that_ends_is_read_to_its_end() -> None:
    with cameras(1, 120) as (camera,):
        reader = LiveReader(LiveAddress(camera.url))
        frames = list(reader)
    assert number_of(frames[-1].image) == 119 % N_LEVELS
    assert reader.stream.is_over
    assert reader.is_closed
    assert reader.notes[0] == f"{camera.url}: the stream ended by itself after {reader.stream.n_received} frames."


def test_an_address_that_is_none_is_one_sentence() -> None:
    with pytest.raises(VideoError, match=r"^http://\[::1/x: this stream cannot be opened \("):
        LiveReader(LiveAddress("http://[::1/x"))


def test_a_camera_that_is_unplugged_is_one_sentence_after_what_came() -> None:
    with cameras(1, 120, is_torn=True) as (camera,):
        reader = LiveReader(LiveAddress(camera.url))
        frames = iter(reader)
        next(frames)
        with pytest.raises(VideoError, match=rf"^{camera.url}: broke off after \d+ frames \(.*reset by peer\)\.$"):
            list(frames)
    assert reader.is_closed


def test_a_part_of_a_stream() -> None:
    with cameras(1) as (camera,):
        reader = LiveReader(LiveAddress(camera.url), start_s=0.2, duration_s=0.3)
        times_s = np.array([frame.time_s for frame in reader]) - reader.first_time_s
    assert times_s.min() >= 0.2 - 1e-6
    assert times_s.max() < 0.5
    assert len(times_s) > 3


def test_nobody_at_the_address() -> None:
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(
        VideoError, match=rf"^tcp://127.0.0.1:{port}: this stream cannot be opened \(Connection refused\)\.$"
    ):
        LiveStream(LiveAddress(f"tcp://127.0.0.1:{port}"))


def test_a_camera_that_is_not_there() -> None:
    with pytest.raises(
        VideoError, match=r"^/dev/video999: this camera cannot be opened \(No such file or directory\)\.$"
    ):
        LiveStream(LiveAddress("/dev/video999"))


def test_a_device_that_is_no_camera() -> None:
    with pytest.raises(VideoError, match=r"^/dev/null: this camera cannot be opened"):
        LiveStream(LiveAddress("/dev/null"))


def test_a_stream_without_video() -> None:
    with served(sound()) as url, pytest.raises(VideoError, match=rf"^{url}: holds no video\.$"):
        LiveStream(LiveAddress(url))


def test_a_stream_of_nonsense() -> None:
    noise = np.random.default_rng(3).integers(0, 255, 200_000, np.uint8).tobytes()
    with (
        served(noise) as url,
        pytest.raises(VideoError, match=rf"^{url}: (this stream cannot be opened|no frame received)"),
    ):
        LiveStream(LiveAddress(url))


def test_a_stream_that_falls_silent(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (live_reader, live_stream):
        monkeypatch.setattr(module, "SILENCE_S", 0.5)
    with cameras(1) as (camera,):
        reader = LiveReader(LiveAddress(camera.url))
        camera.interval_s = 50
        with pytest.raises(VideoError, match=rf"^{camera.url}: broke off.* 0 s"):
            list(reader)


def test_names_and_passwords_are_not_told() -> None:
    with pytest.raises(VideoError) as told:
        LiveStream(LiveAddress("rtsp://me:secret@127.0.0.1:1/x"))
    assert "secret" not in str(told.value)


def test_pictures_of_the_live_page_are_a_stream_too_and_a_change_of_size_is_told() -> None:
    small, large = (np.full((height, 64, 3), 90, np.uint8) for height in (48, 96))
    sizes, over = [small], threading.Event()

    def offer_on(view: LiveView) -> None:
        while not over.wait(0.02):
            view.offer(result([], image=sizes[-1]))

    with LiveView("127.0.0.1", 0) as view:
        offering = threading.Thread(target=offer_on, args=(view,))
        offering.start()
        try:
            frames = iter(LiveReader(LiveAddress(f"{view.page.url}stream.mjpg")))
            assert next(frames).image.shape == (48, 64, 3)
            sizes.append(large)
            with pytest.raises(
                VideoError, match=r"its images change from 64x48 to 64x96: let the camera keep one size"
            ):
                list(frames)
        finally:
            over.set()
            offering.join(20)


def test_pairs_are_of_one_instant_and_the_newest() -> None:
    with cameras(2) as (one, other):
        left, right = (LiveReader(LiveAddress(camera.url)) for camera in (one, other))
        pair = LivePair(left, right)
        pairs = iter(pair)
        first = next(pairs)
        let_come(left, 12)
        second = next(pairs)
        assert pair.notes == ()
        pairs.close()
        pair.close()
    for one_eye, other_eye in (first, second):
        assert abs(one_eye.time_s - other_eye.time_s) <= pair.tolerance_s == 0.5 / RATE_HZ
    assert second[0].index >= first[0].index + 12
    assert left.stream.n_taken == 2 < left.stream.n_received
    assert pair.notes[0].startswith(
        "Left and right come over a network and are paired by when they arrive, 2 pairs a m"
    )


def test_a_pair_is_over_when_one_eye_is() -> None:
    with cameras(1, 150) as (one,), cameras(1) as (other,):
        pair = LivePair(LiveReader(LiveAddress(one.url)), LiveReader(LiveAddress(other.url)))
        assert 0 < len(list(pair)) <= 150
        pair.close()


def test_a_pair_breaks_off_when_one_eye_does() -> None:
    with cameras(1) as (one,), cameras(1, 200, is_torn=True) as (other,):
        pair = LivePair(LiveReader(LiveAddress(one.url)), LiveReader(LiveAddress(other.url)))
        with pytest.raises(VideoError, match=rf"^{other.url}: broke off after"):
            list(pair)
        pair.close()


def test_a_pair_may_be_read_on() -> None:
    """A look at the first frames, then the run: from where the streams are, with time from 0 again."""
    with cameras(2) as (one, other):
        pair = LivePair(*(LiveReader(LiveAddress(camera.url)) for camera in (one, other)))
        looked_at = list(itertools.islice(pair, 3))
        first_time_s = pair.left.first_time_s
        run = list(itertools.islice(pair, 3))
        assert run[0][0].index > looked_at[-1][0].index
        assert first_time_s < pair.left.first_time_s <= run[0][0].time_s
        pair.close()


def test_a_part_of_a_pair() -> None:
    with cameras(2) as (one, other):
        readers = (LiveReader(LiveAddress(camera.url), start_s=0.1, duration_s=0.2) for camera in (one, other))
        pair = LivePair(*readers)
        times_s = np.array([left.time_s for left, _ in pair]) - pair.left.first_time_s
        pair.close()
    assert times_s.min() >= 0.1 - 1e-6
    assert times_s.max() < 0.3


def test_images_that_never_come_together_are_one_sentence() -> None:
    with cameras(2, 200) as (one, other):
        pair = LivePair(*(LiveReader(LiveAddress(camera.url)) for camera in (one, other)))
        pair.tolerance_s = 0.0
        with pytest.raises(VideoError, match=r"no images of one instant, 0 ms apart at most\.$"):
            list(pair)
        pair.close()

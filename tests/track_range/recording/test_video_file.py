from __future__ import annotations

import os
import wave
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.fleet.inputs.clip import Clip
from track_range.fleet.inputs.dry_run import check_clips
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoError
from track_range.recording.video.recorded_video import RecordedVideo

Film = Callable[..., Path]
NumberIn = Callable[[np.ndarray], int]

UNEVEN_S = [
    *(0.0, 0.1, 0.2, 0.35, 0.4, 0.5, 0.9, 1.0, 1.1, 1.2, 1.25, 1.3, 1.4, 1.5, 1.6, 1.8),
    *(1.9, 2.0, 2.1, 2.5),
]
EVEN_S = [number / 10 for number in range(40)]
IMAGE = np.zeros((8, 8, 3), np.uint8)


def frames_of(reader: RecordedVideo, number_in: NumberIn) -> list[tuple[int, float, int]]:
    """(index, time, number encoded in the image) of every frame."""
    return [(frame.index, round(frame.time_s, 3), number_in(frame.image)) for frame in reader]


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "mov"])
def test_times_and_order_with_b_frames(
    tmp_path: Path, film: Film, number_in: NumberIn, suffix: str
) -> None:
    reader = open_video(film(tmp_path / f"film.{suffix}", UNEVEN_S))
    assert frames_of(reader, number_in) == [
        (number, time_s, number) for number, time_s in enumerate(UNEVEN_S)
    ]
    assert (reader.width_px, reader.height_px) == (64, 48)
    (note,) = reader.notes
    assert note.startswith(f"{reader.path}: the timestamps have 2 gaps")


def test_images_are_contiguous_bgr_arrays(tmp_path: Path, film: Film) -> None:
    blue = np.zeros((48, 64, 3), np.uint8)
    blue[..., 0] = 200
    reader = open_video(film(tmp_path / "blue.mp4", [0.0, 0.1], images=[blue, blue]))
    for frame in reader:
        assert (frame.image.shape, frame.image.dtype) == ((48, 64, 3), np.uint8)
        assert frame.image.flags.c_contiguous
        assert np.abs(frame.image.astype(int) - [200, 0, 0]).max() <= 4
    assert not reader.is_grey


def test_video_without_colour_is_grey(tmp_path: Path, film: Film) -> None:
    assert open_video(film(tmp_path / "film.mp4", EVEN_S[:3])).is_grey


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "mov"])
def test_start_offset_of_a_stream(tmp_path: Path, film: Film, suffix: str) -> None:
    reader = open_video(film(tmp_path / f"late.{suffix}", [0.7, 0.8, 0.9]))
    assert [frame.time_s for frame in reader] == pytest.approx([0.7, 0.8, 0.9])
    assert reader.first_time_s == pytest.approx(0.7)
    assert [frame.index for frame in reader] == [0, 1, 2]
    # the time before the first frame is not a gap
    assert (reader.n_frames, reader.notes) == (3, ())


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts", "avi"])
@pytest.mark.parametrize("start_s", [0.0, 0.05, 0.3, 0.6, 1.15, 3.9])
def test_later_start(
    tmp_path: Path, film: Film, number_in: NumberIn, suffix: str, start_s: float
) -> None:
    path = film(tmp_path / f"film.{suffix}", EVEN_S)
    whole = open_video(path)
    rest = [
        frame
        for frame in frames_of(whole, number_in)
        if frame[1] >= whole.first_time_s + start_s - 1e-6
    ]
    assert frames_of(open_video(path, start_s=start_s), number_in) == rest
    assert len(rest) == 40 - round(np.ceil(10 * start_s))


def test_frames_before_the_start_are_not_decoded(tmp_path: Path, film: Film) -> None:
    path = film(
        tmp_path / "film.mp4", EVEN_S, images=noisy_images(40), options={"movflags": "faststart"}
    )
    stored = bytearray(path.read_bytes())
    # after the first keyframe, in the first of four seconds
    damaged = stored.index(b"mdat") + len(stored) // 5
    stored[damaged : damaged + 1000] = bytes([255]) * 1000
    path.write_bytes(stored)
    assert open_video(path).first_time_s == 0
    whole, late = open_video(path), open_video(path, start_s=2.0)
    assert len(list(whole)) < 40
    assert whole.notes
    assert ([frame.index for frame in late], late.notes) == (list(range(20, 40)), ())


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts"])
def test_images_shortly_after_keyframes_that_follow_each_other_closely(
    tmp_path: Path, film: Film, number_in: NumberIn, suffix: str
) -> None:
    reader = open_video(film(tmp_path / f"close.{suffix}", EVEN_S, gop=10))
    reader.burst_s = 0.25
    frames = frames_of(reader, number_in)
    assert [index for index, _, _ in frames] == [number for _, _, number in frames]
    # with B-frames the third picture that is stored is not the third one in time
    few = [sum(start <= index < start + 10 for index, _, _ in frames) for start in (0, 10, 20, 30)]
    assert few == [10, 3, 3, 10]
    assert {0, 10, 20, 30} < {index for index, _, _ in frames}
    apart = open_video(film(tmp_path / f"apart.{suffix}", EVEN_S, gop=20))
    apart.burst_s = 0.25
    assert [number for _, _, number in frames_of(apart, number_in)] == list(range(40))


def test_part_of_a_video_and_its_number_of_frames(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S)
    reader = open_video(path, start_s=1.0, duration_s=0.5)
    assert reader.n_frames == 5
    assert [frame.index for frame in reader] == [10, 11, 12, 13, 14]
    assert open_video(path).n_frames == 40
    assert open_video(path, start_s=3.0).n_frames == 10
    assert open_video(path, start_s=9.0).n_frames == 0


def test_origin_of_the_start_time(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "late.mkv", [0.7, 0.8, 0.9, 1.0])
    assert [frame.index for frame in open_video(path, start_s=0.1)] == [1, 2, 3]
    video = open_video(path)
    video.select(0.1, origin_s=0.8)
    assert [frame.index for frame in video] == [2, 3]


def test_reader_can_be_iterated_again(tmp_path: Path, film: Film, number_in: NumberIn) -> None:
    reader = open_video(film(tmp_path / "film.mp4", EVEN_S))
    first = next(iter(reader))
    assert (first.index, first.time_s) == (0, 0.0)
    assert frames_of(reader, number_in) == frames_of(reader, number_in)


@pytest.mark.parametrize("flip", [(False, False), (True, False)])
@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_frames_are_upright(
    tmp_path: Path, film: Film, degrees: int, flip: tuple[bool, bool]
) -> None:
    stored = np.zeros((48, 64, 3), np.uint8)
    stored[:24, :32], stored[:24, 32:], stored[24:, :32] = 220, 150, 80
    reader = open_video(
        film(tmp_path / "turned.mp4", [0.0, 0.1], images=[stored] * 2, rotation=(degrees, *flip))
    )
    rotated = np.rot90(stored, degrees // 90)  # counterclockwise, as in the video's metadata
    expected = rotated[:, ::-1] if flip[0] else rotated
    for frame in reader:
        assert frame.image.shape == expected.shape
        assert np.abs(frame.image.astype(int) - expected).mean() < 5
    assert (reader.width_px, reader.height_px) == (expected.shape[1], expected.shape[0])
    assert any("rotated" in note for note in reader.notes) == (degrees != 0 or flip[0])


def test_rotation_by_an_odd_angle_is_ignored(tmp_path: Path, film: Film) -> None:
    reader = open_video(film(tmp_path / "askew.mp4", [0.0, 0.1], rotation=(30, False, False)))
    assert (reader.width_px, reader.height_px, reader.notes) == (64, 48, ())


@pytest.mark.parametrize(
    ("aspect", "quarter_turns", "stated", "shown_px"),
    [
        (Fraction(4, 3), 0, 4 / 3, (85, 48)),
        (Fraction(4, 5), 0, 4 / 5, (64, 60)),
        (Fraction(2), 90, 1 / 2, (48, 128)),
        (Fraction(0), 0, None, (64, 48)),
        (Fraction(1), 0, 1.0, (64, 48)),
        (Fraction(9), 0, None, (64, 48)),  # not plausible
    ],
)
def test_pixel_aspect_as_the_file_states_it(
    tmp_path: Path,
    film: Film,
    aspect: Fraction,
    quarter_turns: int,
    stated: float | None,
    shown_px: tuple[int, int],
) -> None:
    rotation = (quarter_turns, False, False) if quarter_turns else None
    reader = open_video(film(tmp_path / "wide.mp4", [0.0, 0.1], aspect=aspect, rotation=rotation))
    assert (reader.width_px, reader.height_px) == ((48, 64) if quarter_turns else (64, 48))
    assert reader.pixel_aspect == (None if stated is None else pytest.approx(stated))
    assert reader.shown_size_px == shown_px
    assert any("is ignored" in note for note in reader.notes) == (aspect == 9)


def test_stream_without_timestamps(tmp_path: Path, film: Film, number_in: NumberIn) -> None:
    reader = open_video(film(tmp_path / "film.h264", EVEN_S))
    interval_s = 1 / reader.fps
    assert frames_of(reader, number_in) == [(n, round(n * interval_s, 3), n) for n in range(40)]


def test_avi_with_b_frames_is_in_order(tmp_path: Path, film: Film, number_in: NumberIn) -> None:
    reader = open_video(film(tmp_path / "film.avi", EVEN_S))
    assert frames_of(reader, number_in) == [(n, n / 10, n) for n in range(40)]


def test_repeated_and_backward_times_are_skipped(
    tmp_path: Path, film: Film, number_in: NumberIn
) -> None:
    path = film(tmp_path / "film.avi", EVEN_S[:8], codec="mjpeg")
    retimed = retimed_copy(path, tmp_path / "film.mkv", [0, 100, 200, 200, 150, 300, 400, 500])
    reader = open_video(retimed)
    assert [(time_s, number) for _, time_s, number in frames_of(reader, number_in)] == [
        (0.0, 0),
        (0.1, 1),
        (0.2, 2),
        (0.3, 5),
        (0.4, 6),
        (0.5, 7),
    ]
    (note,) = reader.notes
    assert note.startswith(f"{retimed}: skipped 2 frames")


def test_frames_of_one_time_that_the_file_states_at_its_end(tmp_path: Path, film: Film) -> None:
    path = retimed_copy(
        film(tmp_path / "film.avi", EVEN_S[:12], codec="mjpeg"), tmp_path / "film.mkv", [0] * 12
    )
    images = iter(open_video(path))
    next(images)
    with pytest.raises(VideoError, match="found 1 time for 12 frames"):
        list(images)


def test_frames_of_one_time_that_the_file_states_at_its_start(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S[:12])
    one_time(path)
    with pytest.raises(VideoError, match="found 1 time for 12 frames"):
        open_video(path)
    (checked,) = check_clips([Clip("a", str(path))])
    assert "found 1 time for 12 frames" in checked.problems[0]


def one_time(path: Path) -> None:
    """Give all frames of an MP4 file at an even rate the same time."""
    content = path.read_bytes()
    durations = content.index(b"stts") + 4
    shown = content.replace(b"ctts", b"free")
    path.write_bytes(shown[: durations + 12] + bytes(4) + shown[durations + 12 :][4:])


def retimed_copy(path: Path, copy: Path, stamps_ms: list[int]) -> Path:
    """Write a copy with other timestamps."""
    import av

    with av.open(str(path)) as source, av.open(str(copy), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        packets = [packet for packet in source.demux(video=0) if packet.size]
        for number, (packet, stamp_ms) in enumerate(zip(packets, stamps_ms, strict=True)):
            packet.stream, packet.time_base = stream, Fraction(1, 1000)
            packet.pts, packet.dts = stamp_ms, number - len(stamps_ms)
            target.mux_one(packet)
    return copy


def write_sound(path: Path, _film: Film) -> None:
    with wave.open(str(path), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(bytes(16_000))


def write_text(path: Path, _film: Film) -> None:
    path.write_text("0 0 Car 0 0 -1.57 614.24 181.78 727.31 284.77\n" * 40, encoding="ascii")


def write_unknown_codec(path: Path, film: Film) -> None:
    film(path, EVEN_S[:5]).write_bytes(path.read_bytes().replace(b"avc1", b"zzz1"))


def write_without_index(path: Path, film: Film) -> None:
    stored = film(path, EVEN_S).read_bytes()
    path.write_bytes(stored[: len(stored) // 2])


def write_without_media(path: Path, film: Film) -> None:
    stored = film(path, EVEN_S[:10], options={"movflags": "faststart"}).read_bytes()
    media = stored.index(b"mdat") + 4
    path.write_bytes(stored[:media] + bytes(len(stored) - media))


@pytest.mark.parametrize(
    ("name", "write", "word"),
    [
        ("left.mp4", lambda _path, _film: None, "no such file"),
        ("empty.mp4", lambda path, _film: path.touch(), "empty"),
        ("loop.mp4", lambda path, _film: path.symlink_to(path), "loop"),
        ("000000.png", lambda path, _film: cv2.imwrite(str(path), IMAGE), "single image"),
        ("notes.txt", write_text, "video"),
        ("left.mp4", write_text, "video"),
        ("sound.wav", write_sound, "no video"),
        ("codec.mp4", write_unknown_codec, "no video"),
        ("half.mp4", write_without_index, "index"),
        ("zeros.mp4", write_without_media, "decoded"),
    ],
)
def test_unusable_files(
    tmp_path: Path, film: Film, name: str, write: Callable[[Path, Film], object], word: str
) -> None:
    write(tmp_path / name, film)
    with pytest.raises(VideoError, match=rf"{name}: .*{word}"):
        open_video(tmp_path / name)


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may read everything")
def test_file_without_permission(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S[:3])
    path.chmod(0)
    with pytest.raises(VideoError, match=r"film.mp4: .*Permission denied"):
        open_video(path)


def test_file_is_deleted_between_readings(tmp_path: Path, film: Film) -> None:
    reader = open_video(film(tmp_path / "film.mp4", EVEN_S[:3]))
    assert len(list(reader)) == 3
    reader.path.unlink()
    with pytest.raises(VideoError, match=r"film.mp4: .*No such file"):
        next(iter(reader))


def test_start_after_the_end(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S)
    with pytest.raises(VideoError, match=r"from 4\.00 s on.*0\.00 s.*4\.00 s"):
        list(open_video(path, start_s=4.0, duration_s=10.0))
    with pytest.raises(VideoError, match=r"film\.mp4: .*0\.02 s.*0\.07 s"):
        list(open_video(path, start_s=0.02, duration_s=0.05))


def test_images_that_change_size(
    tmp_path: Path, film: Film, level: Callable[..., np.ndarray]
) -> None:
    small = film(tmp_path / "small.ts", EVEN_S[:10])
    wide = film(
        tmp_path / "wide.ts",
        [5 + t for t in EVEN_S[:10]],
        images=[level(n, width_px=96) for n in range(10)],
        gop=1,
    )
    path = tmp_path / "both.ts"
    path.write_bytes(small.read_bytes() + wide.read_bytes())
    frames = iter(open_video(path))
    with pytest.raises(VideoError, match=r"both.ts: expected .*64x48"):
        [next(frames) for _ in range(11)]


FRAGMENTED = {"movflags": "frag_keyframe+empty_moov+default_base_moof"}


@pytest.mark.parametrize(
    ("suffix", "options"),
    [("mp4", {"movflags": "faststart"}), ("mp4", FRAGMENTED), ("mkv", {}), ("avi", {})],
)
def test_truncated_file(
    tmp_path: Path, film: Film, number_in: NumberIn, suffix: str, options: dict[str, str]
) -> None:
    path = film(tmp_path / f"film.{suffix}", EVEN_S, images=noisy_images(40), options=options)
    whole = [frame.time_s for frame in open_video(path)]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    reader = open_video(path)
    frames = [(frame.index, frame.time_s) for frame in reader]
    assert 10 <= len(frames) <= 30
    assert frames == list(enumerate(whole))[: len(frames)]
    # A fragmented file does not state its duration, and FFmpeg's threads may or may not decode its
    # damaged last frame.
    texts = (f"after {len(frames)} frames", "1 damaged frame")
    assert any(text in note for text in texts for note in reader.notes)


def test_truncated_transport_stream(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.ts", EVEN_S, images=noisy_images(40))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert 10 <= len(list(open_video(path))) <= 30  # such a file does not state its duration


@pytest.mark.parametrize("suffix", ["mp4", "avi", "mkv", "ts"])
def test_damage_in_the_middle(tmp_path: Path, film: Film, suffix: str) -> None:
    path = film(tmp_path / f"film.{suffix}", EVEN_S, images=noisy_images(40))
    whole = {frame.index: frame.time_s for frame in open_video(path)}
    stored = bytearray(path.read_bytes())
    middle = len(stored) // 2
    stored[middle : middle + 600] = (
        np.random.default_rng(0).integers(0, 256, 600, np.uint8).tobytes()
    )
    path.write_bytes(stored)
    reader = open_video(path)
    frames = [(frame.index, frame.time_s) for frame in reader]
    if suffix == "ts":  # no checksums, so some damage is not detected; its place varies
        assert 30 <= len(frames) <= 41
        assert [time_s for _, time_s in frames] == sorted({time_s for _, time_s in frames})
        return
    assert 30 <= len(frames) < 40
    if suffix == "mkv":  # lost packets are visible only as a gap in the times
        assert "1 gap" in reader.notes[0]
        assert [time_s for _, time_s in frames] == sorted(
            {time_s for _, time_s in frames} & set(whole.values())
        )
    elif suffix == "avi":  # not visible at all without timestamps: later frames move up
        assert [time_s for _, time_s in frames] == list(whole.values())[: len(frames)]
    else:
        assert dict(frames).items() <= whole.items()  # the other frames keep their index and time
        (note,) = reader.notes
        assert note.startswith(f"{path}: skipped {40 - len(frames)} damaged frame")


def test_reading_stops_at_an_invalid_packet(tmp_path: Path) -> None:
    images = [b"FRAME\n" + bytes([level]) * (16 * 16 * 3 // 2) for level in range(40, 50)]
    images[6] = b"GARBAGE" * 40
    path = tmp_path / "film.y4m"
    path.write_bytes(b"YUV4MPEG2 W16 H16 F10:1 C420jpeg\n" + b"".join(images))
    reader = open_video(path)
    assert [frame.index for frame in reader] == [0, 1, 2, 3, 4, 5]
    (note,) = reader.notes
    assert note.startswith(f"{path}: ")
    assert "6 frames" in note


def noisy_images(n: int) -> list[np.ndarray]:
    """Images of random noise, so large when encoded that damage in the file hits them."""
    return list(np.random.default_rng(3).integers(0, 256, (n, 48, 64, 3), np.uint8))


@pytest.mark.parametrize(
    ("name", "n", "fps"),
    [
        ("kitti_stereo/0003/left.mp4", 16, 10),
        ("kitti_stereo/0003/right.mp4", 16, 10),
        ("dashcam/highway_two_cars.mp4", 38, 25),
        ("dashcam/solid_white_right.mp4", 221, 25),
    ],
)
def test_real_videos(shared_data: Path, name: str, n: int, fps: int) -> None:
    reader = open_video(shared_data / name)
    times_s = []
    for number, frame in enumerate(reader):
        assert frame.index == number
        assert frame.image.shape == (reader.height_px, reader.width_px, 3)
        times_s.append(frame.time_s)
    assert times_s == pytest.approx([number / fps for number in range(n)])
    assert (reader.n_frames, reader.fps, reader.is_grey, reader.notes) == (n, fps, False, ())


def test_real_grey_video(shared_data: Path) -> None:
    reader = open_video(shared_data / "kitti_odometry/gray51/left.mp4")
    assert (reader.width_px, reader.height_px, reader.n_frames, reader.is_grey) == (
        1226,
        370,
        51,
        True,
    )


def test_clock_that_is_set_back(
    tmp_path: Path, film: Film, level: Callable[..., np.ndarray]
) -> None:
    """Joined transport streams: the second one begins at the time of the first one."""
    parts = [
        film(
            tmp_path / f"{first}.ts",
            EVEN_S[:12],
            images=[level(first + n) for n in range(12)],
            gop=1,
        )
        for first in (0, 12)
    ]
    path = tmp_path / "joined.ts"
    path.write_bytes(b"".join(part.read_bytes() for part in parts))
    reader = open_video(path)
    time_s = np.array([frame.time_s for frame in reader])
    assert 22 <= len(time_s) <= 24  # packets at the joint count as damaged
    assert time_s[-1] - time_s[0] == pytest.approx(2.3, abs=0.02)
    assert (np.diff(time_s) > 0.09).all()
    assert (
        "set back 1 time, first after 1.1" in reader.notes[0] or "first after 2." in reader.notes[0]
    )
    reader.select(2.0)
    assert [round(frame.time_s - time_s[0], 2) for frame in reader] == pytest.approx(
        [2.0, 2.1, 2.2, 2.3], abs=0.02
    )


def test_clock_that_continues_after_wrong_times(tmp_path: Path, film: Film) -> None:
    parts = [
        film(tmp_path / f"{first_s}.ts", [first_s + n / 10 for n in range(n_frames)], gop=1)
        # 1.3 s back: more than frames out of order
        for first_s, n_frames in ((0.0, 15), (0.1, 3), (1.8, 12))
    ]
    path = tmp_path / "joined.ts"
    path.write_bytes(b"".join(part.read_bytes() for part in parts))
    time_s = np.array([frame.time_s for frame in open_video(path)])
    assert time_s[-1] - time_s[0] == pytest.approx(2.9, abs=0.02)  # not 1.4 s later
    assert 25 <= len(time_s) <= 30  # packets at the joints count as damaged
    assert (np.diff(time_s) > 0.09).all()


def test_rounded_times_of_matroska(tmp_path: Path, film: Film) -> None:
    reader = open_video(film(tmp_path / "film.mkv", [n / 30 for n in range(40)], rate=30))
    assert [frame.time_s for frame in reader] == pytest.approx(
        [n / 30 for n in range(40)], abs=1e-9
    )


def test_stream_without_a_container(tmp_path: Path, film: Film) -> None:
    # states 90 000 frames/s, those of its clock
    assumed = open_video(film(tmp_path / "film.h264", EVEN_S[:12]))
    assert assumed.fps == 25.0
    assert "25 frames/s are assumed" in assumed.notes[0]
    import av

    with av.open(str(tmp_path / "stated.h264"), "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        for _ in range(12):
            container.mux(stream.encode(av.VideoFrame(64, 48, "yuv420p")))
        container.mux(stream.encode(None))
    reader = open_video(tmp_path / "stated.h264")
    assert (reader.fps, reader.notes) == (10.0, ())  # as H.264 states it; FFmpeg assumes 25
    assert [frame.time_s for frame in reader] == pytest.approx(EVEN_S[:12])
    assert [frame.index for frame in open_video(tmp_path / "stated.h264")] == list(range(12))


@pytest.mark.parametrize("n", [1, 2, 3, 4])
def test_few_frames(tmp_path: Path, film: Film, n: int) -> None:
    assert len(list(open_video(film(tmp_path / "film.mp4", EVEN_S[:n])))) == n


def test_cover_art_is_no_video(tmp_path: Path, film: Film) -> None:
    import av
    from av.stream import Disposition

    plain = film(tmp_path / "plain.mp4", EVEN_S[:5])
    path = tmp_path / "cover.mp4"
    with av.open(str(plain)) as source, av.open(str(path), "w") as target:
        cover = target.add_stream("mjpeg", rate=1)
        cover.width, cover.height, cover.pix_fmt = 640, 480, "yuvj420p"
        cover.disposition = Disposition.attached_pic
        stream = target.add_stream_from_template(source.streams.video[0])
        target.mux(cover.encode(av.VideoFrame(640, 480, "yuvj420p")))
        for packet in source.demux(video=0):
            if packet.size:
                packet.stream = stream
                target.mux(packet)
    reader = open_video(path)
    assert (reader.width_px, reader.height_px, reader.notes) == (64, 48, ())
    assert len(list(reader)) == 5

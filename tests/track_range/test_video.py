from __future__ import annotations

import os
import wave
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from track_range.video.frame import VideoError
from track_range.video.reader import VideoReader

Film = Callable[..., Path]
NumberIn = Callable[[np.ndarray], int]

UNEVEN_S = [0.0, 0.1, 0.2, 0.35, 0.4, 0.5, 0.9, 1.0, 1.1, 1.2, 1.25, 1.3, 1.4, 1.5, 1.6, 1.8, 1.9, 2.0, 2.1, 2.5]
EVEN_S = [number / 10 for number in range(40)]


def seen(reader: VideoReader, number_in: NumberIn) -> list[tuple[int, float, int]]:
    """(index, time, number in the picture) of every frame."""
    return [(frame.index, round(frame.time_s, 3), number_in(frame.image)) for frame in reader]


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "mov"])
def test_uneven_times_and_order_survive_b_frames(tmp_path: Path, film: Film, number_in: NumberIn, suffix: str) -> None:
    reader = VideoReader(film(tmp_path / f"film.{suffix}", UNEVEN_S))
    assert seen(reader, number_in) == [(number, time_s, number) for number, time_s in enumerate(UNEVEN_S)]
    assert (reader.width_px, reader.height_px) == (64, 48)
    gap = "2 gaps in its times, the longest of 0.40 s after 0.50 s: frames are missing there."
    assert reader.notes == (f"{reader.path}: {gap}",)


def test_frame_images_are_plain_bgr_arrays(tmp_path: Path, film: Film) -> None:
    blue = np.zeros((48, 64, 3), np.uint8)
    blue[..., 0] = 200
    reader = VideoReader(film(tmp_path / "blue.mp4", [0.0, 0.1], images=[blue, blue]))
    for frame in reader:
        assert (frame.image.shape, frame.image.dtype) == ((48, 64, 3), np.uint8)
        assert frame.image.flags.c_contiguous
        assert np.abs(frame.image.astype(int) - [200, 0, 0]).max() <= 4
    assert not reader.is_grey


def test_a_film_without_colour_is_grey(tmp_path: Path, film: Film) -> None:
    assert VideoReader(film(tmp_path / "film.mp4", EVEN_S[:3])).is_grey


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "mov"])
def test_the_start_offset_of_a_stream_is_kept(tmp_path: Path, film: Film, suffix: str) -> None:
    reader = VideoReader(film(tmp_path / f"late.{suffix}", [0.7, 0.8, 0.9]))
    assert [frame.time_s for frame in reader] == pytest.approx([0.7, 0.8, 0.9])
    assert reader.first_time_s == pytest.approx(0.7)
    assert [frame.index for frame in reader] == [0, 1, 2]
    assert (reader.n_frames, reader.notes) == (3, ())  # the time before is no part that was lost


@pytest.mark.parametrize("suffix", ["mp4", "mkv", "ts", "avi"])
@pytest.mark.parametrize("start_s", [0.0, 0.05, 0.3, 0.6, 1.15, 3.9])
def test_a_later_start_gives_the_rest_of_the_whole(
    tmp_path: Path, film: Film, number_in: NumberIn, suffix: str, start_s: float
) -> None:
    path = film(tmp_path / f"film.{suffix}", EVEN_S)
    whole = VideoReader(path)
    rest = [frame for frame in seen(whole, number_in) if frame[1] >= whole.first_time_s + start_s - 1e-6]
    assert seen(VideoReader(path, start_s=start_s), number_in) == rest
    assert len(rest) == 40 - round(np.ceil(10 * start_s))


def test_frames_before_the_start_are_not_decoded(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S, images=noisy_images(40), options={"movflags": "faststart"})
    stored = bytearray(path.read_bytes())
    hurt = stored.index(b"mdat") + len(stored) // 5  # past the first keyframe, in the first of four seconds
    stored[hurt : hurt + 1000] = bytes([255]) * 1000
    path.write_bytes(stored)
    assert VideoReader(path).first_time_s == 0
    whole, late = VideoReader(path), VideoReader(path, start_s=2.0)
    assert len(list(whole)) < 40
    assert whole.notes
    assert ([frame.index for frame in late], late.notes) == (list(range(20, 40)), ())


def test_a_part_is_cut_out_and_its_frames_are_announced(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S)
    reader = VideoReader(path, start_s=1.0, duration_s=0.5)
    assert reader.n_frames == 5
    assert [frame.index for frame in reader] == [10, 11, 12, 13, 14]
    assert VideoReader(path).n_frames == 40
    assert VideoReader(path, start_s=3.0).n_frames == 10
    assert VideoReader(path, start_s=9.0).n_frames == 0


def test_start_may_count_from_the_other_eyes_first_frame(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "late.mkv", [0.7, 0.8, 0.9, 1.0])
    assert [frame.index for frame in VideoReader(path, start_s=0.1)] == [1, 2, 3]
    assert [frame.index for frame in VideoReader(path, start_s=0.1, origin_s=0.8)] == [2, 3]


def test_a_reader_can_be_run_through_again_and_left_early(tmp_path: Path, film: Film, number_in: NumberIn) -> None:
    reader = VideoReader(film(tmp_path / "film.mp4", EVEN_S))
    first = next(iter(reader))
    assert (first.index, first.time_s) == (0, 0.0)
    assert seen(reader, number_in) == seen(reader, number_in)


@pytest.mark.parametrize("flip", [(False, False), (True, False)])
@pytest.mark.parametrize("degrees", [0, 90, 180, 270])
def test_frames_stand_upright(tmp_path: Path, film: Film, degrees: int, flip: tuple[bool, bool]) -> None:
    stored = np.zeros((48, 64, 3), np.uint8)
    stored[:24, :32], stored[:24, 32:], stored[24:, :32] = 220, 150, 80
    reader = VideoReader(film(tmp_path / "turned.mp4", [0.0, 0.1], images=[stored] * 2, rotation=(degrees, *flip)))
    turned = np.rot90(stored, degrees // 90)  # counterclockwise, as the film's metadata counts
    wanted = turned[:, ::-1] if flip[0] else turned
    for frame in reader:
        assert frame.image.shape == wanted.shape
        assert np.abs(frame.image.astype(int) - wanted).mean() < 5
    assert (reader.width_px, reader.height_px) == (wanted.shape[1], wanted.shape[0])
    assert any("rotated upright" in note for note in reader.notes) == (degrees != 0 or flip[0])


def test_an_odd_angle_of_rotation_is_left_alone(tmp_path: Path, film: Film) -> None:
    reader = VideoReader(film(tmp_path / "askew.mp4", [0.0, 0.1], rotation=(30, False, False)))
    assert (reader.width_px, reader.height_px, reader.notes) == (64, 48, ())


def test_pixels_that_are_not_square_are_told(tmp_path: Path, film: Film) -> None:
    reader = VideoReader(film(tmp_path / "wide.mp4", [0.0, 0.1], aspect=Fraction(4, 3)))
    assert reader.width_px == 64
    assert "not square" in reader.notes[0]


def test_a_stream_without_times_runs_at_its_nominal_rate(tmp_path: Path, film: Film, number_in: NumberIn) -> None:
    reader = VideoReader(film(tmp_path / "film.h264", EVEN_S))
    interval_s = 1 / reader.fps
    assert seen(reader, number_in) == [(n, round(n * interval_s, 3), n) for n in range(40)]


def test_avi_with_b_frames_is_in_order(tmp_path: Path, film: Film, number_in: NumberIn) -> None:
    reader = VideoReader(film(tmp_path / "film.avi", EVEN_S))
    assert seen(reader, number_in) == [(n, n / 10, n) for n in range(40)]


def test_repeated_and_backward_times_are_left_out(tmp_path: Path, film: Film, number_in: NumberIn) -> None:
    path = film(tmp_path / "film.avi", EVEN_S[:8], codec="mjpeg")
    retimed = retimed_copy(path, tmp_path / "film.mkv", [0, 100, 200, 200, 150, 300, 400, 500])
    reader = VideoReader(retimed)
    assert [(time_s, number) for _, time_s, number in seen(reader, number_in)] == [
        (0.0, 0),
        (0.1, 1),
        (0.2, 2),
        (0.3, 5),
        (0.4, 6),
        (0.5, 7),
    ]
    assert reader.notes == (f"{retimed}: 2 frames with a repeated or backward timestamp left out.",)


def retimed_copy(path: Path, copy: Path, stamps_ms: list[int]) -> Path:
    """The same packets under other timestamps."""
    import av

    with av.open(str(path)) as source, av.open(str(copy), "w") as target:
        stream = target.add_stream_from_template(source.streams.video[0])
        packets = [packet for packet in source.demux(video=0) if packet.size]
        for number, (packet, stamp_ms) in enumerate(zip(packets, stamps_ms, strict=True)):
            packet.stream, packet.time_base = stream, Fraction(1, 1000)
            packet.pts, packet.dts = stamp_ms, number - 8
            target.mux_one(packet)
    return copy


def test_missing_file_is_named() -> None:
    with pytest.raises(VideoError, match=r"nowhere/left.mp4: there is no such file or folder"):
        VideoReader(Path("nowhere/left.mp4"))


def test_empty_file(tmp_path: Path) -> None:
    path = tmp_path / "empty.mp4"
    path.touch()
    with pytest.raises(VideoError, match=r"empty.mp4: the file is empty"):
        VideoReader(path)


@pytest.mark.parametrize("name", ["notes.txt", "left.mp4"])
def test_text_is_no_video(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    path.write_text("0 0 Car 0 0 -1.57 614.24 181.78 727.31 284.77\n" * 40, encoding="ascii")
    with pytest.raises(VideoError, match=rf"{name}: (holds no video|not a video)"):
        VideoReader(path)


def test_sound_is_no_video(tmp_path: Path) -> None:
    path = tmp_path / "sound.wav"
    with wave.open(str(path), "wb") as sound:
        sound.setparams((1, 2, 8000, 0, "NONE", ""))
        sound.writeframes(bytes(16_000))
    with pytest.raises(VideoError, match=r"sound.wav: holds no video"):
        VideoReader(path)


def test_an_unknown_codec_is_no_video(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S[:5])
    path.write_bytes(path.read_bytes().replace(b"avc1", b"zzz1"))
    with pytest.raises(VideoError, match=r"film.mp4: holds no video"):
        VideoReader(path)


def test_one_image_is_no_video(tmp_path: Path) -> None:
    import cv2

    path = tmp_path / "000000.png"
    cv2.imwrite(str(path), np.zeros((8, 8, 3), np.uint8))
    with pytest.raises(VideoError, match=r"000000.png: a single image; name .*the folder"):
        VideoReader(path)


def test_a_path_that_cannot_be_looked_at(tmp_path: Path) -> None:
    path = tmp_path / "loop.mp4"
    path.symlink_to(path)
    with pytest.raises(VideoError, match=r"loop.mp4: cannot be read \(.*symbolic links\)"):
        VideoReader(path)


@pytest.mark.skipif(os.geteuid() == 0, reason="the superuser may read everything")
def test_a_file_without_permission(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S[:3])
    path.chmod(0)
    with pytest.raises(VideoError, match=r"film.mp4: cannot be read \(Permission denied\)"):
        VideoReader(path)


def test_a_file_that_goes_away_between_two_readings(tmp_path: Path, film: Film) -> None:
    reader = VideoReader(film(tmp_path / "film.mp4", EVEN_S[:3]))
    assert len(list(reader)) == 3
    reader.path.unlink()
    with pytest.raises(VideoError, match=r"film.mp4: cannot be read \(No such file"):
        next(iter(reader))


def test_a_start_beyond_the_end(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S)
    with pytest.raises(VideoError, match=r"no frame from 4.00 s on, where its own time starts at 0.00 s"):
        list(VideoReader(path, start_s=4.0))
    with pytest.raises(VideoError, match=r"no frame from 0.02 s to 0.07 s"):
        list(VideoReader(path, start_s=0.02, duration_s=0.05))


def test_images_that_change_size(tmp_path: Path, film: Film, level: Callable[..., np.ndarray]) -> None:
    small = film(tmp_path / "small.ts", EVEN_S[:10])
    wide = film(
        tmp_path / "wide.ts", [5 + t for t in EVEN_S[:10]], images=[level(n, width_px=96) for n in range(10)], gop=1
    )
    path = tmp_path / "both.ts"
    path.write_bytes(small.read_bytes() + wide.read_bytes())
    frames = iter(VideoReader(path))
    with pytest.raises(VideoError, match=r"both.ts: its images change from 64x48 to 96x48 after \d+ frames"):
        [next(frames) for _ in range(11)]


def test_an_mp4_without_its_index_cannot_be_opened(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S)
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    with pytest.raises(VideoError, match=r"film.mp4: an MP4 without its index, so cut short"):
        VideoReader(path)


def test_nothing_decodes(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.mp4", EVEN_S[:10], options={"movflags": "faststart"})
    stored = path.read_bytes()
    media = stored.index(b"mdat") + 4
    path.write_bytes(stored[:media] + bytes(len(stored) - media))
    with pytest.raises(VideoError, match=r"film.mp4: no frame of this video can be decoded"):
        VideoReader(path)


FRAGMENTED = {"movflags": "frag_keyframe+empty_moov+default_base_moof"}


@pytest.mark.parametrize(
    ("suffix", "options"), [("mp4", {"movflags": "faststart"}), ("mp4", FRAGMENTED), ("mkv", {}), ("avi", {})]
)
def test_a_file_cut_in_half_is_used_as_far_as_it_goes(
    tmp_path: Path, film: Film, number_in: NumberIn, suffix: str, options: dict[str, str]
) -> None:
    path = film(tmp_path / f"film.{suffix}", EVEN_S, images=noisy_images(40), options=options)
    whole = [frame.time_s for frame in VideoReader(path)]
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    reader = VideoReader(path)
    frames = [(frame.index, frame.time_s) for frame in reader]
    assert 10 <= len(frames) <= 30
    assert frames == list(enumerate(whole))[: len(frames)]
    # A fragmented file does not say how long it was to be, and FFmpeg's threads may or may not try its torn last frame.
    told = (f"reading ended after {len(frames)} frames", "1 damaged frame left out")
    assert any(words in note for words in told for note in reader.notes)


def test_a_transport_stream_cut_in_half_just_ends(tmp_path: Path, film: Film) -> None:
    path = film(tmp_path / "film.ts", EVEN_S, images=noisy_images(40))
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
    assert 10 <= len(list(VideoReader(path))) <= 30  # such a file does not say how long it was to be


@pytest.mark.parametrize("suffix", ["mp4", "avi", "mkv", "ts"])
def test_garbage_in_the_middle_costs_a_few_frames(tmp_path: Path, film: Film, suffix: str) -> None:
    path = film(tmp_path / f"film.{suffix}", EVEN_S, images=noisy_images(40))
    whole = {frame.index: frame.time_s for frame in VideoReader(path)}
    stored = bytearray(path.read_bytes())
    middle = len(stored) // 2
    stored[middle : middle + 600] = np.random.default_rng(0).integers(0, 256, 600, np.uint8).tobytes()
    path.write_bytes(stored)
    reader = VideoReader(path)
    frames = [(frame.index, frame.time_s) for frame in reader]
    if suffix == "ts":  # its packets have no checksum: x264's threads lay them anew each time, and some hits go unseen
        assert 30 <= len(frames) <= 41
        assert [time_s for _, time_s in frames] == sorted({time_s for _, time_s in frames})
        return
    assert 30 <= len(frames) < 40
    if suffix == "mkv":  # whole packets are lost there without a trace but the step of time
        assert "1 gap in its times" in reader.notes[0]
        assert [time_s for _, time_s in frames] == sorted({time_s for _, time_s in frames} & set(whole.values()))
    elif suffix == "avi":  # here neither, for want of times; what follows moves up
        assert [time_s for _, time_s in frames] == list(whole.values())[: len(frames)]
    else:
        assert dict(frames).items() <= whole.items()  # what is left keeps its index and its time
        assert reader.notes == (f"{path}: {40 - len(frames)} damaged frame left out.",)


def test_reading_ends_where_the_file_cannot_be_read_on(tmp_path: Path) -> None:
    images = [b"FRAME\n" + bytes([level]) * (16 * 16 * 3 // 2) for level in range(40, 50)]
    images[6] = b"GARBAGE" * 40
    path = tmp_path / "film.y4m"
    path.write_bytes(b"YUV4MPEG2 W16 H16 F10:1 C420jpeg\n" + b"".join(images))
    reader = VideoReader(path)
    assert [frame.index for frame in reader] == [0, 1, 2, 3, 4, 5]
    assert reader.notes == (
        f"{path}: reading ended after 6 frames, at 0.60 s: the file is damaged or cut short there (Invalid data found "
        "when processing input).",
    )


def noisy_images(n: int) -> list[np.ndarray]:
    """Images that take some bytes to encode, so that damage hits them."""
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
    reader = VideoReader(shared_data / name)
    times_s = []
    for number, frame in enumerate(reader):
        assert frame.index == number
        assert frame.image.shape == (reader.height_px, reader.width_px, 3)
        times_s.append(frame.time_s)
    assert times_s == pytest.approx([number / fps for number in range(n)])
    assert (reader.n_frames, reader.fps, reader.is_grey, reader.notes) == (n, fps, False, ())


def test_real_grey_video(shared_data: Path) -> None:
    reader = VideoReader(shared_data / "kitti_odometry/gray51/left.mp4")
    assert (reader.width_px, reader.height_px, reader.n_frames, reader.is_grey) == (1226, 370, 51, True)

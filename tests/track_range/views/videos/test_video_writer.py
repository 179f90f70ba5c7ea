from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

import track_range.views.videos.video_writer as video_writer
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoError
from track_range.views.videos.video_writer import VideoWriter

UNEVEN_S = [0.0, 0.1, 0.21, 0.3, 0.75, 0.8, 1.4, 1.5, 2.9, 3.0]


def write(path: Path, images: list[np.ndarray], times_s: list[float], **options: int) -> None:
    height_px, width_px = images[0].shape[:2]
    with VideoWriter(path, width_px=width_px, height_px=height_px, fps=10.0, **options) as writer:
        for image, time_s in zip(images, times_s, strict=True):
            writer.write(image, time_s)


def test_round_trip_of_images_and_times(tmp_path: Path, level: Callable[..., np.ndarray]) -> None:
    write(tmp_path / "out.mp4", [level(number) for number in range(10)], UNEVEN_S)
    frames = list(open_video(tmp_path / "out.mp4"))
    assert [frame.time_s for frame in frames] == pytest.approx(UNEVEN_S, abs=1e-5)
    for number, frame in enumerate(frames):
        assert np.abs(frame.image.astype(int) - level(number)).max() <= 2


def test_times_count_from_the_first_image(tmp_path: Path, level: Callable[..., np.ndarray]) -> None:
    write(tmp_path / "out.mp4", [level(0), level(1)], [1_317_042_651.25, 1_317_042_651.35])
    assert [frame.time_s for frame in open_video(tmp_path / "out.mp4")] == pytest.approx(
        [0.0, 0.1], abs=1e-5
    )


def test_round_trip_of_colours(tmp_path: Path) -> None:
    colours = [(0, 0, 255), (0, 255, 0), (255, 0, 0), (0, 255, 255), (30, 120, 200)]
    images = [np.full((32, 32, 3), colour, np.uint8) for colour in colours]
    write(tmp_path / "out.mp4", images, [number / 10 for number in range(5)], crf=1)
    for colour, frame in zip(colours, open_video(tmp_path / "out.mp4"), strict=True):
        assert np.abs(frame.image.astype(int) - colour).max() <= 6


@pytest.mark.parametrize(("width_px", "height_px"), [(63, 48), (64, 47), (63, 47)])
def test_odd_sizes_are_extended(tmp_path: Path, width_px: int, height_px: int) -> None:
    image = np.zeros((height_px, width_px, 3), np.uint8)
    image[:, -1], image[-1] = 200, 200
    write(tmp_path / "out.mp4", [image, image], [0.0, 0.1], crf=1)
    frame = next(iter(open_video(tmp_path / "out.mp4")))
    assert frame.image.shape == (48, 64, 3)
    assert np.abs(frame.image[:height_px, :width_px].astype(int) - image).max() <= 8
    assert frame.image[:, -1].min() > 190 or width_px == 64
    assert frame.image[-1].min() > 190 or height_px == 48


def test_larger_quantizer_gives_smaller_files(tmp_path: Path) -> None:
    rng = np.random.default_rng(4)
    images = [rng.integers(0, 255, (64, 64, 3), np.uint8) for _ in range(3)]
    sizes = []
    for quantizer in (10, 28, 45):
        write(tmp_path / "out.mp4", images, [0.0, 0.1, 0.2], quantizer=quantizer)
        sizes.append((tmp_path / "out.mp4").stat().st_size)
    assert sizes[0] > 1.5 * sizes[1] > 3 * sizes[2]


def test_h264_with_a_keyframe_every_second(
    tmp_path: Path, level: Callable[..., np.ndarray]
) -> None:
    write(
        tmp_path / "out.mp4",
        [level(number) for number in range(40)],
        [number / 10 for number in range(40)],
    )
    with av.open(str(tmp_path / "out.mp4")) as container:
        stream = container.streams.video[0]
        assert (stream.codec_context.name, stream.codec_context.pix_fmt) == ("h264", "yuv420p")
        assert stream.codec_context.colorspace == 5
        packets = [packet for packet in container.demux(stream) if packet.size]
        assert all(packet.pts == packet.dts for packet in packets)
        keys_s = [float(packet.pts * packet.time_base) for packet in packets if packet.is_keyframe]
    assert keys_s == pytest.approx([0.0, 1.0, 2.0, 3.0])


def test_keyframes_at_low_frame_rates(tmp_path: Path, level: Callable[..., np.ndarray]) -> None:
    times_s = [0.0, 0.4, 1.1, 1.5, 5.0, 5.5]
    write(tmp_path / "out.mp4", [level(number) for number in range(6)], times_s)
    with av.open(str(tmp_path / "out.mp4")) as container:
        keys = [packet.is_keyframe for packet in container.demux(video=0) if packet.size]
    assert keys == [True, False, True, False, True, False]


KILLED = """
import os, signal, sys
import numpy as np
from pathlib import Path
from track_range.views.videos.video_writer import VideoWriter
writer = VideoWriter(Path(sys.argv[1]), width_px=64, height_px=48, fps=10.0)
for number in range(35):
    writer.write(np.full((48, 64, 3), 24 + 4 * number, np.uint8), number / 10)
os.kill(os.getpid(), signal.SIGKILL)
"""


def test_killed_process_leaves_a_playable_file(
    tmp_path: Path, number_in: Callable[[np.ndarray], int]
) -> None:
    path = tmp_path / "out.mp4"
    project = Path(video_writer.__file__).parents[1]
    ended = subprocess.run(
        [sys.executable, "-c", KILLED, str(path)],
        check=False,
        env={**os.environ, "PYTHONPATH": str(project)},
    )
    assert ended.returncode == -signal.SIGKILL
    frames = [
        (frame.index, round(frame.time_s, 3), number_in(frame.image)) for frame in open_video(path)
    ]
    assert len(frames) == 34  # the muxer holds the last frame
    assert frames == [(number, number / 10, number) for number in range(len(frames))]


def test_file_is_readable_while_written(tmp_path: Path, level: Callable[..., np.ndarray]) -> None:
    path = tmp_path / "out.mp4"
    with VideoWriter(path, width_px=64, height_px=48, fps=10.0) as writer:
        for number in range(21):
            writer.write(level(number), number / 10)
        assert len(list(open_video(path))) == 20
    assert len(list(open_video(path))) == 21


def test_close_without_images(tmp_path: Path) -> None:
    writer = VideoWriter(tmp_path / "out.mp4", width_px=64, height_px=48, fps=10.0)
    writer.close()
    writer.close()
    assert (tmp_path / "out.mp4").exists()


def test_times_must_increase(tmp_path: Path, level: Callable[..., np.ndarray]) -> None:
    with VideoWriter(tmp_path / "out.mp4", width_px=64, height_px=48, fps=10.0) as writer:
        writer.write(level(0), 5.0)
        for time_s in (5.0, 4.9):
            with pytest.raises(ValueError, match=r"time_s"):
                writer.write(level(1), time_s)
        writer.write(level(1), 5.1)
    assert len(list(open_video(tmp_path / "out.mp4"))) == 2


def test_times_closer_than_a_tick_still_increase(
    tmp_path: Path, level: Callable[..., np.ndarray]
) -> None:
    write(tmp_path / "out.mp4", [level(number) for number in range(3)], [0.0, 1e-7, 2e-7])
    with av.open(str(tmp_path / "out.mp4")) as container:
        stamps = [
            packet.pts * packet.time_base for packet in container.demux(video=0) if packet.size
        ]
    assert stamps == [Fraction(number, 90_000) for number in range(3)]


def test_another_shape_is_an_error(tmp_path: Path, level: Callable[..., np.ndarray]) -> None:
    writer = VideoWriter(tmp_path / "out.mp4", width_px=64, height_px=48, fps=10.0)
    with writer, pytest.raises(ValueError, match=r"image: expected shape"):
        writer.write(level(0, width_px=60), 0.0)


def test_write_after_close_is_an_error(tmp_path: Path, level: Callable[..., np.ndarray]) -> None:
    writer = VideoWriter(tmp_path / "out.mp4", width_px=64, height_px=48, fps=10.0)
    writer.close()
    with pytest.raises(ValueError, match=r"out.mp4: .*closed"):
        writer.write(level(0), 0.0)


def test_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(VideoError, match=r"nowhere/out.mp4: .*written"):
        VideoWriter(tmp_path / "nowhere" / "out.mp4", width_px=64, height_px=48, fps=10.0)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs a device that is always full")
def test_full_disk() -> None:
    images = list(np.random.default_rng(1).integers(0, 256, (30, 48, 64, 3), np.uint8))
    with pytest.raises(VideoError, match=r"/dev/full: .*written"):
        write(Path("/dev/full"), images, [number / 10 for number in range(30)])


def test_missing_encoder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(video_writer, "_ENCODER", "libx264_of_another_build")
    with pytest.raises(VideoError, match=r"libx264_of_another_build: .*encoder"):
        VideoWriter(tmp_path / "out.mp4", width_px=64, height_px=48, fps=10.0)


@pytest.mark.parametrize("height_px", [46, 48])  # not and a multiple of 4
def test_rows_of_all_heights(tmp_path: Path, height_px: int) -> None:
    image = np.full((height_px, 64, 3), (200, 60, 60), np.uint8)
    image[height_px // 2 :] = (60, 60, 200)
    write(tmp_path / "out.mp4", [image], [0.0])
    (frame,) = open_video(tmp_path / "out.mp4")
    off = np.abs(frame.image.astype(int) - image).max(axis=(1, 2))
    assert set(np.flatnonzero(off > 12)) <= {22, 23}  # two rows have one colour


def test_psnr_of_real_frames(shared_data: Path, tmp_path: Path) -> None:
    images = [
        frame.image for frame in open_video(shared_data / "kitti_stereo" / "0003" / "left.mp4")
    ]
    write(tmp_path / "out.mp4", images, [number / 10 for number in range(16)])
    errors = [
        np.square(frame.image.astype(float) - image).mean()
        for frame, image in zip(open_video(tmp_path / "out.mp4"), images, strict=True)
    ]
    psnr_db = 10 * np.log10(255**2 / np.mean(errors))
    assert 30 < psnr_db < 40
    assert (tmp_path / "out.mp4").stat().st_size < 16 * 100_000

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.recording.recording import open_recording
from track_range.recording.sources.open_video import open_video
from track_range.recording.video.frame import VideoError

Level = Callable[..., np.ndarray]
NumberIn = Callable[[np.ndarray], int]


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    path = tmp_path / "image_02" / "data"
    path.mkdir(parents=True)
    return path


def fill(folder: Path, level: Level, numbers: list[int], *, name: str = "{:06d}.png") -> None:
    for number in numbers:
        cv2.imwrite(str(folder / name.format(number)), level(number))


def stamp(folder: Path, seconds: list[str]) -> Path:
    path = folder.parent / "timestamps.txt"
    path.write_text("".join(f"2011-09-26 13:10:{second}\n" for second in seconds), encoding="ascii")
    return path


def test_images_are_sorted_by_number(folder: Path, level: Level, number_in: NumberIn) -> None:
    fill(folder, level, [10, 9, 8, 11], name="left2_{}.png")
    (folder / "cover.png").write_bytes(b"no number")
    (folder / "._left2_12.png").write_bytes(b"hidden")
    (folder / "calib_7.txt").write_text("no image", encoding="ascii")
    reader = open_video(folder)
    frames = [(frame.index, round(frame.time_s, 6), number_in(frame.image)) for frame in reader]
    assert frames == [(0, 0.8, 8), (1, 0.9, 9), (2, 1.0, 10), (3, 1.1, 11)]
    assert (reader.width_px, reader.height_px, reader.fps, reader.n_frames) == (64, 48, 10.0, 4)
    (note,) = reader.notes
    assert note.startswith(f"{folder}: the images have no times; 10 frames/s are assumed")
    assert reader.is_grey


def test_missing_number_is_a_dropped_frame(folder: Path, level: Level) -> None:
    fill(folder, level, [3, 4, 7, 8])
    reader = open_video(folder, folder_fps=20.0)
    assert [(frame.index, round(frame.time_s, 6)) for frame in reader] == [
        (0, 0.15),
        (1, 0.2),
        (4, 0.35),
        (5, 0.4),
    ]
    (note,) = reader.notes
    assert note.startswith(f"{folder}: 2 numbers")


def test_numbers_that_may_be_milliseconds(folder: Path, level: Level) -> None:
    for number in (0, 33, 66, 100, 133, 200):
        cv2.imwrite(str(folder / f"{number:06d}.png"), level(number // 33))
    with pytest.raises(VideoError, match=r"increase by 33 .*30\.3 images/s.*--fps"):
        open_recording(folder, focal_px=50.0)
    reader = open_video(folder, fps=30.0)
    assert [frame.index for frame in reader] == [0, 33, 66, 100, 133, 200]
    steps = np.diff([frame.time_s for frame in reader]) * 30
    assert steps == pytest.approx([1, 1, 1, 1, 2], abs=0.05)
    assert "so that 30 frames/s is the rate of the images" in reader.notes[-1]
    assert any("1 number is missing" in note for note in reader.notes)


def test_part_of_a_folder(folder: Path, level: Level) -> None:
    fill(folder, level, list(range(2, 12)))
    reader = open_video(folder, start_s=0.3, duration_s=0.4)
    assert [frame.index for frame in reader] == [3, 4, 5, 6]
    assert reader.n_frames == 4
    with pytest.raises(VideoError, match=r"data: .*1\.20 s.*0\.20 s"):
        list(open_video(folder, start_s=1.0))


@pytest.mark.parametrize("beside", [True, False])
def test_kitti_timestamps_are_used(folder: Path, level: Level, beside: bool) -> None:
    fill(folder, level, [0, 1, 2, 3])
    path = stamp(folder, ["51.168593664", "51.272099072", "51.375610368", "51.582000000"])
    if not beside:
        path = path.rename(folder / path.name)
    reader = open_video(folder)
    times_s = [frame.time_s for frame in reader]
    assert np.diff(times_s) == pytest.approx([0.103505408, 0.103511296, 0.206389632], abs=1e-6)
    assert times_s[0] == pytest.approx(1_317_042_651.168593664, abs=1e-6)  # 2011-09-26 13:10:51 UTC
    assert reader.fps == pytest.approx(1 / 0.103511296, rel=1e-5)
    (note,) = reader.notes
    assert note.startswith(f"{path}: ")


def test_backward_timestamps_are_skipped(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1, 2, 3])
    stamp(folder, ["51.1", "51.2", "51.2", "51.3"])
    reader = open_video(folder)
    assert [frame.index for frame in reader] == [0, 1, 3]
    assert reader.notes[-1].startswith(f"{folder}: skipped 1 image ")


def test_timestamps_of_another_recording_are_not_used(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1])
    path = stamp(folder, ["51.1", "51.2", "51.3"])
    reader = open_video(folder, fps=10.0)
    assert [frame.time_s for frame in reader] == [0.0, 0.1]
    (note,) = reader.notes
    assert note.startswith(f"{path}: ignored")


@pytest.mark.parametrize(
    "text", ["0.0\nnone\n", "0.1\n0.1\n", "2011-09-26 13:10:51.1\n2011-13-99 13:10:51.2\n"]
)
def test_invalid_timestamps_are_not_used(folder: Path, level: Level, text: str) -> None:
    fill(folder, level, [0, 1])
    path = folder / "timestamps.txt"
    path.write_text(text, encoding="ascii")
    reader = open_video(folder, fps=10.0)
    assert [frame.time_s for frame in reader] == [0.0, 0.1]
    (note,) = reader.notes
    assert note.startswith(f"{path}: ignored")


def test_frame_rate_of_one_image_with_a_timestamp(folder: Path, level: Level) -> None:
    fill(folder, level, [0])
    stamp(folder, ["51.1"])
    assert open_video(folder, folder_fps=15).fps == 15


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "tiff", "webp", "pgm", "JPEG"])
def test_image_formats(folder: Path, level: Level, number_in: NumberIn, suffix: str) -> None:
    for number in (0, 1):
        image = level(number)
        stored = cv2.imencode(f".{suffix}", image[..., 0] if suffix == "pgm" else image)[1]
        (folder / f"{number}.{suffix}").write_bytes(stored.tobytes())
    assert [number_in(frame.image) for frame in open_video(folder)] == [0, 1]


def test_16_bit_images_keep_the_upper_8_bits(folder: Path) -> None:
    stored = np.array([[0, 255, 256, 65_535] * 2], np.uint16).repeat(8, axis=0)
    cv2.imwrite(str(folder / "0.png"), stored)
    (frame,) = open_video(folder)
    assert frame.image.dtype == np.uint8
    assert frame.image[0, :4].tolist() == [[0, 0, 0], [0, 0, 0], [1, 1, 1], [255, 255, 255]]


def test_colour_is_bgr_without_alpha(folder: Path) -> None:
    cv2.imwrite(str(folder / "0.png"), np.full((8, 8, 4), (10, 20, 200, 128), np.uint8))
    reader = open_video(folder)
    (frame,) = reader
    assert frame.image[0, 0].tolist() == [10, 20, 200]
    assert not reader.is_grey


def test_two_cameras_in_one_folder(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1], name="left_{}.png")
    fill(folder, level, [0, 1], name="right_{}.png")
    reader = open_video(folder)
    assert [frame.index for frame in reader] == [0, 1]
    assert f"--stereo {folder}" in reader.notes[0]


@pytest.mark.parametrize("stored", [b"", b"no image at all"])
def test_damaged_image(folder: Path, level: Level, stored: bytes) -> None:
    fill(folder, level, [0, 1, 2])
    (folder / "000001.png").write_bytes(stored)
    reader = open_video(folder, fps=10.0)
    for _ in range(2):  # each reading counts anew
        assert [(frame.index, round(frame.time_s, 6)) for frame in reader] == [(0, 0.0), (2, 0.2)]
        (note,) = reader.notes
        assert "skipped 1 unreadable image" in note
        assert "000001.png" in note


def test_damaged_first_images(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1, 2])
    for name in ("000000.png", "000001.png"):
        (folder / name).write_bytes((folder / name).read_bytes()[:60])
    reader = open_video(folder, fps=10.0)
    assert (reader.width_px, reader.height_px, reader.first_time_s) == (64, 48, pytest.approx(0.2))
    assert [frame.index for frame in reader] == [2]
    assert "skipped 2 unreadable images" in reader.notes[0]


@pytest.mark.parametrize(
    ("name", "images", "word"),
    [
        ("0.tiff", [np.zeros((8, 8, 3), np.float32)], "float32"),
        ("2.png", [np.zeros((48, width, 3), np.uint8) for width in (64, 64, 60)], "60x48"),
        ("0.png", [b"no image at all"] * 2, "damaged"),
        ("data", [], "numbered images"),
    ],
)
def test_unusable_images(
    folder: Path, name: str, images: list[np.ndarray | bytes], word: str
) -> None:
    (folder / "readme.txt").write_text("nothing", encoding="ascii")
    for number, image in enumerate(images):
        path = folder / f"{number}{Path(name).suffix}"
        if isinstance(image, bytes):
            path.write_bytes(image)
        else:
            cv2.imwrite(str(path), image)
    with pytest.raises(VideoError, match=rf"{name}: .*{word}"):
        list(open_video(folder))


def test_image_is_deleted_while_reading(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1])
    reader = open_video(folder)
    (folder / "000001.png").unlink()
    with pytest.raises(VideoError, match=r"000001.png: .*read"):
        list(reader)


def test_real_images(shared_data: Path) -> None:
    reader = open_video(shared_data / "kitti2015" / "image_2")
    frames = list(reader)
    assert len(frames) == reader.n_frames == 16
    assert all(frame.image.shape == (375, 1242, 3) for frame in frames)
    assert all(a.time_s < b.time_s for a, b in itertools.pairwise(frames))
    assert not reader.is_grey

from __future__ import annotations

import itertools
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.video.frame import VideoError
from track_range.video.reader import VideoReader

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


def test_images_come_by_number_not_by_name(folder: Path, level: Level, number_in: NumberIn) -> None:
    fill(folder, level, [10, 9, 8, 11], name="left2_{}.png")
    (folder / "cover.png").write_bytes(b"no number")
    (folder / "._left2_12.png").write_bytes(b"hidden")
    (folder / "calib_7.txt").write_text("no image", encoding="ascii")
    reader = VideoReader(folder)
    frames = [(frame.index, round(frame.time_s, 6), number_in(frame.image)) for frame in reader]
    assert frames == [(0, 0.8, 8), (1, 0.9, 9), (2, 1.0, 10), (3, 1.1, 11)]
    assert (reader.width_px, reader.height_px, reader.fps, reader.n_frames) == (64, 48, 10.0, 4)
    assert (reader.notes, reader.is_grey) == ((), True)


def test_a_missing_number_is_a_dropped_frame(folder: Path, level: Level) -> None:
    fill(folder, level, [3, 4, 7, 8])
    reader = VideoReader(folder, folder_fps=20.0)
    assert [(frame.index, round(frame.time_s, 6)) for frame in reader] == [(0, 0.15), (1, 0.2), (4, 0.35), (5, 0.4)]
    assert reader.notes == (
        f"{folder}: 2 numbers are missing between 000003.png and 000008.png; taken as dropped frames.",
    )


def test_a_part_of_a_folder(folder: Path, level: Level) -> None:
    fill(folder, level, list(range(2, 12)))
    reader = VideoReader(folder, start_s=0.3, duration_s=0.4)
    assert [frame.index for frame in reader] == [3, 4, 5, 6]
    assert reader.n_frames == 4
    with pytest.raises(VideoError, match=r"no frame from 1.20 s on, where its own time starts at 0.20 s"):
        list(VideoReader(folder, start_s=1.0))


@pytest.mark.parametrize("beside", [True, False])
def test_kitti_timestamps_are_used(folder: Path, level: Level, beside: bool) -> None:
    fill(folder, level, [0, 1, 2, 3])
    path = stamp(folder, ["51.168593664", "51.272099072", "51.375610368", "51.582000000"])
    if not beside:
        path = path.rename(folder / path.name)
    reader = VideoReader(folder)
    times_s = [frame.time_s for frame in reader]
    assert np.diff(times_s) == pytest.approx([0.103505408, 0.103511296, 0.206389632], abs=1e-6)
    assert times_s[0] == pytest.approx(1_317_042_651.168593664, abs=1e-6)  # 2011-09-26 13:10:51 UTC
    assert reader.fps == pytest.approx(1 / 0.103511296, rel=1e-5)
    assert reader.notes == (f"{path}: the times of {folder} are taken from it.",)


def test_timestamps_that_step_back_cost_their_images(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1, 2, 3])
    stamp(folder, ["51.1", "51.2", "51.2", "51.3"])
    reader = VideoReader(folder)
    assert [frame.index for frame in reader] == [0, 1, 3]
    assert reader.notes[-1] == f"{folder}: 1 image with a repeated or backward timestamp left out."


def test_timestamps_of_another_recording_are_not_used(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1])
    path = stamp(folder, ["51.1", "51.2", "51.3"])
    reader = VideoReader(folder)
    assert [frame.time_s for frame in reader] == [0.0, 0.1]
    assert reader.notes == (f"{path}: not used, since it has 3 lines for 2 images.",)


@pytest.mark.parametrize("text", ["0.0\n0.1\n", "2011-09-26 13:10:51.1\n2011-13-99 13:10:51.2\n"])
def test_timestamps_that_are_no_dates_are_not_used(folder: Path, level: Level, text: str) -> None:
    fill(folder, level, [0, 1])
    path = folder / "timestamps.txt"
    path.write_text(text, encoding="ascii")
    reader = VideoReader(folder)
    assert [frame.time_s for frame in reader] == [0.0, 0.1]
    assert reader.notes == (f"{path}: not used, since its lines are not all dates with times.",)


def test_one_stamped_image_keeps_the_rate_given(folder: Path, level: Level) -> None:
    fill(folder, level, [0])
    stamp(folder, ["51.1"])
    assert VideoReader(folder, folder_fps=15).fps == 15


@pytest.mark.parametrize("suffix", ["png", "jpg", "bmp", "tiff", "webp", "pgm", "JPEG"])
def test_the_usual_kinds_of_image(folder: Path, level: Level, number_in: NumberIn, suffix: str) -> None:
    for number in (0, 1):
        image = level(number)
        stored = cv2.imencode(f".{suffix}", image[..., 0] if suffix == "pgm" else image)[1]
        (folder / f"{number}.{suffix}").write_bytes(stored.tobytes())
    assert [number_in(frame.image) for frame in VideoReader(folder)] == [0, 1]


def test_sixteen_bits_keep_their_upper_eight(folder: Path) -> None:
    stored = np.array([[0, 255, 256, 65_535]], np.uint16).repeat(4, axis=0)
    cv2.imwrite(str(folder / "0.png"), stored)
    (frame,) = VideoReader(folder)
    assert frame.image.dtype == np.uint8
    assert frame.image[0].tolist() == [[0, 0, 0], [0, 0, 0], [1, 1, 1], [255, 255, 255]]


def test_colour_is_blue_green_red_and_transparency_is_left_out(folder: Path) -> None:
    cv2.imwrite(str(folder / "0.png"), np.full((4, 4, 4), (10, 20, 200, 128), np.uint8))
    reader = VideoReader(folder)
    (frame,) = reader
    assert frame.image[0, 0].tolist() == [10, 20, 200]
    assert not reader.is_grey


def test_a_folder_without_numbered_images(folder: Path) -> None:
    (folder / "readme.txt").write_text("nothing", encoding="ascii")
    with pytest.raises(VideoError, match=r"data: no numbered images in this folder"):
        VideoReader(folder)


def test_two_cameras_in_one_folder(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1], name="left_{}.png")
    fill(folder, level, [0, 1], name="right_{}.png")
    with pytest.raises(VideoError, match=r"left_0.png and right_0.png both have the number 0"):
        VideoReader(folder)


@pytest.mark.parametrize("stored", [b"", b"no image at all"])
def test_a_damaged_image_is_named(folder: Path, level: Level, stored: bytes) -> None:
    fill(folder, level, [0, 1, 2])
    (folder / "000001.png").write_bytes(stored)
    frames = iter(VideoReader(folder))
    assert next(frames).index == 0
    with pytest.raises(VideoError, match=r"000001.png: this image is damaged or of an unknown kind"):
        next(frames)


def test_a_damaged_first_image_is_found_at_once(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1])
    (folder / "000000.png").write_bytes((folder / "000000.png").read_bytes()[:60])
    with pytest.raises(VideoError, match=r"000000.png: this image is damaged"):
        VideoReader(folder)


def test_images_of_another_size(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1])
    cv2.imwrite(str(folder / "000002.png"), level(2, width_px=60))
    with pytest.raises(VideoError, match=r"000002.png: 60x48 pixels, but the first image has 64x48"):
        list(VideoReader(folder))


def test_pixels_that_are_no_whole_numbers(folder: Path) -> None:
    cv2.imwrite(str(folder / "0.tiff"), np.zeros((4, 4, 3), np.float32))
    with pytest.raises(VideoError, match=r"0.tiff: pixels of type float32: convert the images to 8 or 16 bits"):
        VideoReader(folder)


def test_an_image_that_goes_away(folder: Path, level: Level) -> None:
    fill(folder, level, [0, 1])
    reader = VideoReader(folder)
    (folder / "000001.png").unlink()
    with pytest.raises(VideoError, match=r"000001.png: cannot be read \(No such file or directory\)"):
        list(reader)


def test_real_images(shared_data: Path) -> None:
    reader = VideoReader(shared_data / "kitti2015" / "image_2")
    frames = list(reader)
    assert len(frames) == reader.n_frames == 16
    assert all(frame.image.shape == (375, 1242, 3) for frame in frames)
    assert all(a.time_s < b.time_s for a, b in itertools.pairwise(frames))
    assert not reader.is_grey

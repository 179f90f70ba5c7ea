"""Names of images in public data sets and of cameras: order, times, and left and right."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.recording.recording import open_recording
from track_range.recording.sources.files.image_names import named_images, stereo_images
from track_range.recording.sources.open_video import open_video

Level = Callable[..., np.ndarray]
NumberIn = Callable[[np.ndarray], int]


def touch(folder: Path, names: list[str]) -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    for name in names:
        (folder / name).write_bytes(b"")
    return folder


TIMES = (  # names in the order of time, and the seconds between them
    (
        ["1403636579763555584.png", "1403636579813555456.png", "1403636579863555584.png"],
        [0.04999987, 0.05000013],
    ),
    (
        [
            "n015-2018-07-24-11-22-45+0800__CAM_FRONT__1532402927612460.jpg",
            "n015-2018-07-24-11-22-45+0800__CAM_FRONT__1532402928112460.jpg",
        ],
        [0.5],
    ),
    (
        ["1305031102.175304.png", "1305031102.211214.png", "1305031102.243211.png"],
        [0.03591, 0.031997],
    ),
    # no zeros
    (
        ["1305031102.75304.png", "1305031102.111214.png", "1305031102.143211.png"],
        [0.03591, 0.031997],
    ),
    (["1532402927612.jpg", "1532402927712.jpg", "1532402927812.jpg"], [0.1, 0.1]),
    (["1532402927.jpg", "1532402928.jpg"], [1.0]),
    # ns since the start
    (["img_35123456789.png", "img_35173456789.png", "img_35223456789.png"], [0.05, 0.05]),
    (["2026-01-31T14-25-30.900.png", "2026-01-31T14-25-31.000.png"], [0.1]),
    (["20260131_142530_900.png", "20260131_142531_000.png", "20260131_142531_100.png"], [0.1, 0.1]),
    (
        [
            "2018-07-11-14-48-52_2018-07-11-15-33-43-123.jpg",
            "2018-07-11-14-48-52_2018-07-11-15-33-43-223.jpg",
        ],
        [0.1],
    ),
)


@pytest.mark.parametrize(("names", "steps_s"), TIMES)
def test_times_in_names(tmp_path, names, steps_s):
    images, times_s, notes, *_ = named_images(touch(tmp_path / "a", names))
    assert [path.name for _, path in images] == names
    assert [number for number, _ in images] == list(range(len(names)))
    assert np.diff(times_s) == pytest.approx(steps_s, abs=1e-6)
    assert notes == []


MORE_TIMES = (
    # ApolloScape: year of two digits
    (["180116_053947100_Camera_5.jpg", "180116_053947133_Camera_5.jpg"], [0.033]),
    (["f_14-25-59.950.png", "f_14-26-00.000.png", "f_14-26-00.050.png"], [0.05, 0.05]),
    (["142559950.jpg", "142600000.jpg"], [0.05]),
    (["235959950.jpg", "000000000.jpg"], [0.05]),  # midnight
    (["1403636579_963555584.png", "1403636580_013555456.png"], [0.04999987]),
    (["00-00-59.950.png", "00-01-00.000.png"], [0.05]),
    (["2026-01-31_14-25-59.9.png", "2026-01-31_14-26-00.0.png"], [0.1]),
    (["vlcsnap-2026-01-31-14h25m59s900.png", "vlcsnap-2026-01-31-14h26m00s000.png"], [0.1]),
    (["f_66.667.png", "f_100.000.png", "f_133.333.png"], [0.033333, 0.033333]),  # ms
)


@pytest.mark.parametrize(("names", "steps_s"), MORE_TIMES)
def test_short_dates_and_times_of_day(tmp_path, names, steps_s):
    images, times_s, _, *_ = named_images(touch(tmp_path / "a", names))
    assert [path.name for _, path in images] == names
    assert np.diff(times_s) == pytest.approx(steps_s, abs=1e-6)


@pytest.mark.parametrize("step", [1, 33])
def test_counters_are_no_times_of_day(tmp_path, step):
    names = [f"{number * step:09d}.png" for number in range(20)]
    assert named_images(touch(tmp_path / "a", names)).times_s is None


@pytest.mark.parametrize(
    ("prefix", "digits", "step"),
    [("20260131_142530_", 6, 1), ("20260131_142530_", 3, 1), ("cam0.", 4, 1), ("", 9, 10)],
)
def test_counters_behind_dates_and_points(tmp_path, prefix, digits, step):
    names = [f"{prefix}{number:0{digits}d}.png" for number in range(0, 20 * step, step)]
    names = [name.replace("0000", "0012", 1) for name in names] if not prefix else names
    images, times_s, *_ = named_images(touch(tmp_path / "a", names))
    assert times_s is None
    assert np.diff([number for number, _ in images]) == pytest.approx(step)


NUMBERS = (  # names in their order, and the frame numbers
    (["0000000007.png", "0000000008.png", "0000000011.png"], [7, 8, 11]),  # KITTI raw
    (["aachen_000000_000019_leftImg8bit.png", "aachen_000001_000019_leftImg8bit.png"], [0, 1]),
    (
        [
            "stuttgart_00_000000_000009_leftImg8bit.png",
            "stuttgart_00_000000_000010_leftImg8bit.png",
        ],
        [9, 10],
    ),
    (["000000_10.png", "000001_10.png", "000002_10.png"], [0, 1, 2]),  # KITTI 2015
    (["000000_10.png", "000000_11.png", "000001_10.png"], None),  # both of its images
    (["frame9.png", "frame10.png", "frame11.png"], [9, 10, 11]),
    (["a_2_x.png", "b_10_x.png"], [2, 10]),
    (["1_1000.png", "2_900.png", "3_950.png"], [1, 2, 3]),
    (["1.png", "550000000.png"], None),
    (["20260131_0001.png", "20260131_0002.png"], [1, 2]),
)


@pytest.mark.parametrize(("names", "numbers"), NUMBERS)
def test_numbers_in_names(tmp_path, names, numbers):
    images, times_s, notes, *_ = named_images(touch(tmp_path / "a", names))
    assert times_s is None
    assert [path.name for _, path in images] == names
    assert [number for number, _ in images] == (numbers or list(range(len(names))))
    assert any("--fps." in note for note in notes) == (numbers is None)
    assert not any("549" in note for note in notes)


@pytest.mark.parametrize(
    ("name", "text", "steps_s"),
    [
        ("times.txt", "0.000000e+00\n1.036740e-01\n2.074500e-01\n", [0.103674, 0.103776]),
        ("times.txt", "0\n33\n67\n", [0.033, 0.034]),  # ms
        ("times.txt", "16.667\n33.333\n50.0\n", [0.016666, 0.016667]),  # ms
        ("timestamps.txt", "0\n100000\n200000\n", [0.1, 0.1]),  # us
        ("timestamps.txt", "1403636579763555584\n1403636579813555456\n1403636579863555584\n", [0.05, 0.05]),
        ("data.csv", "#timestamp [ns],filename\n1403636579763555584,2.png\n1403636579813555584,1.png\n"
         "1403636579873555584,0.png\n1403636579973555584,9.png\n", [-0.06, -0.05]),
        ("rgb.txt", "# timestamp filename\n1.5 rgb/0.png\n1.75 rgb/1.png\n2.5 rgb/2.png\n", [0.25, 0.75]),
    ],
)  # fmt: skip
@pytest.mark.parametrize("is_beside", [True, False])
def test_files_of_times(tmp_path, name, text, steps_s, is_beside):
    folder = touch(tmp_path / "rgb", ["0.png", "1.png", "2.png"])
    (tmp_path if is_beside else folder).joinpath(name).write_text(text)
    _, times_s, notes, clock, is_local = named_images(folder)
    assert np.diff(times_s) == pytest.approx(steps_s, abs=1e-6)
    assert (name in notes[0], clock, is_local) == (True, name, False)


LEFT_RIGHT = (
    ("left_{:04d}.png", "right_{:04d}.png"),
    ("{:04d}_L.png", "{:04d}_R.png"),
    ("cam0_{:04d}.png", "cam1_{:04d}.png"),
    ("{:04d}_image_2.png", "{:04d}_image_3.png"),
    ("road_l_cam0_{:04d}.png", "road_l_cam1_{:04d}.png"),
    ("l{:d}.png", "r{:d}.png"),
    ("{:d}L.png", "{:d}R.png"),
    ("image_2/{:04d}.png", "image_3/{:04d}.png"),
    ("cam0/data/{:04d}.png", "cam1/data/{:04d}.png"),
    ("left/{:04d}.png", "right/{:04d}.png"),
)


@pytest.mark.parametrize("names", LEFT_RIGHT)
def test_left_and_right_of_one_folder(tmp_path, level: Level, number_in: NumberIn, names):
    for side, name in enumerate(names):
        for number in range(3):
            (tmp_path / name.format(number)).parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(tmp_path / name.format(number)), level(number + 4 * side))
    pair = stereo_images(tmp_path)
    assert pair is not None
    for side, path in enumerate(pair):
        assert [number_in(frame.image) for frame in open_video(path)] == [
            n + 4 * side for n in range(3)
        ]
    recording = open_recording(tmp_path, stereo_layout="auto", has_checks=False)
    assert [
        number_in(video.first_image) for video in recording.videos if video.first_image is not None
    ] in ([], [4])
    assert any("the right images" in note for note in recording.notes)
    recording.close()


def test_one_camera_is_no_pair(tmp_path):
    assert stereo_images(touch(tmp_path / "a", ["left_0.png", "left_1.png"])) is None
    assert stereo_images(touch(tmp_path / "b", ["road_1.png", "lane_2.png"])) is None


@pytest.mark.parametrize(
    ("n_bits", "suffix"), [(10, "png"), (12, "tiff"), (14, "pgm"), (16, "png")]
)
def test_bits_per_pixel(tmp_path, n_bits, suffix):
    stored = np.linspace(0, 2**n_bits - 1, 64).astype(np.uint16).reshape(8, 8)
    cv2.imwrite(str(tmp_path / f"0.{suffix}"), stored)
    (frame,) = (reader := open_video(tmp_path))
    assert np.array_equal(frame.image[..., 1], stored >> (n_bits - 8))
    assert any(f"{n_bits} bits" in note for note in reader.notes) == (n_bits < 16)


@pytest.mark.parametrize("bayer", ["rggb", "bggr", "gbrg", "grbg"])
def test_bayer_filter(tmp_path, bayer):
    """A uniform colour, as a sensor behind the filter sees it."""
    colour = {"b": 40, "g": 90, "r": 200}
    tile = np.array([colour[letter] for letter in bayer], np.uint8).reshape(2, 2)
    cv2.imwrite(str(tmp_path / "0.pgm"), np.tile(tile, (8, 8)))
    (frame,) = open_video(tmp_path, bayer=bayer)
    assert frame.image[8, 8].tolist() == [40, 90, 200]

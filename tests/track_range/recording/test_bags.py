"""MCAP files and ROS bags as input: images, times, calibrations, and damaged files."""

from __future__ import annotations

import shutil
import sqlite3
import sys
from collections.abc import Callable, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer

from tests.support.results.frame_results import result
from tests.track_range.recording.bag_writers import (
    START_NS,
    K,
    write_foxglove,
    write_foxglove_video,
    write_ros1,
    write_ros2,
)
from track_range.foundation.errors import UsageError
from track_range.recording.recording import open_recording
from track_range.recording.sources.bags.bag import is_bag
from track_range.recording.sources.bags.bag_topic import BagTopic
from track_range.recording.sources.bags.bag_video import BagVideo
from track_range.recording.sources.bags.decoding import message_reader
from track_range.recording.sources.open_video import open_video
from track_range.recording.sources.segments.segments import Segments
from track_range.recording.video.frame import VideoError
from track_range.results.formats.run_info import RunInfo
from track_range.results.writers import OpenWriters
from track_range.run.options.precedence import settings_from
from track_range.run.options.settings_file import save_settings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.camera_info import CameraInfo, camera_of, rig_of

BOTH = ("/left", "/right")


def write(
    path: Path, kind: str, names: tuple[str, ...], images: list[np.ndarray], **options: Any
) -> Path:
    if kind.startswith("foxglove"):
        return write_foxglove(path, names, images, is_raw=kind == "foxglove-raw", **options)
    options = {"topic": "image_raw/compressed", **options}
    if kind.startswith("ros1"):
        return write_ros1(path, names, images, compression=kind.partition("-")[2], **options)
    return write_ros2(path, names, images, storage=kind, **options)


@pytest.fixture
def images(level: Callable[..., np.ndarray]) -> list[np.ndarray]:
    return [level(number) for number in range(12)]


def topic_of(kind: str) -> str:
    return "image" if kind.startswith("foxglove") else "image_raw/compressed"


@pytest.mark.parametrize(
    "kind", ["foxglove", "foxglove-raw", "sqlite3", "mcap", "ros1", "ros1-BZ2", "ros1-LZ4"]
)
def test_pair_in_a_bag(
    tmp_path: Path, images: list[np.ndarray], number_in: Callable[..., int], kind: str
) -> None:
    bag = write(tmp_path / "drive.bag", kind, BOTH, images)
    assert is_bag(bag)
    topics = [f"{side}/{topic_of(kind)}" for side in BOTH]
    recording = open_recording(bag, bag, topics=topics, align="off", has_checks=False)
    assert recording.rig is not None
    assert recording.rig.baseline_m == pytest.approx(0.5)
    assert recording.camera.fx_px == 70.0
    frames = list(recording.frames)
    assert [frame.index for frame in frames] == list(range(12))
    assert [frame.time_s for frame in frames] == pytest.approx(
        [number / 10 for number in range(12)]
    )
    assert [number_in(frame.left) for frame in frames] == list(range(12))
    assert frames[0].utc_s == pytest.approx(START_NS / 1e9)
    assert recording.fps == pytest.approx(10.0)
    assert recording.n_frames == 12
    assert not [note for note in recording.notes if "skipped" in note or "cut" in note]


@pytest.mark.parametrize("kind", ["foxglove", "sqlite3", "mcap", "ros1"])
def test_later_start_in_a_bag(
    tmp_path: Path, images: list[np.ndarray], kind: str, monkeypatch: Any
) -> None:
    monkeypatch.setattr("track_range.recording.sources.bags.bag_video._MAX_LATENCY_S", 0.05)
    bag = write(tmp_path / "drive.bag", kind, BOTH, images)
    reader = open_video(BagTopic(bag, f"/left/{topic_of(kind)}"), start_s=0.65, duration_s=0.3)
    assert [frame.index for frame in reader] == [7, 8, 9]


@pytest.mark.parametrize("encoding", ["bgr8", "rgb8", "mono8", "mono16", "bayer_rggb8", "rgba8"])
def test_raw_images(tmp_path: Path, encoding: str) -> None:
    bgr = np.zeros((48, 64, 3), np.uint8)
    bgr[..., :] = (40, 90, 200)
    grey = np.full((48, 64), 90, np.uint8)
    bayer = np.zeros((48, 64), np.uint8)
    bayer[0::2, 0::2], bayer[1::2, 1::2] = 200, 40
    bayer[0::2, 1::2] = bayer[1::2, 0::2] = 90
    stored = {
        "bgr8": bgr,
        "rgb8": bgr[..., ::-1],
        "mono8": grey,
        "mono16": grey.astype(np.uint16) << 8,
        "bayer_rggb8": bayer,
        "rgba8": np.dstack([bgr[..., ::-1], grey]),
    }[encoding]
    bag = write_ros1(
        tmp_path / "drive.bag", ("/cam",), [stored] * 2, topic="image_raw", encoding=encoding
    )
    frames = list(open_video(bag))
    expected = (90, 90, 90) if encoding.startswith("mono") else (40, 90, 200)
    assert len(frames) == 2
    assert frames[0].image[20, 20].tolist() == list(expected)


@pytest.mark.parametrize("encoding", ["16UC1", "32FC1"])
def test_depth_images_are_refused(tmp_path: Path, encoding: str) -> None:
    stored = np.ones((48, 64), np.uint16 if encoding == "16UC1" else np.float32)
    bag = write_ros1(
        tmp_path / "drive.bag", ("/cam",), [stored] * 2, topic="image_raw", encoding=encoding
    )
    with pytest.raises(VideoError, match=rf"drive\.bag: .*depth.*{encoding}"):
        open_video(bag)


def test_messages_compressed_one_by_one(
    tmp_path: Path,
    images: list[np.ndarray],
    number_in: Callable[..., int],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, Writer

    original = Writer.__init__

    def compressing(writer: Any, *args: Any, **options: Any) -> None:
        original(writer, *args, **options)
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)

    monkeypatch.setattr(Writer, "__init__", compressing)
    bag = write(tmp_path / "drive", "sqlite3", ("/cam",), images)
    assert [number_in(frame.image) for frame in open_video(bag)] == list(range(12))


def test_sqlite_bag_that_is_cut_off(
    tmp_path: Path, images: list[np.ndarray], number_in: Callable[..., int]
) -> None:
    bag = write(tmp_path / "drive", "sqlite3", ("/cam",), images * 20)
    file = next(bag.glob("*.db3"))
    content = file.read_bytes()
    file.write_bytes(content[: len(content) * 2 // 3])
    reader = open_video(BagTopic(file, None))
    numbers = [number_in(frame.image) for frame in reader]
    assert 12 <= len(numbers) < 240
    assert numbers[:12] == list(range(12))
    assert any("cut off" in note for note in reader.notes)


def test_baseline_between_cameras_of_another_origin() -> None:
    """KITTI's rectified frames have the origin of another camera: both projection matrices contain
    an offset."""
    k = np.array([[70.0, 0.0, 31.5], [0.0, 70.0, 23.5], [0.0, 0.0, 1.0]])
    left, right = (
        CameraInfo(
            (64, 48), "", (), k, np.eye(3), np.column_stack([k, [70.0 * offset_m, 0.0, 0.0]])
        )
        for offset_m in (0.06, -0.44)
    )
    assert rig_of(left, right, Path("drive.bag"), is_rectified=True).baseline_m == pytest.approx(
        0.5
    )


def test_uncalibrated_camera_has_no_calibration(tmp_path: Path, images: list[np.ndarray]) -> None:
    bag = write(tmp_path / "drive", "mcap", ("/cam",), images[:2], k=[0.0] * 9)
    reader = open_video(bag)
    assert isinstance(reader, BagVideo)
    assert reader.camera is None


def test_rectified_cameras_that_contradict_each_other() -> None:
    k = np.array([[70.0, 0.0, 31.5], [0.0, 70.0, 23.5], [0.0, 0.0, 1.0]])
    left, right, longer = (
        CameraInfo((64, 48), "", (), k, np.eye(3), np.column_stack([matrix, [offset, 0.0, 0.0]]))
        for matrix, offset in ((k, 0.0), (k, -35.0), (k * [[1.3], [1.3], [1.0]], -35.0))
    )
    assert rig_of(left, right, Path("drive.bag"), is_rectified=True).baseline_m == pytest.approx(
        0.5
    )
    with pytest.raises(RigError, match=r"drive\.bag: .*focal lengths"):
        rig_of(left, longer, Path("drive.bag"), is_rectified=True)


def test_video_messages(tmp_path: Path, film: Callable[..., Path]) -> None:
    source = film(tmp_path / "film.h264", [number / 10 for number in range(12)], options={}, gop=6)
    reader = open_video(write_foxglove_video(tmp_path / "drive.mcap", source))
    assert (reader.width_px, reader.height_px, reader.utc) == (64, 48, None)
    assert len(list(reader)) > 0


def test_mono_needs_no_topic_if_there_is_one(tmp_path: Path, images: list[np.ndarray]) -> None:
    bag = write_foxglove(tmp_path / "drive.mcap", ("/camera",), images)
    recording = open_recording(bag)
    assert (recording.camera.fx_px, recording.calibration.kind) == (70.0, "rig")
    assert len(list(recording.frames)) == 12


def test_missing_topic_lists_the_topics(tmp_path: Path, images: list[np.ndarray]) -> None:
    bag = write(tmp_path / "bag", "mcap", BOTH, images)
    for name in (BagTopic(bag, None), BagTopic(bag, "/left/image"), BagTopic(bag, "/chatter")):
        with pytest.raises(
            VideoError, match=r"/left/image_raw/compressed \(sensor_msgs/Compre"
        ) as raised:
            open_video(name)
        assert len(str(raised.value)) < 300 + len(str(bag))


def test_raw_pair_is_rectified(tmp_path: Path, images: list[np.ndarray]) -> None:
    k = [75.0, 0.0, 31.5, 0.0, 75.0, 23.5, 0.0, 0.0, 1.0]
    bag = write(tmp_path / "bag", "sqlite3", BOTH, images, k=k)
    recording = open_recording(
        bag,
        bag,
        topics=[f"{side}/image_raw/compressed" for side in BOTH],
        align="off",
        has_checks=False,
    )
    assert recording.rig is not None
    assert recording.rig.baseline_m == pytest.approx(0.5)
    recording.close()


@pytest.mark.parametrize("kind", ["foxglove", "ros1"])
@pytest.mark.parametrize("fraction", [0.6, 0.97])
def test_bag_that_is_cut_off(
    tmp_path: Path, images: list[np.ndarray], kind: str, fraction: float, monkeypatch: Any
) -> None:
    noisy = [
        np.random.default_rng(number).integers(0, 255, image.shape, np.uint8)
        for number, image in enumerate(images)
    ]
    if kind == "ros1":
        monkeypatch.setattr("rosbags.rosbag1.Writer.__init__", _with_small_chunks(Writer.__init__))
    bag = write(tmp_path / "drive", kind, ("/cam",), noisy)
    content = bag.read_bytes()
    bag.write_bytes(content[: int(fraction * len(content))])
    reader = open_video(BagTopic(bag, f"/cam/{topic_of(kind)}"))
    n_frames = len(list(reader))
    assert 4 <= n_frames < 12 or fraction > 0.9
    assert any("cut off" in note for note in reader.notes)


def _with_small_chunks(original: Callable[..., None]) -> Callable[..., None]:
    def init(self: Writer, path: Path) -> None:
        original(self, path)
        self.chunk_threshold = 20_000

    return init


@pytest.mark.parametrize("kind", ["foxglove", "sqlite3", "mcap", "ros1"])
def test_damaged_bags(tmp_path: Path, images: list[np.ndarray], kind: str) -> None:
    bag = write(tmp_path / "drive", kind, ("/cam",), images)
    file = (
        next(path for path in bag.iterdir() if path.suffix in (".db3", ".mcap"))
        if bag.is_dir()
        else bag
    )
    content = file.read_bytes()
    random, messages, n_frames = np.random.default_rng(4), list[str](), list[int]()
    for _ in range(30):
        damaged = bytearray(content)
        start = int(random.integers(len(damaged)))
        damaged[start : start + 40] = random.integers(0, 256, 40, np.uint8).tobytes()[
            : len(damaged) - start
        ]
        file.write_bytes(
            bytes(
                damaged[: int(random.integers(1, len(damaged)))]
                if random.random() < 0.5
                else damaged
            )
        )
        try:
            frames = list(open_video(BagTopic(bag, f"/cam/{topic_of(kind)}")))
        except VideoError as error:
            messages.append(str(error))
        else:
            n_frames.append(len(frames))
    assert all(
        message.startswith(str(bag)) and len(message) < 300 + len(str(bag)) for message in messages
    )
    assert max(n_frames) <= 12


@pytest.mark.parametrize(
    "content", [b"", b"\x89MCAP0\r\n", b"#ROSBAG V1.2\n", b"SQLite format 3\0", b"#ROSBAG V2.0\n"]
)
def test_empty_bags(tmp_path: Path, content: bytes) -> None:
    (tmp_path / "drive.bag").write_bytes(content)
    with pytest.raises(VideoError, match=r"drive\.bag"):
        open_video(BagTopic(tmp_path / "drive.bag", "/cam"))


@pytest.mark.parametrize("profile", ["foxglove", "ros2"])
def test_own_mcap_file_as_input(tmp_path: Path, images: list[np.ndarray], profile: str) -> None:
    camera = PinholeCamera(70.0, 71.0, 30.0, 20.0, 64, 48)
    settings = {"mcap_profile": profile, "mcap_images": True}
    info = RunInfo(camera=camera, rig=None, fps=10.0, settings=settings, start_utc_s=START_NS / 1e9)
    with OpenWriters(("mcap",), info, tmp_path) as writers:
        for number, image in enumerate(images):
            utc_s = START_NS / 1e9 + number / 10
            given = result(number)
            writers.write(replace(given, frame=Frame(number, number / 10, image, None, utc_s)))
        writers.close({"notes": []})
    recording = open_recording(tmp_path / "run.mcap")
    assert recording.camera == camera
    frames = list(recording.frames)
    assert [frame.time_s for frame in frames] == pytest.approx(
        [number / 10 for number in range(12)]
    )
    assert frames[3].utc_s == pytest.approx(START_NS / 1e9 + 0.3)
    assert np.abs(frames[5].left.astype(int) - images[5]).max() <= 4  # JPEG


@pytest.mark.parametrize(
    ("kind", "package"), [("foxglove", "mcap.stream_reader"), ("ros1", "rosbags.typesys")]
)
def test_missing_package_is_named(
    tmp_path: Path,
    images: list[np.ndarray],
    monkeypatch: pytest.MonkeyPatch,
    kind: str,
    package: str,
) -> None:
    bag = write(tmp_path / "drive", kind, ("/cam",), images[:2])
    message_reader.cache_clear()
    monkeypatch.delitem(sys.modules, "track_range.recording.sources.bags.mcap_file", raising=False)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(VideoError, match=r"pip install 'track-range\[mcap\]'"):
        open_video(bag)


def test_fisheye_model(tmp_path: Path) -> None:
    message = CameraInfo(
        (64, 48), "equidistant", (0.1, 0.2, 0.3, 0.4), np.eye(3), np.eye(3), np.eye(3, 4)
    )
    assert camera_of(message, tmp_path, is_rectified=False).lens == "kannala-brandt"
    assert camera_of(message, tmp_path, is_rectified=True).lens == "pinhole"


def test_unknown_lens_model_is_refused(tmp_path: Path) -> None:
    message = CameraInfo((64, 48), "fov", (0.1,), np.eye(3), np.eye(3), np.eye(3, 4))
    with pytest.raises(RigError, match="fov"):
        camera_of(message, tmp_path, is_rectified=False)


def test_rotated_raw_pair() -> None:
    turn = np.array(
        [[np.cos(0.02), 0.0, np.sin(0.02)], [0.0, 1.0, 0.0], [-np.sin(0.02), 0.0, np.cos(0.02)]]
    )
    k = np.array([[70.0, 0.0, 31.5], [0.0, 70.0, 23.5], [0.0, 0.0, 1.0]])
    p = np.column_stack([k, [-35.0, 0.0, 0.0]])
    left = CameraInfo(
        (64, 48),
        "plumb_bob",
        (0.1, 0.0, 0.0, 0.0, 0.0),
        k,
        np.eye(3),
        np.column_stack([k, [0, 0, 0]]),
    )
    right = CameraInfo((64, 48), "plumb_bob", (0.0,) * 5, k, turn, p)
    rig = rig_of(left, right, Path("drive.bag"), is_rectified=False)
    # a point in the rectified frames: x' = R x, and the right frame is 0.5 m to the right
    point_m = np.array([0.3, -0.2, 5.0])
    in_right_m = rig.right_from_left[:3, :3] @ point_m + rig.right_from_left[:3, 3]
    np.testing.assert_allclose(turn @ in_right_m, point_m - [0.5, 0.0, 0.0], atol=1e-12)
    assert rig.left.distortion == (0.1, 0.0, 0.0, 0.0, 0.0)


def test_bag_in_several_files(tmp_path: Path, images: list[np.ndarray]) -> None:
    folder = tmp_path / "trip"
    folder.mkdir()
    for number in range(2):
        start_ns = START_NS + number * 1_200_000_000
        write_foxglove(folder / f"trip_{number}.mcap", ("/cam",), images, start_ns=start_ns)
    reader = open_video(BagTopic(folder, "/cam/image"))
    assert [frame.index for frame in reader] == list(range(24))
    assert reader.n_frames == 24
    assert [frame.index for frame in open_video(folder, start_s=1.55, duration_s=0.2)] == [16, 17]
    both = Segments((folder / "trip_0.mcap", folder / "trip_1.mcap"))
    for open_both in (lambda: open_video(both), lambda: both.with_topic("/cam/image")):
        with pytest.raises(VideoError, match="one bag"):
            open_both()
    (folder / "trip_1.mcap").rename(folder / "other.mcap")
    with pytest.raises(VideoError, match=r"metadata\.yaml"):
        open_video(folder)


def test_journal_of_a_killed_recorder(tmp_path: Path, images: list[np.ndarray]) -> None:
    bag = write(tmp_path / "bag", "sqlite3", ("/cam",), images)
    file = next(bag.glob("*.db3"))
    with closing(sqlite3.connect(file)) as database:
        database.execute("PRAGMA journal_mode=WAL")
        database.execute("DELETE FROM messages WHERE id > 20")
        database.commit()
        copy = tmp_path / "copy"
        shutil.copytree(bag, copy)  # with the journal, as after a kill
    assert 0 < len(list(open_video(BagTopic(copy, "/cam/image_raw/compressed")))) < 12


def test_split_bag_of_ros1(tmp_path: Path, images: list[np.ndarray]) -> None:
    """The names of `rosbag record --split` have the time of each file; other bags beside are not
    joined."""
    folder = tmp_path / "split"
    folder.mkdir()
    for number, begin in enumerate((0, 6)):
        times = [
            ((100, (begin + i) * 10**8), (1000 + begin + i) * 10**8) for i in range(len(images))
        ]
        name = f"drive_2021-10-01-10-00-0{number}_{number}.bag"
        write(folder / name, "ros1", ("/cam",), images[begin : begin + 6], times=times)
    assert is_bag(folder)
    frames = list(open_video(BagTopic(folder, "/cam/image_raw/compressed")))
    assert [frame.index for frame in frames] == list(range(12))
    assert frames[-1].time_s - frames[0].time_s == pytest.approx(1.1)
    (folder / "film.mp4").touch()
    assert not is_bag(folder)
    (folder / "film.mp4").unlink()
    (folder / name).rename(folder / "drive_2021-10-01-11-00-00_0.bag")
    with pytest.raises(VideoError, match="numbered as in drive_0"):
        open_video(folder)


def _times(stamps_s: Sequence[float], recorded_s: Sequence[float]) -> list[Any]:
    return [
        (divmod(round(stamp_s * 1e9), 10**9), round(time_s * 1e9))
        for stamp_s, time_s in zip(stamps_s, recorded_s, strict=True)
    ]


@pytest.mark.parametrize(
    ("times", "n_frames", "note"),
    [
        # all nanoseconds in 32 bits, as some drivers count them
        ([((5 + i // 4, i * 700_000_000 % 2**32), 10**9 * i // 10) for i in range(12)], 12, "1e9"),
        (_times([7.0] * 12, [i / 10 for i in range(1, 13)]), 12, "repeat the time stamps"),
        # set back by two seconds, with the recorder: one image is left out
        (
            _times(*[[9.0 + i / 10 - 2.0 * (i > 5) for i in range(12)]] * 2),
            11,
            "set back by 2.0 s at 0.5 s",
        ),
        # one image came late
        (_times(*[[9 + i / 10 - 2.0 * (i == 5) for i in range(12)]] * 2), 11, "skipped 1 image"),
    ],
)
def test_wrong_time_stamps(
    tmp_path: Path, images: list[np.ndarray], times: list[Any], n_frames: int, note: str
) -> None:
    reader = open_video(write(tmp_path / "bag.bag", "ros1", ("/cam",), images, times=times))
    for _ in range(2):
        time_s = [frame.time_s for frame in reader]
        assert len(time_s) == n_frames
        assert np.diff(time_s).max() == pytest.approx(0.2 if n_frames < 12 else 0.1)
        assert sum(note in line for line in reader.notes) == 1


@pytest.mark.parametrize("late", ["both", "stamps", "recorder", "none"])
@pytest.mark.parametrize("storage", ["ros1", "sqlite3"])
def test_start_behind_a_clock_that_was_set_back(
    tmp_path: Path, images: list[np.ndarray], late: str, storage: str
) -> None:
    true_s = np.arange(240) / 10 + 100
    set_back_s = true_s - 12.0 * (true_s > 108)
    stamps_s = set_back_s if late in ("both", "stamps") else true_s
    recorded_s = set_back_s if late in ("both", "recorder") else true_s
    many = [images[0]] * len(true_s)
    times = _times(stamps_s.tolist(), recorded_s.tolist())
    bag = write(
        tmp_path / f"bag{'.bag' * (storage == 'ros1')}", storage, ("/cam",), many, times=times
    )
    reader = open_video(bag)
    whole = [(frame.index, frame.time_s) for frame in reader if frame.time_s >= 115.0 - 1e-6]
    late_frames = [(frame.index, frame.time_s) for frame in reader.frames(115.0, np.inf)]
    assert late_frames == whole
    assert late_frames[0][0] in (150, 151)


def test_nanoseconds_that_no_clock_states_in_later_images(
    tmp_path: Path, images: list[np.ndarray]
) -> None:
    times = _times([9 + i / 10 for i in range(40)], [9 + i / 10 for i in range(40)])
    times[35] = ((12, 1_500_000_000), times[35][1])
    reader = open_video(write(tmp_path / "b.bag", "ros1", ("/cam",), [images[0]] * 40, times=times))
    assert len(list(reader)) == 40


def test_images_without_any_time_are_refused(tmp_path: Path, images: list[np.ndarray]) -> None:
    times = _times([7.0] * 12, [8.0] * 12)
    with pytest.raises(VideoError, match="different times, found 12"):
        open_video(write(tmp_path / "bag.bag", "ros1", ("/cam",), images, times=times))


K_WHOLE = np.array([300.0, 0, 159.5, 0, 300, 119.5, 0, 0, 1])
P_WHOLE = np.insert(K_WHOLE.reshape(3, 3), 3, [-30.0, 0, 0], axis=1).ravel()


@pytest.mark.parametrize(
    ("fields", "roi", "camera"),
    [
        # images of 64x48 px: a region of the sensor, all of it with binned pixels, a binned region
        ({}, (100, 50, 48, 64), (300.0, 59.5, 69.5)),
        ({"binning_x": 5, "binning_y": 5}, (0, 0, 240, 320), (60.0, 31.5, 23.5)),
        ({"binning_x": 2, "binning_y": 2}, (100, 50, 96, 128), (150.0, 29.5, 34.5)),
    ],
)
def test_region_and_binning(
    tmp_path: Path, images: list[np.ndarray], fields: dict[str, Any], roi: Any, camera: Any
) -> None:
    fields = {"k": K_WHOLE, "p": P_WHOLE, "width": 320, "height": 240, **fields}
    bag = write(tmp_path / "bag", "mcap", ("/cam",), images[:2], roi=roi, info_fields=fields)
    info = open_video(bag).camera
    assert info is not None
    assert (info.k[0, 0], info.k[0, 2], info.k[1, 2]) == pytest.approx(camera)
    assert info.p[0, 3] / info.p[0, 0] == pytest.approx(-0.1)
    roi = (*roi[:2], 99, 99)
    bag = write(tmp_path / "other", "mcap", ("/cam",), images[:2], roi=roi, info_fields=fields)
    with pytest.raises(RigError, match="region of interest"):
        open_video(bag)


def test_images_described_by_p_alone(tmp_path: Path, images: list[np.ndarray]) -> None:
    fields = {name: np.zeros(n) for name, n in (("k", 9), ("d", 5), ("r", 9))}
    bag = write(tmp_path / "bag", "mcap", BOTH, images, info_fields=fields)
    topics = [f"{side}/image_raw/compressed" for side in BOTH]
    recording = open_recording(bag, bag, topics=topics, align="off", has_checks=False)
    assert recording.rig is not None
    assert (recording.rig.baseline_m, recording.camera.fx_px) == pytest.approx((0.5, 70.0))
    recording.close()


@pytest.mark.parametrize(
    ("topic", "focal_px", "note"),
    [
        ("image_raw", 70.0, "info of"),
        ("image_rect_color", 50.0, "P, 50 px"),
        ("imageRect", 50.0, "P, 50 px"),
        ("color_corrected", 70.0, "give --focal-px 50"),
        ("unrectified", 70.0, "info of"),
        ("directRaw", 70.0, "info of"),
    ],
)
def test_rectified_by_the_words_of_a_topic(
    tmp_path: Path, images: list[np.ndarray], topic: str, focal_px: float, note: str
) -> None:
    fields = {"p": np.diag([50.0, 50.0, 1.0]) @ np.eye(3, 4), "d": np.full(5, 1e-3)}
    fields["p"] = fields["p"].ravel()
    fields["p"][[2, 6]] = 31.5, 23.5
    bag = write(tmp_path / "bag", "mcap", ("/cam",), images, topic=topic, info_fields=fields)
    recording = open_recording(bag, has_checks=False)
    assert recording.calibration.raw_camera is not None
    assert recording.calibration.raw_camera.fx_px == pytest.approx(focal_px)
    assert any(note in line for line in recording.videos[0].notes)
    recording.close()


def test_calibration_of_one_camera_of_two(tmp_path: Path, images: list[np.ndarray]) -> None:
    bags = [
        write(tmp_path / side, "mcap", (f"/{side}",), images, k=k)
        for side, k in (("left", [0.0] * 9), ("right", K))
    ]
    recording = open_recording(*bags, align="off", has_checks=False)
    assert recording.camera.fx_px == 70.0
    assert any("left: no calibration" in note for note in recording.notes)
    recording.close()


def test_depth_alone_is_no_video(tmp_path: Path, images: list[np.ndarray]) -> None:
    bag = write(tmp_path / "bag", "mcap", ("/cam",), images, topic="depth/image_rect")
    with pytest.raises(VideoError, match="--topics"):
        open_video(bag)


def test_settings_of_a_bag(tmp_path: Path, images: list[np.ndarray]) -> None:
    bag = write_foxglove(tmp_path / "drive.mcap", BOTH, images[:2])
    settings = settings_from({"stereo": (str(bag),), "topics": "/left/image,/right/image"})
    assert settings.stereo == (bag, bag)
    assert settings.out_dir == Path("drive-track-range")
    save_settings(settings, tmp_path / "settings.yaml")
    again = settings_from({}, tmp_path / "settings.yaml")
    assert (again.stereo, again.topics) == (settings.stereo, ("/left/image", "/right/image"))
    for given in (
        {"stereo": (str(bag), "other.mcap"), "topics": "/left/image"},
        {"stereo": ("film.mp4",), "topics": "/a,/b,/c"},
        {"mono": "a", "topics": "b,c"},
    ):
        with pytest.raises(UsageError):
            settings_from({**given, "focal_px": 700.0})
    with pytest.raises(VideoError, match="topics"):
        open_recording(tmp_path / "settings.yaml", topics=["/left/image"], focal_px=70.0)


def test_calibration_of_a_realsense_recorder(tmp_path: Path, images: list[np.ndarray]) -> None:
    name = "/device_0/sensor_0/Infrared_1"
    options = {"topic": "image/data", "info": "info/camera_info", "encoding": "bgr8"}
    bag = write_ros1(tmp_path / "drive.bag", [name], images[:2], **options)
    recording = open_recording(bag)
    assert recording.calibration.kind == "rig"
    assert recording.camera.fx_px == 70.0
    assert any(f"{name}/info/camera_info" in note for note in recording.notes)


def test_depth_images_beside_those_of_the_camera(tmp_path: Path, images: list[np.ndarray]) -> None:
    names = ["/camera/color", "/camera/depth"]
    bag = write_ros1(tmp_path / "drive.bag", names, images[:2], topic="image_raw", encoding="bgr8")
    reader = open_video(bag)
    assert str(reader.path) == str(bag)
    assert any(
        "depth images (/camera/depth/image_raw) are left out" in note for note in reader.notes
    )
    chosen = open_video(BagTopic(bag, "/camera/depth/image_raw"))
    assert not any("left out" in note for note in chosen.notes)


def test_recording_of_a_zed_camera(tmp_path: Path) -> None:
    from mcap.writer import Writer

    path = tmp_path / "drive.svo2"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        schema = writer.register_schema("Camera_SN1/side_by_side", "zed_sdk_encoded", b"")
        channel = writer.register_channel("Camera_SN1/side_by_side", "zed_sdk_encoded", schema)
        writer.add_message(channel, 0, b"image", 0)
        writer.finish()
    (tmp_path / "old.svo").write_bytes(b"\x01" * 500)
    for file_name in ("drive.svo2", "old.svo"):
        with pytest.raises(
            VideoError, match=rf"{file_name}: .*ZED.*--stereo-layout side-by-side.*SN\*\.conf"
        ):
            open_recording(tmp_path / file_name)

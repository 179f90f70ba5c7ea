"""Depth that cameras record in bags: units, encodings, alignment to the images, and times."""

import numpy as np
import pytest

from tests.track_range.recording.bag_writers import STEP_NS, K
from tests.track_range.recording.depth_bags import ImageTopic, compressed_depth, png, write_bag
from track_range.recording.recording import open_recording
from track_range.recording.sources.bags.bag_topic import BagTopic

HW = (48, 64)
N = 4


def pictures(n=N):
    rng = np.random.default_rng(0)
    return [rng.integers(0, 255, (*HW, 3), np.uint8) for _ in range(n)]


def depths_m(n=N):
    """A slope whose depth grows by 1 m per frame; the first row is unknown."""
    slope = np.linspace(4.0, 12.0, HW[1])[None].repeat(HW[0], axis=0)
    slope[0] = 0.0
    return [np.where(slope > 0, slope + number, 0.0) for number in range(n)]


def counts(metres, per_m=1000):
    return np.rint(metres * per_m).astype(np.uint16)


def colour(name="/camera/color/image_raw", **changes):
    values = {
        "name": name,
        "encoding": "bgr8",
        "images": pictures(),
        "info": "/camera/color/camera_info",
    }
    return ImageTopic(**{**values, **changes})


def depth(name="/camera/aligned_depth_to_color/image_raw", **changes):
    values = {"name": name, "encoding": "16UC1", "images": [counts(m) for m in depths_m()]}
    return ImageTopic(**{**values, **changes})


def frames_of(bag, **options):
    recording = open_recording(bag, **options)
    frames = list(recording.frames)
    return frames, recording


def check(frames, tolerance_m=0.001):
    """All frames have the depths of `depths_m`."""
    assert len(frames) == N
    for frame, metres in zip(frames, depths_m(), strict=True):
        assert frame.depth_m.dtype == np.float32
        assert np.isnan(frame.depth_m[0]).all()
        np.testing.assert_allclose(frame.depth_m[1:], metres[1:], atol=tolerance_m)


FLOATS = [metres.astype(np.float32) for metres in depths_m()]
# quantised inverse depth of compressed_depth_image_transport
A, B = 10_000.0, 3.0


@pytest.mark.parametrize("is_ros1", [True, False])
@pytest.mark.parametrize(
    ("topics", "tolerance_m"),
    [
        ([colour(), depth()], 0.001),
        # ZED: metres as floats, infinite where too far
        (
            [
                colour("/zed/zed_node/rgb/image_rect_color", info="/zed/zed_node/rgb/camera_info"),
                depth(
                    "/zed/zed_node/depth/depth_registered",
                    encoding="32FC1",
                    images=[np.where(one > 0, one, np.inf) for one in FLOATS],
                ),
            ],
            1e-5,
        ),
        # OAK: no word for depth in the name
        ([colour("/oak/rgb/image_raw"), depth("/oak/stereo/image_raw")], 0.001),
        (
            [
                colour(),
                depth(
                    "/camera/aligned_depth_to_color/image_raw/compressedDepth",
                    encoding="16UC1; compressedDepth png",
                    images=[compressed_depth(counts(m)) for m in depths_m()],
                ),
            ],
            0.001,
        ),
        (
            [
                colour(),
                depth(
                    "/camera/depth_registered/compressed",
                    encoding="16UC1; png compressed",
                    images=[png(counts(m)) for m in depths_m()],
                ),
            ],
            0.001,
        ),
        (
            [
                colour(),
                depth(
                    "/camera/depth_registered/image/compressedDepth",
                    encoding="32FC1; compressedDepth",
                    images=[
                        compressed_depth(
                            np.where(m > 0, np.rint(A / np.maximum(m, 1) + B), 0).astype(np.uint16),
                            A,
                            B,
                        )
                        for m in depths_m()
                    ],
                ),
            ],
            0.02,
        ),
    ],
)
def test_depth_of_each_encoding_is_in_metres(tmp_path, topics, tolerance_m, is_ros1):
    bag = write_bag(tmp_path / ("a.bag" if is_ros1 else "a"), topics, is_ros1=is_ros1)
    name = BagTopic(bag, topics[0].name)
    frames, recording = frames_of(name, focal_px=70.0)
    check(frames, tolerance_m)
    assert recording.calibration.has_depth
    assert any(topics[1].name in note and "`recorded`" in note for note in recording.notes)


def test_realsense_own_recorder_with_its_depth_unit(tmp_path):
    """Infrared 1 has the view of the depth, and the frames have no names."""
    left = colour(
        "/device_0/sensor_0/Infrared_1/image/data",
        encoding="mono8",
        images=[image[:, :, 0] for image in pictures()],
        frame_id="0",
        info="/device_0/sensor_0/Infrared_1/info/camera_info",
    )
    own = depth(
        "/device_0/sensor_0/Depth_0/image/data",
        encoding="mono16",
        images=[counts(m, 4000) for m in depths_m()],
        frame_id="",
        info="/device_0/sensor_0/Depth_0/info/camera_info",
    )
    bag = write_bag(tmp_path / "a.bag", [left, own], is_ros1=True, unit=0.00025)
    check(frames_of(BagTopic(bag, left.name))[0])


def test_depth_of_another_resolution_and_of_a_part_of_the_frames(tmp_path):
    small = [counts(m)[::2, ::2] for m in depths_m()[1:3]]
    bag = write_bag(tmp_path / "a", [colour(), depth(images=small, first=1)])
    frames, _ = frames_of(bag)
    assert [frame.depth_m is None for frame in frames] == [True, False, False, True]
    assert frames[1].depth_m.shape == (24, 32)
    np.testing.assert_allclose(frames[2].depth_m[5, 7], depths_m()[2][10, 14], atol=0.001)


@pytest.mark.parametrize(
    ("delay", "is_known"), [(0.4, True), (-0.4, True), (0.6, False), (3.0, False)]
)
def test_times_agree_within_half_a_frame(tmp_path, delay, is_known):
    """A frame whose depth is later by more belongs to the depth of another frame, or to none."""
    late = depth(images=[counts(depths_m()[0])], delay_ns=int(delay * STEP_NS))
    frames, _ = frames_of(write_bag(tmp_path / "a", [colour(), late]))
    assert (frames[0].depth_m is not None) == is_known
    assert sum(frame.depth_m is not None for frame in frames) == 1


def test_every_second_frame_and_a_part(tmp_path):
    bag = write_bag(tmp_path / "a", [colour(), depth()])
    frames, _ = frames_of(bag, every=2)
    assert [round(float(frame.depth_m[5, 0]), 2) for frame in frames] == [4.0, 6.0]
    frames, _ = frames_of(bag, start_s=0.2)
    assert [round(float(frame.depth_m[5, 0]), 2) for frame in frames] == [6.0, 7.0]


REFUSED = [
    # the depth sensor of a RealSense, which has another view than its colour camera
    (
        depth("/camera/depth/image_rect_raw", frame_id="camera_depth_optical_frame"),
        "another camera",
    ),
    (
        depth("/camera/depth/image_rect_raw", info="/camera/depth/camera_info", k=(60.0, *K[1:])),
        "another camera",
    ),
    (depth(frame_id="", name="/camera/depth/image_rect_raw"), "another camera"),
    (depth(encoding="32FC1", images=[1000 * one for one in FLOATS]), "as of millimetres"),
    (depth(images=[counts(m, 1) for m in depths_m()]), "as of another unit"),
    (depth(images=[np.zeros(HW, np.uint16)] * 2), "empty"),
    (
        depth(
            name="/camera/depth/compressedDepth",
            encoding="16UC1; compressedDepth rvl",
            images=[b"1234567890123"],
        ),
        "RVL",
    ),
    (depth(encoding="16UC1; png compressed", images=[png(pictures()[0])]), "no 16-bit image"),
]


@pytest.mark.parametrize(("refused", "reason"), REFUSED)
def test_what_cannot_be_used_is_left_out_with_the_reason(tmp_path, refused, reason):
    bag = write_bag(tmp_path / "a", [colour(), refused])
    frames, recording = frames_of(bag)
    assert all(frame.depth_m is None for frame in frames)
    assert not recording.calibration.has_depth
    (note,) = (note for note in recording.notes if "left out" in note)
    assert refused.name in note
    assert reason in note


def test_depth_of_a_pair_is_that_of_its_left_camera(tmp_path):
    left, right = (
        colour(
            f"/zed/{side}/image_rect",
            info=f"/zed/{side}/camera_info",
            frame_id=f"{side}_frame",
            offset_m=offset_m,
        )
        for side, offset_m in (("left", 0.0), ("right", -0.12))
    )
    registered = depth("/zed/depth/depth_registered", frame_id="left_frame")
    bag = write_bag(tmp_path / "a", [left, right, registered])
    recording = open_recording(
        BagTopic(bag, left.name), BagTopic(bag, right.name), align="off", has_checks=False
    )
    check(list(recording.frames))
    assert any("`recorded`" in note for note in recording.notes)
    assert not any("left out" in note for note in recording.notes)


def test_aligned_depth_counts_beside_that_of_the_sensor(tmp_path):
    sensor = depth(
        "/camera/depth/image_rect_raw",
        frame_id="camera_depth_optical_frame",
        images=[counts(m + 3) for m in depths_m()],
    )
    frames, recording = frames_of(write_bag(tmp_path / "a", [colour(), sensor, depth()]))
    check(frames)
    assert any("depth/image_rect_raw) are left out" in note for note in recording.notes)


def test_damaged_depth_is_missing_in_its_frame_alone(tmp_path):
    images = [png(counts(m)) for m in depths_m()]
    images[2] = images[2][:40]
    broken = depth(encoding="16UC1; png compressed", images=images)
    frames, _ = frames_of(write_bag(tmp_path / "a", [colour(), broken]))
    assert [frame.depth_m is None for frame in frames] == [False, False, True, False]


def test_big_endian_rows_with_padding(tmp_path):
    from rosbags.typesys import Stores, get_typestore

    from track_range.recording.sources.bags.depth_images import _raw

    message = get_typestore(Stores.ROS2_HUMBLE).types["sensor_msgs/msg/Image"]
    metres = counts(depths_m()[0])
    padded = np.zeros((HW[0], HW[1] + 3), ">u2")
    padded[:, : HW[1]] = metres
    data = np.frombuffer(padded.tobytes(), np.uint8)
    read = _raw(message(None, *HW, "16UC1", 1, 2 * (HW[1] + 3), data))
    np.testing.assert_array_equal(read, metres)

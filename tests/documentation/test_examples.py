"""The programs of docs/examples: on a simulated drive, and with stand-ins for the packages of
ROS."""

import importlib.util
import math
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest

import track_range as tr
from tests.documentation.documented_commands import PROJECT

EXAMPLES = PROJECT / "docs/examples"
HEADER = SimpleNamespace(stamp=SimpleNamespace(sec=100, nanosec=0), frame_id="left")


def loaded(name):
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.slow
def test_webcam_on_a_video(small_drive, tmp_path, monkeypatch, capsys):
    image = tmp_path / "latest.jpg"
    arguments = [str(small_drive.left), "--focal-px", "360", "--image", str(image)]
    monkeypatch.setattr(sys, "argv", ["webcam.py", *arguments])
    loaded("webcam").main()
    assert " m\n" in capsys.readouterr().out
    assert image.stat().st_size > 1000


class Message(SimpleNamespace):
    """Stand-in for a message of ROS: fields appear when they are first read."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        value = {"results": [], "covariance": np.zeros(36)}.get(name)
        value = Message() if value is None else value
        setattr(self, name, value)
        return value


class Node:
    """Stand-in for rclpy's Node that keeps what it publishes and logs."""

    def __init__(self, name):
        self.published, self.logged = [], []

    def create_publisher(self, kind, topic, depth):
        return SimpleNamespace(publish=self.published.append)

    def create_subscription(self, kind, topic, callback, profile):
        pass

    def get_logger(self):
        return SimpleNamespace(warning=self.logged.append)


class Synchronizer:
    """Stand-in for message_filters' synchronizer."""

    def __init__(self, subscribers, queue_size, slop):
        self.topics = [topic for _, _, topic in subscribers]

    def registerCallback(self, callback):  # noqa: N802 - the name in ROS
        self.callback = callback


def module(name, **attributes):
    made = ModuleType(name)
    vars(made).update(attributes)
    return made


@pytest.fixture
def node_module(monkeypatch):
    """docs/examples/ros2_node.py with stand-ins for what it imports of ROS."""
    messages = (
        "Odometry",
        "CameraInfo",
        "Image",
        "Detection3D",
        "Detection3DArray",
        "ObjectHypothesisWithPose",
    )
    kinds = dict.fromkeys(messages, Message)
    parts = {"Subscriber": lambda node, kind, topic, qos_profile: (node, kind, topic)}
    for stand_in in (
        module("rclpy"),
        module("rclpy.node", Node=Node),
        module("rclpy.qos", qos_profile_sensor_data=None),
        module("message_filters", ApproximateTimeSynchronizer=Synchronizer, **parts),
        *(module(name, **kinds) for name in ("nav_msgs.msg", "sensor_msgs.msg", "vision_msgs.msg")),
        *(module(name) for name in ("nav_msgs", "sensor_msgs", "vision_msgs")),
    ):
        monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
    return loaded("ros2_node")


def image_message(image, encoding, *, padding=0):
    rows = np.pad(image.reshape(len(image), -1), ((0, 0), (0, padding)))
    height, width = image.shape[:2]
    data = rows.tobytes()
    return Message(
        header=HEADER, encoding=encoding, height=height, width=width, step=rows.shape[1], data=data
    )


def camera_info(camera, *, baseline_m=0.0):
    row = [
        camera.fx_px,
        0.0,
        camera.cx_px,
        -camera.fx_px * baseline_m,
        0.0,
        camera.fy_px,
        camera.cy_px,
        0.0,
    ]
    return Message(p=[*row, 0.0, 0.0, 1.0, 0.0], width=camera.width_px, height=camera.height_px)


@pytest.mark.parametrize("padding", [0, 5])
def test_images_of_ros(node_module, padding):
    image = np.random.default_rng(1).integers(0, 256, (4, 6, 3), np.uint8)
    by_encoding = {"bgr8": image, "rgb8": image[:, :, ::-1], "mono8": image[:, :, :1]}
    for encoding, sent in by_encoding.items():
        received = node_module.bgr_image(image_message(sent, encoding, padding=padding))
        assert received.flags.c_contiguous
        np.testing.assert_array_equal(
            received, image[:, :, [0, 0, 0]] if encoding == "mono8" else image
        )
    with pytest.raises(ValueError, match="16UC1"):
        node_module.bgr_image(image_message(image, "16UC1"))


def test_rig_of_camera_infos(node_module):
    left = tr.PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
    rig = node_module.rig_of(camera_info(left), camera_info(left, baseline_m=0.12))
    assert rig.left == left
    assert rig.baseline_m == pytest.approx(0.12)
    assert rig.is_rectified


def test_detection_of_an_object(node_module):
    t = tr.TrackedObject(
        7, "car", (0.0, 0.0, 9.0, 9.0), 20.0, 0.5, math.nan, math.nan, (1.0, 0.5, 20.0), True
    )
    detection = node_module.detection_of(t, 0.9, HEADER)
    (result,) = detection.results
    assert (detection.id, result.hypothesis.class_id, result.hypothesis.score) == ("7", "car", 0.9)
    assert (
        result.pose.pose.position == detection.bbox.center.position == Message(x=1.0, y=0.5, z=20.0)
    )
    assert result.pose.covariance.reshape(6, 6)[2, 2] == 0.25


@pytest.mark.slow
def test_node_on_a_drive(node_module, small_drive):
    rig = tr.load_rig(small_drive.rig)
    infos = camera_info(rig.left), camera_info(rig.right, baseline_m=rig.baseline_m)
    node = node_module.RangeNode()
    assert node.synchronizer.topics == [
        "left/image",
        "right/image",
        "left/camera_info",
        "right/camera_info",
    ]
    recording = tr.open_recording(small_drive.left, small_drive.right, rig=small_drive.rig)
    for frame in recording.frames:
        pair = [image_message(image[:, :], "bgr8") for image in (frame.left, frame.right)]
        for message in pair:
            stamp = SimpleNamespace(sec=100, nanosec=round(1e9 * frame.time_s))
            message.header = SimpleNamespace(stamp=stamp, frame_id="left")
        node.synchronizer.callback(*pair, *infos)
    recording.close()
    last = node.published[-1]
    assert last.header.frame_id == "left"
    assert all(0 < detection.bbox.center.position.z < 100 for detection in last.detections)
    assert "car" in {
        result.hypothesis.class_id for detection in last.detections for result in detection.results
    }

"""The programs of docs/examples: on a simulated drive, and with stand-ins for the packages of
ROS."""

import importlib.util
import sys
from types import ModuleType, SimpleNamespace

import numpy as np
import pytest
from rosbags.interfaces import Nodetype
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

import track_range as tr
from tests.documentation.documented_commands import PROJECT
from track_range.pipeline.frame_result import PointState
from track_range.results.formats.mcap.ros2_profile import VISION_MESSAGES

EXAMPLES = PROJECT / "docs/examples"


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


STORE = get_typestore(Stores.ROS2_HUMBLE)
for _name, _text in VISION_MESSAGES.items():
    STORE.register(get_types_from_msg(_text, f"vision_msgs/msg/{_name}"))


def message_type(name):
    """The class of a message of ROS 2, by its definition: with default values, and without other
    fields or other types, as rclpy's."""
    fields = STORE.fielddefs[name][1]

    def created(self, **values):
        for key, kind in fields:
            object.__setattr__(self, key, values.pop(key, None) or default_of(*kind))
        assert not values, f"{name} has no fields {sorted(values)}"

    def set_field(self, key, value):
        assert key in dict(fields), f"{name} has no field {key}"
        object.__setattr__(self, key, value)

    names = {"__init__": created, "__setattr__": set_field, "ros_type": name}
    return type(name.rpartition("/")[2], (), names)


def default_of(kind, detail):
    """The first value of a field, as rclpy has it."""
    if kind == Nodetype.NAME:
        return message_type(detail)()
    if kind == Nodetype.BASE:
        return {"string": "", "bool": False, "byte": b"\0", "float64": 0.0}.get(detail[0], 0)
    (of, inner), n = detail
    if kind == Nodetype.ARRAY:
        return [default_of(of, inner) for _ in range(n)]
    return []


def encoded(message):
    """The bytes of a message on the wire; values of another type than its definition are errors."""
    return STORE.serialize_cdr(as_stored(message), message.ros_type)


def as_stored(message):
    """A message as rosbags has it, after a check of the types as rclpy makes it."""
    values = {}
    for key, (kind, detail) in STORE.fielddefs[message.ros_type][1]:
        value = getattr(message, key)
        values[key] = stored_value(f"{message.ros_type}.{key}", value, kind, detail)
    return STORE.types[message.ros_type](**values)


def stored_value(place, value, kind, detail):
    if kind == Nodetype.NAME:
        assert value.ros_type == detail, place
        return as_stored(value)
    if kind == Nodetype.BASE:
        wanted = {"string": str, "bool": bool, "byte": bytes, "float64": float}.get(detail[0], int)
        assert type(value) is wanted, (place, value)
        return value[0] if wanted is bytes else value
    (of, inner), n = detail
    assert kind != Nodetype.ARRAY or len(value) == n, place
    values = [stored_value(place, one, of, inner) for one in value]
    if of == Nodetype.BASE and inner[0] != "string":
        return np.array(values, {"float64": np.float64, "uint8": np.uint8}[inner[0]])
    return values


TYPES = {
    "diagnostic_msgs": ("DiagnosticArray", "DiagnosticStatus", "KeyValue"),
    "nav_msgs": ("Odometry",),
    "sensor_msgs": ("CameraInfo", "Image"),
    "vision_msgs": ("Detection3D", "Detection3DArray", "ObjectHypothesisWithPose"),
}
MESSAGES = {
    package: {name: message_type(f"{package}/msg/{name}") for name in names}
    for package, names in TYPES.items()
}
HEADER, STAMP = message_type("std_msgs/msg/Header"), message_type("builtin_interfaces/msg/Time")
IMAGE, CAMERA_INFO = MESSAGES["sensor_msgs"]["Image"], MESSAGES["sensor_msgs"]["CameraInfo"]


def header_at(time_ns):
    sec, nanosec = divmod(time_ns, 10**9)
    return HEADER(stamp=STAMP(sec=sec, nanosec=nanosec), frame_id="left")


class Node:
    """Stand-in for rclpy's Node that keeps what it publishes and logs."""

    def __init__(self, name):
        self.published, self.logged = {}, []

    def create_publisher(self, kind, topic, depth):
        sent = self.published.setdefault(topic, [])

        def publish(message):
            assert message.ros_type.endswith(kind.__name__)
            assert len(encoded(message)) > 4
            sent.append(message)

        return SimpleNamespace(publish=publish)

    def create_subscription(self, kind, topic, callback, profile):
        pass

    def get_logger(self):
        def log(text, *, throttle_duration_sec=0.0):
            assert "\n" not in text
            self.logged.append(text)

        return SimpleNamespace(warning=log, error=log)


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
    parts = {"Subscriber": lambda node, kind, topic, qos_profile: (node, kind, topic)}
    for stand_in in (
        module("rclpy"),
        module("rclpy.node", Node=Node),
        module("rclpy.qos", qos_profile_sensor_data=None),
        module("message_filters", ApproximateTimeSynchronizer=Synchronizer, **parts),
        *(module(f"{name}.msg", **types) for name, types in MESSAGES.items()),
        *(module(name) for name in MESSAGES),
    ):
        monkeypatch.setitem(sys.modules, stand_in.__name__, stand_in)
    return loaded("ros2_node")


def image_message(image, encoding, *, padding=0, time_ns=100 * 10**9):
    rows = np.pad(image.reshape(len(image), -1), ((0, 0), (0, padding)))
    height, width = image.shape[:2]
    return IMAGE(
        header=header_at(time_ns),
        encoding=encoding,
        height=height,
        width=width,
        step=rows.strides[0],
        data=rows.tobytes(),
    )


def camera_info(camera, *, baseline_m=0.0):
    fx, cx, tx = camera.fx_px, camera.cx_px, -camera.fx_px * baseline_m
    row = [fx, 0.0, cx, tx, 0.0, camera.fy_px, camera.cy_px, 0.0, 0.0, 0.0, 1.0, 0.0]
    return CAMERA_INFO(p=row, width=camera.width_px, height=camera.height_px)


@pytest.mark.parametrize("padding", [0, 5])
def test_images_of_ros(node_module, padding):
    image = np.random.default_rng(1).integers(0, 256, (4, 6, 3), np.uint8)
    by_encoding = {"bgr8": image, "rgb8": image[:, :, ::-1], "mono8": image[:, :, :1]}
    for encoding, sent in by_encoding.items():
        received = node_module.image_of(image_message(sent, encoding, padding=padding))
        assert received.flags.c_contiguous
        np.testing.assert_array_equal(
            received, image[:, :, [0, 0, 0]] if encoding == "mono8" else image
        )
    with pytest.raises(tr.errors.FrameError, match="16UC1"):
        node_module.image_of(image_message(image, "16UC1"))


LEFT = tr.PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)


def test_rig_of_camera_infos(node_module):
    size = LEFT.size_px
    rig = node_module.rig_of(camera_info(LEFT), camera_info(LEFT, baseline_m=0.12), size, size)
    assert rig.left == LEFT
    assert rig.baseline_m == pytest.approx(0.12)
    assert rig.is_rectified
    half = node_module.camera_of(camera_info(LEFT), 320, 180, "left")
    assert (half.fx_px, half.size_px) == (350.0, (320, 180))
    assert half.cx_px == pytest.approx(159.75)


@pytest.mark.parametrize(
    ("left", "right", "size_px", "words"),
    [
        (CAMERA_INFO(p=[0.0] * 12), camera_info(LEFT), (640, 360), "left/camera_info.*P with a"),
        (camera_info(LEFT), camera_info(LEFT), (640, 360), "right/camera_info.*baseline"),
        (camera_info(LEFT), camera_info(LEFT, baseline_m=0.1), (640, 480), "left/image.*640x480"),
    ],
)
def test_unusable_camera_infos_are_named(node_module, left, right, size_px, words):
    with pytest.raises(ValueError, match=words):
        node_module.rig_of(left, right, size_px, size_px)


def test_messages_of_an_object(node_module):
    covariance = ((0.3, 0.0, 0.1), (0.0, 0.2, 0.0), (0.1, 0.0, 0.25))
    state = PointState((1.0, 0.5, 20.0), covariance, (0.5, 0.0, -3.0), covariance)
    t = tr.TrackedObject(
        *(7, "car", (0.0, 0.0, 9.0, 9.0), 21.0, 0.6, 3.0, 7.0, (1.0, 0.5, 21.0), True),
        filtered_m=20.0,
        in_camera=state,
        size_m=(4.4, 1.8, 1.6),
        score=0.9,
    )
    detection = node_module.detection_of(t, header_at(5))
    (result,) = detection.results
    assert (detection.id, result.hypothesis.class_id, result.hypothesis.score) == ("7", "car", 0.9)
    position, size = result.pose.pose.position, detection.bbox.size
    assert (position.x, position.y, position.z) == (1.0, 0.5, 20.0)
    assert (size.x, size.y, size.z) == (1.8, 1.6, 4.4)
    assert detection.bbox.center.position.z == 22.2
    whole = np.reshape(result.pose.covariance, (6, 6))
    np.testing.assert_array_equal(whole[:3, :3], covariance)
    assert (np.diag(whole)[3:] == 1e6).all()
    track = node_module.track_of(t, header_at(5))
    assert (track.child_frame_id, track.twist.twist.linear.z) == ("track_7", -3.0)
    status = node_module.status_of(t, is_warning=True)
    values = {value.key: value.value for value in status.values}
    assert (status.level, values["ttc_s"], values["distance_m"]) == (b"\1", "7", "20")
    assert "gap_m" not in values
    for message in (detection, track, status):
        assert encoded(message)


@pytest.fixture
def opened_node(node_module):
    node = node_module.RangeNode()
    yield node
    if node.pipeline is not None:
        node.pipeline.close()


@pytest.mark.slow
def test_node_on_a_drive(opened_node, small_drive):
    rig = tr.load_rig(small_drive.rig)
    infos = camera_info(rig.left), camera_info(rig.right, baseline_m=rig.baseline_m)
    node = opened_node
    assert node.synchronizer.topics == [
        "left/image",
        "right/image",
        "left/camera_info",
        "right/camera_info",
    ]
    recording = tr.open_recording(small_drive.left, small_drive.right, rig=small_drive.rig)
    pairs = [
        [image_message(image[:, :], "bgr8") for image in (frame.left, frame.right)]
        for frame in recording.frames
    ]
    recording.close()
    for k, pair in enumerate([*pairs, *pairs]):
        time_ns = 100 * 10**9 + 10**8 * (k % len(pairs))  # a loop of the bag
        for message in pair:
            message.header = header_at(time_ns)
        node.synchronizer.callback(*pair, *infos)
        node.synchronizer.callback(*pair, *infos)  # the same stamp again
    published = node.published
    assert len(published["detections"]) == 2 * len(pairs)
    assert [text for text in node.logged if "another drive starts" in text]
    assert [text for text in node.logged if "expected a later stamp" in text]
    last = published["detections"][-1]
    assert last.header.frame_id == "left"
    assert all(0 < one.results[0].pose.pose.position.z < 100 for one in last.detections)
    names = {one.results[0].hypothesis.class_id for one in last.detections}
    assert "car" in names
    assert all(0 < one.pose.covariance[14] < 100 for one in published["tracks"])
    assert published["ranges"][-1].status[0].name.startswith("track ")
    assert published["/diagnostics"][0].status[0].name.startswith("track_range: ")


def test_node_goes_on_after_what_it_cannot_use(opened_node):
    node, infos = opened_node, (camera_info(LEFT), camera_info(LEFT, baseline_m=0.12))
    image = np.random.default_rng(2).integers(0, 256, (360, 640, 3), np.uint8)
    uncalibrated = CAMERA_INFO(p=[0.0] * 12)

    def send(time_s, encoding="bgr8", sent=image, infos=infos):
        pair = [image_message(sent, encoding, time_ns=round(1e9 * time_s)) for _ in "lr"]
        n_before = len(node.published["detections"])
        node.synchronizer.callback(*pair, *infos)
        return len(node.published["detections"]) - n_before

    grey16 = image[..., 0].astype(np.uint16) << 8
    sent = [
        send(5.0, infos=(uncalibrated, uncalibrated)),
        send(5.1),
        send(5.2, "16UC1"),
        send(5.3, "bgra8", np.dstack([image, image[..., :1]])),
        send(5.4, "yuv422_yuy2", np.ascontiguousarray(image[..., :2])),
        send(5.5, "mono16", grey16.view(np.uint8).reshape(360, 640, 2)),
        send(5.5),  # repeated
        send(5.45),  # late
        send(5.6, sent=image[::2, ::2]),  # of half size
        send(5.7, sent=image[:, ::2]),  # of another shape
        send(5.8),
        send(1.0),  # a loop
    ]
    assert sent == [0, 1, 0, 1, 1, 1, 0, 0, 1, 0, 1, 1]
    words = (
        "P with a focal",
        "16UC1",
        "later stamp",
        "changed, to 320x180",
        "320x360",
        "went back",
    )
    for word in words:
        assert [text for text in node.logged if word in text], word
    assert node.pipeline.notes is not None

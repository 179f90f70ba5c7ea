"""run.mcap in both profiles, read back message by message with other libraries; kills, full disks,
missing packages."""

from __future__ import annotations

import json
import math
import re
import shutil
import struct
import subprocess
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from mcap.exceptions import McapError
from mcap.reader import NonSeekingReader, make_reader
from mcap_protobuf.decoder import DecoderFactory as ProtobufDecoders
from mcap_ros2.decoder import DecoderFactory as Ros2Decoders
from pyarrow import parquet
from scipy.spatial.transform import Rotation

import track_range as tr
from tests.support.file_size_limit import file_size_limit
from tests.support.results.frame_results import changed, cuboids, with_unknown
from tests.track_range.results.moving_frames import PERIOD_S, START_S, frame, info
from track_range.foundation.errors import UserError
from track_range.foundation.files.output_files import OutputError
from track_range.foundation.schemas.schema_version import SCHEMA_VERSION
from track_range.results.formats.mcap import LAYOUT
from track_range.results.formats.run_info import RunInfo
from track_range.results.formats.scene import VEHICLE_FROM_CAMERA_XYZW, track_objects
from track_range.results.replay import frames_of_rows
from track_range.results.rows.columns import viewer_columns
from track_range.results.table import RunTable
from track_range.results.writers import OpenWriters, create_writers
from track_range.run.export.export import ExportSettings, export
from track_range.run.options.precedence import settings_from
from track_range.stereo.geometry.mounting import Mounting


def write(folder: Path, about: RunInfo, n_frames: int = 4) -> Path:
    writers = OpenWriters(("mcap",), about, folder)
    for index in range(n_frames):
        writers.write(frame(index))
    writers.close({"notes": [*about.notes, "a note at the end"]})
    return folder / "run.mcap"


def messages(path: Path) -> dict[str, list[tuple[str, int, Any]]]:
    """(schema, time, decoded message) by topic, as other libraries read them."""
    by_topic = defaultdict(list)
    with path.open("rb") as file:
        reader = make_reader(
            file, decoder_factories=[ProtobufDecoders(), Ros2Decoders(), JsonDecoders()]
        )
        for schema, channel, message, decoded in reader.iter_decoded_messages():
            assert message.publish_time == message.log_time
            by_topic[channel.topic].append((schema.name, message.log_time, decoded))
    return dict(by_topic)


class JsonDecoders:
    def decoder_for(self, encoding: str, schema: Any) -> Any:
        return json.loads if encoding == "json" else None


def times_ns(n_frames: int) -> list[int]:
    return [
        round((START_S % 1) * 1e9) + int(START_S) * 10**9 + round(i * PERIOD_S * 1e9)
        for i in range(n_frames)
    ]


def stamp_ns(stamp: Any) -> int:
    return stamp.seconds * 10**9 + stamp.nanos


# -- Foxglove
# -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def foxglove(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    about = info(start_utc_s=START_S, notes=("a note at the start",))
    return messages(write(tmp_path_factory.mktemp("foxglove"), about))


def test_foxglove_topics(foxglove: dict[str, Any]) -> None:
    expected = {
        "/camera/calibration": "foxglove.CameraCalibration",
        "/camera/image": "foxglove.CompressedImage",
        "/camera/annotations": "foxglove.ImageAnnotations",
        "/tracks/scene": "foxglove.SceneUpdate",
        "/tracks/ranges": "track_range.Ranges",
        "/tf": "foxglove.FrameTransforms",
        "/log": "foxglove.Log",
    }
    assert {topic: rows[0][0] for topic, rows in foxglove.items()} == expected
    for topic, rows in foxglove.items():
        if topic != "/log":
            assert [time for _, time, _ in rows] == times_ns(4)
    notes = foxglove["/log"]
    assert [(time, note.message) for _, time, note in notes] == [
        (times_ns(1)[0], "a note at the start"),
        (times_ns(4)[3], "a note at the end"),
    ]


def test_foxglove_calibration_and_transform(foxglove: dict[str, Any]) -> None:
    for index, (_, time, message) in enumerate(foxglove["/camera/calibration"]):
        assert stamp_ns(message.timestamp) == time == times_ns(4)[index]
        assert (message.frame_id, message.width, message.height) == ("camera", 50, 50)
        assert list(message.K) == [700.0, 0, 20.0, 0, 710.0, 30.0, 0, 0, 1]
        assert list(message.P) == [700.0, 0, 20.0, 0, 0, 710.0, 30.0, 0, 0, 0, 1, 0]
        assert list(message.R) == [1, 0, 0, 0, 1, 0, 0, 0, 1]
    vehicle, transform = foxglove["/tf"][0][2].transforms
    assert (vehicle.parent_frame_id, vehicle.child_frame_id, vehicle.translation.x) == (
        "map",
        "vehicle",
        8.0,
    )
    assert (transform.parent_frame_id, transform.child_frame_id) == ("vehicle", "camera")
    rotation = transform.rotation
    assert (rotation.x, rotation.y, rotation.z, rotation.w) == VEHICLE_FROM_CAMERA_XYZW


def test_transforms_with_a_mounting(tmp_path: Path) -> None:
    """The camera is where its pose says, at its place in a vehicle that drives where it drives."""
    mounting = Mounting(yaw_deg=30.0, pitch_deg=4.0, x_m=1.5, y_m=-0.4, z_m=1.3)
    file = write(tmp_path, info(start_utc_s=START_S, mounting=mounting), 1)
    vehicle, camera = messages(file)["/tf"][0][2].transforms
    pose = frame(0).ego_pose
    assert (camera.translation.x, camera.translation.y, camera.translation.z) == (1.5, -0.4, 1.3)
    turn = rotation(vehicle.rotation)
    heading_rad = np.arctan2(turn[1, 0], turn[0, 0])
    assert heading_rad == pytest.approx(pose.heading_rad - np.radians(30.0))
    place_m = turn @ [1.5, -0.4, 1.3] + [vehicle.translation.x, vehicle.translation.y, 0.0]
    np.testing.assert_allclose(place_m, [pose.x_m, pose.y_m, 1.3], atol=1e-9)
    axis = turn @ rotation(camera.rotation) @ [0.0, 0.0, 1.0]
    assert np.arctan2(axis[1], axis[0]) == pytest.approx(pose.heading_rad)
    assert axis[2] == pytest.approx(-np.sin(np.radians(4.0)))


def rotation(quaternion: Any) -> Any:
    parts = [getattr(quaternion, name) for name in "xyzw"]
    return Rotation.from_quat(parts).as_matrix()


def test_vehicle_axes() -> None:
    """The camera's forward, right and down are the vehicle's x, -y and -z."""
    x, y, z, w = VEHICLE_FROM_CAMERA_XYZW
    axis = np.array([x, y, z])
    for camera, vehicle in (
        ((0, 0, 1), (1, 0, 0)),
        ((1, 0, 0), (0, -1, 0)),
        ((0, 1, 0), (0, 0, -1)),
    ):
        turned = np.array(camera) + 2 * np.cross(
            axis, np.cross(axis, camera) + w * np.array(camera)
        )
        np.testing.assert_allclose(turned, vehicle, atol=1e-12)


def test_foxglove_images(foxglove: dict[str, Any]) -> None:
    for index, (_, _, message) in enumerate(foxglove["/camera/image"]):
        assert message.format == "jpeg"
        image = cv2.imdecode(np.frombuffer(message.data, np.uint8), cv2.IMREAD_COLOR)
        np.testing.assert_allclose(image, 8 * index, atol=2)


def test_foxglove_annotations(foxglove: dict[str, Any]) -> None:
    message = foxglove["/camera/annotations"][0][2]
    car, light = message.points
    assert [(point.x, point.y) for point in car.points] == [
        (1.5, 2.5),
        (3.5, 2.5),
        (3.5, 5.0),
        (1.5, 5.0),
    ]
    figures, predicted = ({pair.key: pair.value for pair in box.metadata} for box in (car, light))
    assert (figures["distance_m"], figures["class"], figures["observed"]) == (
        "12.000",
        "car",
        "true",
    )
    assert predicted["observed"] == "false"
    assert car.outline_color.a == 1.0
    assert light.outline_color.a < 1.0  # predicted
    assert [text.text for text in message.texts] == ["car 3  12.0 ± 0.5 m", "traffic light 7"]
    assert len(foxglove["/camera/annotations"][2][2].points) == 1


def test_foxglove_scene(foxglove: dict[str, Any]) -> None:
    scenes = [message for _, _, message in foxglove["/tracks/scene"]]
    assert [[entity.id for entity in scene.entities] for scene in scenes] == [
        ["track 3"],
        ["track 3"],
        [],
        ["track 3"],
    ]
    assert [[gone.id for gone in scene.deletions] for scene in scenes] == [[], [], ["track 3"], []]
    (entity,) = scenes[0].entities
    (cube,) = entity.cubes
    assert entity.frame_id == "camera"
    assert (cube.size.x, cube.size.y, cube.size.z) == (4.0, 1.8, 1.5)
    at = cube.pose.position
    assert (at.x, at.y, at.z) == (1.0, 0.8, 14.0)
    # its front is ahead, its left side on the left, its roof above
    np.testing.assert_allclose(
        rotation(cube.pose.orientation), [[0, -1, 0], [0, 0, -1], [1, 0, 0]], atol=1e-12
    )


def test_foxglove_ranges(foxglove: dict[str, Any]) -> None:
    rows = [message["tracks"] for _, _, message in foxglove["/tracks/ranges"]]
    assert rows[0] == [
        {"id": 3, "class": "car", "observed": True, "distance_m": 12.0, "sigma_m": 0.5, "closing_mps": 2.0,
         "closing_sigma_mps": 0.5, "ttc_s": 6.0, "speed_mps": 8.5, "speed_sigma_mps": 0.4, "heading_deg": -12.5,
         "world_x_m": 20.25, "world_y_m": -3.5},
        {"id": 7, "class": "traffic light", "observed": False},
    ]  # fmt: skip
    assert [row["id"] for row in rows[2]] == [7]


# -- ROS 2
# ----------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def ros2(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    return messages(write(tmp_path_factory.mktemp("ros2"), info("ros2", start_utc_s=START_S)))


def test_ros2_topics(ros2: dict[str, Any]) -> None:
    expected = {
        "/camera/camera_info": "sensor_msgs/msg/CameraInfo",
        "/camera/image/compressed": "sensor_msgs/msg/CompressedImage",
        "/camera/detections": "vision_msgs/msg/Detection2DArray",
        "/tracks/detections": "vision_msgs/msg/Detection3DArray",
        "/tracks/objects": "autoware_perception_msgs/msg/TrackedObjects",
        "/tracks/ranges": "diagnostic_msgs/msg/DiagnosticArray",
        "/tf": "tf2_msgs/msg/TFMessage",
        "/rosout": "rcl_interfaces/msg/Log",
    }
    assert {topic: rows[0][0] for topic, rows in ros2.items()} == expected
    for topic, rows in ros2.items():
        for index, (_, time, message) in enumerate(rows if topic not in ("/rosout", "/tf") else []):
            stamp = message.header.stamp
            assert stamp.sec * 10**9 + stamp.nanosec == time == times_ns(4)[index]
            assert message.header.frame_id == (
                "vehicle" if topic == "/tracks/objects" else "camera"
            )


def test_objects_of_autoware(ros2: dict[str, Any], tmp_path: Path) -> None:
    (car,) = ros2["/tracks/objects"][0][2].objects
    assert (car.existence_probability, car.classification[0].label) == (0.5, 1)
    pose = car.kinematics.pose_with_covariance
    at, size = pose.pose.position, car.shape.dimensions
    np.testing.assert_allclose([at.x, at.y, at.z], [14.0, -1.0, -0.8], atol=1e-12)
    np.testing.assert_allclose(rotation(pose.pose.orientation), np.eye(3), atol=1e-12)
    variances = np.diag(np.reshape(pose.covariance, (6, 6)))
    np.testing.assert_allclose(
        variances, [0.25, 0.04, 0.01, 0.03**2, 0.03**2, np.radians(5.0) ** 2]
    )
    assert (size.x, size.y, size.z, car.shape.type) == (4.0, 1.8, 1.5, 0)
    twist = car.kinematics.twist_with_covariance
    assert (twist.twist.linear.x, twist.covariance[0]) == pytest.approx((8.5, 0.16))
    assert car.kinematics.orientation_availability == 2
    later = ros2["/tracks/objects"][3][2].objects[0]
    assert bytes(car.object_id.uuid) == bytes(later.object_id.uuid)
    # turned to the left, its front not known, in a vehicle whose camera looks 30 degrees to the right
    mounting = Mounting(yaw_deg=-30.0, x_m=1.5, y_m=-0.4, z_m=1.3)
    turned = changed(frame(0), cuboids=with_unknown(cuboids(yaw_deg=90.0, front_known=False)))
    writers = OpenWriters(("mcap",), info("ros2", mounting=mounting), tmp_path)
    writers.write(turned)
    writers.close(None)
    read = messages(tmp_path / "run.mcap")
    (car,) = read["/tracks/objects"][0][2].objects
    pose, turn = car.kinematics.pose_with_covariance.pose, np.radians(mounting.yaw_deg)
    expected = [
        1.5 + 14 * np.cos(turn) + np.sin(turn), -0.4 + 14 * np.sin(turn) - np.cos(turn), 1.3 - 0.8
    ]  # fmt: skip
    np.testing.assert_allclose([pose.position.x, pose.position.y, pose.position.z], expected)
    axis = rotation(pose.orientation) @ [1.0, 0.0, 0.0]
    assert np.degrees(np.arctan2(axis[1], axis[0])) == pytest.approx(60.0)
    assert car.kinematics.orientation_availability == 1
    (solid,) = read["/tracks/detections"][0][2].detections
    assert solid.results[0].pose.covariance[28] > 4.0  # it may as well be turned by 180 degrees


def test_ros2_messages(ros2: dict[str, Any]) -> None:
    calibration = ros2["/camera/camera_info"][0][2]
    assert list(calibration.k) == [700.0, 0, 20.0, 0, 710.0, 30.0, 0, 0, 1]
    assert (calibration.width, calibration.height, calibration.distortion_model) == (
        50,
        50,
        "plumb_bob",
    )
    image = ros2["/camera/image/compressed"][3][2]
    np.testing.assert_allclose(
        cv2.imdecode(np.frombuffer(bytes(image.data), np.uint8), 1), 24, atol=2
    )
    flat = ros2["/camera/detections"][0][2].detections
    assert [
        (d.id, d.results[0].hypothesis.class_id, d.results[0].hypothesis.score) for d in flat
    ] == [
        ("3", "car", 0.5),
        ("7", "traffic light", 0.25),
    ]
    box = flat[1].bbox
    assert (box.center.position.x, box.center.position.y, box.size_x, box.size_y) == (
        20.0,
        30.0,
        20.0,
        20.0,
    )
    (solid,) = ros2["/tracks/detections"][0][2].detections
    (expected, _) = track_objects(frame(0), viewer_columns())
    covariance = np.reshape(solid.results[0].pose.covariance, (6, 6))
    variances = [0.04, 0.01, 0.25, 0.03**2, np.radians(5.0) ** 2, 0.03**2]
    np.testing.assert_allclose(np.diag(covariance), variances)
    assert solid.id == "3"
    position, size = solid.bbox.center.position, solid.bbox.size
    assert (position.x, position.y, position.z) == expected.centre_m
    assert (size.x, size.y, size.z) == expected.lwh_m
    assert [len(message.detections) for _, _, message in ros2["/tracks/detections"]] == [1, 1, 0, 1]
    status = ros2["/tracks/ranges"][0][2].status[0]
    assert (status.name, status.message) == ("track 3", "car")
    figures = {value.key: float(value.value) for value in status.values}
    assert (figures["closing_mps"], figures["observed"]) == (2.0, 1)
    vehicle, transform = ros2["/tf"][0][2].transforms
    assert (transform.header.frame_id, transform.child_frame_id) == ("vehicle", "camera")
    assert (vehicle.header.frame_id, vehicle.child_frame_id) == ("map", "vehicle")
    at, turn = vehicle.transform.translation, vehicle.transform.rotation
    assert (at.x, at.y, at.z) == (8.0, -1.0, 0.0)
    assert 2 * np.arctan2(turn.z, turn.w) == pytest.approx(-0.5)
    assert ros2["/rosout"][0][2].msg == "a note at the end"


def test_ros2_header(tmp_path: Path) -> None:
    with write(tmp_path, info("ros2")).open("rb") as file:
        assert make_reader(file).get_header().profile == "ros2"


# -- times, provenance, discarded frames
# ----------------------------------------------------------------------------


def test_frames_without_rows_and_start(tmp_path: Path) -> None:
    """Replayed frames without rows have times between those of others; without a start, times count
    from 1970."""
    with RunTable() as table:
        for index in (1, 3):
            table.append(frame(index))
        rows = table.to_rows(is_rounded=False)
    writers = OpenWriters(("mcap",), info(settings={}), tmp_path)
    for replayed in frames_of_rows(rows, range(5), ("fused",), 10.0):
        writers.write(replayed)
    writers.close(None)
    read = messages(tmp_path / "run.mcap")
    assert [time for _, time, _ in read["/camera/annotations"]] == [i * 10**8 for i in range(5)]
    assert "/camera/image" not in read
    assert [len(message["tracks"]) for _, _, message in read["/tracks/ranges"]] == [0, 2, 0, 2, 0]


def test_notes_at_the_first_frame(tmp_path: Path) -> None:
    """A run that starts later in the video has no message before its first frame."""
    writers = OpenWriters(("mcap",), info(settings={}, notes=("a note",)), tmp_path)
    writers.write(frame(7))
    writers.close(None)
    (note,) = messages(tmp_path / "run.mcap")["/log"]
    assert (note[1], note[2].message) == (7 * 10**8, "a note")


def test_utc_of_the_frames(tmp_path: Path) -> None:
    """It is that of the column `utc`; the start of a live run is known only approximately."""
    writers = OpenWriters(("mcap",), info(settings={}, start_utc_s=START_S - 1.4), tmp_path)
    for index in range(2):
        shown = frame(index)
        writers.write(replace(shown, frame=replace(shown.frame, utc_s=START_S + shown.time_s)))
    writers.close(None)
    assert [time for _, time, _ in messages(tmp_path / "run.mcap")["/tracks/ranges"]] == times_ns(2)


@pytest.mark.parametrize("start_s", [-1e9, 2.0**31, 9e9])
@pytest.mark.parametrize("profile", ["foxglove", "ros2"])
def test_times_outside_the_format(tmp_path: Path, start_s: float, profile: str) -> None:
    path = write(tmp_path, info(profile, settings={"mcap_profile": profile}, start_utc_s=start_s))
    assert {0 <= time <= 2**31 * 10**9 for _, time, _ in messages(path)["/tracks/ranges"]} == {True}


def test_last_frame_is_discarded(tmp_path: Path) -> None:
    writers = OpenWriters(("mcap",), info(), tmp_path)
    for index in range(3):
        writers.write(frame(index))
    writers.discard_last()
    writers.discard_last()
    writers.write(frame(3))
    writers.close(None)
    read = messages(tmp_path / "run.mcap")["/tracks/ranges"]
    assert [message["frame_time_ns"] for _, _, message in read] == [0, 10**8, 3 * 10**8]


def test_provenance_and_index(tmp_path: Path) -> None:
    with write(tmp_path, info(), 25).open("rb") as file:
        reader = make_reader(file)
        (metadata,) = reader.iter_metadata()
        assert metadata.metadata["track_range.schema_version"] == str(SCHEMA_VERSION)
        summary = reader.get_summary()
        assert summary.statistics.message_count == 6 * 25 + 1
        assert 2 <= len(summary.chunk_indexes) <= 5


# -- failures
# -------------------------------------------------------------------------------------------------------


def complete_times_s(path: Path) -> Iterator[float]:
    """Times of the frames in the complete chunks of a file without an end."""
    with path.open("rb") as file:
        try:
            for _, channel, message in NonSeekingReader(file).iter_messages(log_time_order=False):
                if channel.topic == "/tracks/ranges":
                    yield message.log_time / 1e9
        except (McapError, EOFError, ValueError, struct.error):
            return


@pytest.mark.slow
def test_killed_process(tmp_path: Path) -> None:
    """At most a second and the last frame are lost."""
    program = (
        "import os, sys, signal, pathlib\n"
        "from tests.track_range.results.moving_frames import frame, info\n"
        "from track_range.results.writers import OpenWriters\n"
        "writers = OpenWriters(('mcap',), info(settings={}), pathlib.Path(sys.argv[1]))\n"
        "for index in range(48):\n"
        "    writers.write(frame(index))\n"
        "os.kill(os.getpid(), signal.SIGKILL)\n"
    )
    ended = subprocess.run(
        [sys.executable, "-c", program, str(tmp_path)], cwd=Path(__file__).parents[3], check=False
    )
    assert ended.returncode == -9
    times = list(complete_times_s(tmp_path / "run.mcap"))
    assert times == pytest.approx([index * PERIOD_S for index in range(len(times))])
    assert 4.7 - 1.2 <= times[-1] <= 4.7


def test_cut_short(tmp_path: Path) -> None:
    path = write(tmp_path, info(settings={}), 48)
    content = path.read_bytes()
    last = -1.0
    for n_bytes in range(4000, len(content), 1777):
        path.write_bytes(content[:n_bytes])
        times = list(complete_times_s(path))
        assert (times[-1] if times else -1.0) >= last
        last = times[-1] if times else -1.0
    assert last > 3.0


def test_full_disk(tmp_path: Path) -> None:
    """The chunks before the failure are readable, and the file is named."""
    writers = OpenWriters(("mot", "mcap"), info(settings={}), tmp_path)
    with file_size_limit(9000), pytest.raises(OutputError, match=r"run\.mcap"):  # noqa: PT012
        for index in range(60):
            writers.write(frame(index))
    writers.close(None)
    times = list(complete_times_s(tmp_path / "run.mcap"))
    assert times == pytest.approx([i * PERIOD_S for i in range(len(times))])
    assert len(times) >= 10


@pytest.mark.parametrize("package", ["foxglove", "rosbags"])
def test_missing_package(monkeypatch: pytest.MonkeyPatch, package: str) -> None:
    monkeypatch.setitem(sys.modules, package, None)
    monkeypatch.delitem(sys.modules, f"{package}.typesys", raising=False)
    with pytest.raises(UserError, match=rf"mcap.*{package}:.*pip install 'track-range\[mcap\]'"):
        create_writers(("csv", "mcap"))


def test_options() -> None:
    settings = settings_from(
        {"mono": "a.mp4", "write": "mcap", "mcap_profile": "ros2", "mcap_images": True}
    )
    assert (settings.mcap_profile, settings.mcap_images) == ("ros2", True)
    with pytest.raises(UserError, match="mcap"):
        settings_from({"mono": "a.mp4", "mcap_profile": "ros1"})


@pytest.mark.slow
def test_run(tmp_path: Path, run_on_noise: Callable[..., tr.Run]) -> None:
    list(run_on_noise(tmp_path, overlay=False, write="csv,mcap", mcap_images=True))
    read = messages(tmp_path / "run.mcap")
    assert len(read["/camera/image"]) == len(read["/tracks/ranges"]) == 20
    assert all(math.isfinite(row["distance_m"]) for row in read["/tracks/ranges"][10][2]["tracks"])


def test_layout(foxglove: dict[str, Any]) -> None:
    """The layout names topics and fields that exist, and each panel once."""
    layout = json.loads(LAYOUT.read_text())
    text = json.dumps(layout)
    named = set(re.findall(r'"(/[a-z/]+)', text))
    assert named <= set(foxglove)
    assert {"/camera/image", "/tracks/scene", "/tracks/ranges", "/log"} <= named
    for field in re.findall(r"tracks\[:\]\.(\w+)", text):
        assert field in foxglove["/tracks/ranges"][0][2]["tracks"][0]
    panels = re.findall(r"[A-Za-z0-9]+![a-z]+", json.dumps(layout["layout"]))
    assert sorted(panels) == sorted(layout["configById"])


@pytest.mark.slow
def test_export_of_a_killed_run(tmp_path: Path, run_on_noise: Callable[..., tr.Run]) -> None:
    """All rows of a run of which only settings.yaml and tracks.arrows remain, in the full precision
    of the run."""
    run = run_on_noise(tmp_path, overlay=False, write="parquet,mcap")
    frames = iter(run)
    for _ in range(12):
        next(frames)
    killed = tmp_path / "killed"
    killed.mkdir()
    for name in ("settings.yaml", "tracks.arrows"):
        shutil.copy(tmp_path / name, killed)
    list(frames)
    export(ExportSettings(source=killed, to="mcap", out=tmp_path / "recovered.mcap"))
    export(ExportSettings(source=killed, to="parquet", out=tmp_path / "recovered.parquet"))
    whole, recovered = (
        messages(tmp_path / name)["/tracks/ranges"] for name in ("run.mcap", "recovered.mcap")
    )
    assert [row[2] for row in recovered] == [row[2] for row in whole[: len(recovered)]]
    assert len(recovered) >= 12
    tables = [
        parquet.read_table(tmp_path / name) for name in ("tracks.parquet", "recovered.parquet")
    ]
    assert tables[1].equals(tables[0].slice(0, tables[1].num_rows))
    for key in (b"track_range.settings_hash", b"track_range.schema_version", b"track_range.model"):
        assert tables[1].schema.metadata[key] == tables[0].schema.metadata[key]

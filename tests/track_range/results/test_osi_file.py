"""run_sd.osi, run_gt.osi and run_osi.mcap: read with ASAM's utilities, by the rules of OSI, with
hand-worked numbers."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.exceptions import EndOfFile, McapError
from mcap.reader import NonSeekingReader, make_reader
from osi3trace.osi_trace import OSITrace
from osi_utilities import (
    MessageType,
    MultiTraceReader,
    ReadStatus,
    SingleTraceReader,
    TraceReader,
    infer_message_type_from_filename,
)
from scipy.spatial.transform import Rotation

from tests.support.file_size_limit import file_size_limit
from tests.support.results.frame_results import changed, frame_result
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.foundation.files.output_files import OutputError
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.world.cuboids import Cuboids
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES, ObjectMotion
from track_range.ranging.world.placement import Placement
from track_range.results.formats.adas.osi_messages import HOST_ID, OsiMessages
from track_range.results.formats.run_info import RunInfo
from track_range.results.writers import OpenWriters, create_writer
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(700.0, 700.0, 320.0, 240.0, 640, 480)
LEVEL = Mounting(x_m=1.5, y_m=0.1, z_m=1.3, front_m=3.5)
TURNED = Mounting(yaw_deg=40.0, pitch_deg=6.0, roll_deg=-3.0, x_m=1.5, y_m=-0.4, z_m=1.3)
CLASSES = ("car", "person", "bicycle", "truck", "traffic light", "traffic sign", "bus")
FORMATS = ("osi", "osi-gt", "osi-mcap")


def info(mounting: Mounting | None = LEVEL, **values: Any) -> RunInfo:
    return RunInfo(camera=CAMERA, rig=None, fps=10.0, settings={}, mounting=mounting, **values)


def frame(index: int = 0, **values: Any) -> FrameResult:
    """Tracks 1 to 7 of all kinds: the first is a car 20 m ahead and 2 m to the right, turned by 90
    degrees to the left; nothing is known of the place of the last one.
    """
    n, nan = len(CLASSES), math.nan
    class_id = np.array([ROAD_CLASSES.index(name) for name in CLASSES])
    tracks = Tracks(
        np.arange(1, n + 1), np.tile([300.0, 200.0, 340.0, 260.0], (n, 1)), class_id,
        np.full(n, 0.75), np.arange(n) != 1,
    )  # fmt: skip
    centre_m = np.column_stack([np.linspace(2.0, -4.0, n), np.full(n, 0.5), np.full(n, 20.0)])
    centre_m[-1] = nan
    cuboids = replace(
        Cuboids.unknown(n),
        lwh_m=np.tile([4.4, 1.8, 1.6], (n, 1)),
        lwh_sigma_m=np.tile([0.3, 0.1, 0.2], (n, 1)),
        yaw_deg=np.array([90.0, -120.0, 0.0, 180.0, 0.0, 0.0, 0.0]),
        yaw_sigma_deg=np.full(n, 9.0),
        centre_m=centre_m,
        centre_sigma_m=np.tile([0.2, 0.1, 0.7], (n, 1)),
        centre_correlation=np.zeros((n, 3)),
    )
    placement = replace(
        Placement.unknown(n),
        xyz_m=centre_m,
        xy_sigma_m=np.full((n, 2), 0.2),
        lateral_mps=np.full(n, 1.5),
        lateral_sigma_mps=np.full(n, 0.4),
        age_s=np.full(n, index / 10),
    )
    parked, moving = MOTION_STATES.index("parked"), MOTION_STATES.index("moving")
    motion = replace(
        ObjectMotion.unknown(n),
        state=np.array([parked if index else moving, parked, moving, nan, parked, parked, nan]),
        speed_mps=np.full(n, 2.0),
        heading_deg=np.array([90.0, nan, 0.0, 180.0, nan, nan, nan]),
    )
    given = frame_result(
        Frame(index, index / 10, np.zeros((0, 0, 3), np.uint8), None),
        tracks,
        {"fused_kf": Ranges(tracks.track_id, np.full(n, 20.0), np.full(n, 0.7))},
        closing_mps=np.full(n, 8.0),
        closing_sigma_mps=np.full(n, 0.5),
        motion=motion,
        ego_pose=EgoPose(100.0, -20.0, math.pi / 2, np.diag([0.04, 0.01, 0.0001])),
    )
    world = replace(given.world, cuboids=cuboids, placement=placement)
    ego = EgoMotion(speed_mps=10.0, speed_sigma_mps=0.3, yaw_rad_s=-0.1)
    return replace(given, world=world, ego=ego, **values)


def lanes() -> LaneLines:
    """Lines 1.5 m to the left and 2 m to the right of a camera 1.3 m above a flat road."""
    covariance = np.diag([0.25, 0.0, 0.0])
    left, right = (
        LaneLine(np.array([320 - side * 240, side, 0.0]), covariance, 250.0, 470.0)
        for side in (-1.5 / 1.3, 2.0 / 1.3)
    )
    return LaneLines(left, right)


def sensor_data(mounting: Mounting | None, **values: Any) -> Any:
    return OsiMessages(info(mounting)).of(frame(**values))["SensorData"]


def xyz(vector: Any) -> list[float]:
    return [vector.x, vector.y, vector.z]


def turn(orientation: Any) -> Rotation:
    """The rotation to the parent's axes: yaw first, then pitch, then roll."""
    return Rotation.from_euler("ZYX", [orientation.yaw, orientation.pitch, orientation.roll])


def read(path: Path) -> list[Any]:
    """All messages of a file, by ASAM's readers."""
    reader: TraceReader = MultiTraceReader() if path.suffix == ".mcap" else SingleTraceReader()
    assert reader.open(path)
    messages = []
    while reader.has_next():
        given = reader.read_message()
        assert given is not None
        assert given.status is ReadStatus.OK, given.error_message
        messages.append(given.message)
    reader.close()
    return messages


@pytest.fixture
def written(tmp_path: Path) -> dict[str, list[Any]]:
    """Messages of a run of five frames by file; no pose is known in the third frame."""
    with OpenWriters(FORMATS, info(start_utc_s=1_760_000_000.25), tmp_path) as writers:
        for index in range(5):
            given = frame(index, lanes=lanes())
            if index == 2:
                given = replace(given, world=replace(given.world, ego_pose=EgoPose()))
            if index == 3:  # neither are the speeds of the camera and of what it approaches
                given = changed(given, ego=EgoMotion(), closing_mps=np.full(len(CLASSES), np.nan))
            writers.write(given)
        writers.close({})
    return {path.name: read(path) for path in sorted(tmp_path.iterdir())}


def test_a_car_that_stands_across(tmp_path: Path) -> None:
    data = sensor_data(None)
    assert not data.HasField("mounting_position")
    car = data.moving_object[0]
    assert xyz(car.base.position) == [20.0, -2.0, -0.5]
    assert xyz(car.base_rmse.position) == [0.7, 0.2, 0.1]
    assert car.base.orientation.yaw == pytest.approx(math.pi / 2)
    assert not car.base.orientation.HasField("pitch")
    assert car.base_rmse.orientation.yaw == pytest.approx(math.radians(9.0))
    assert (car.base.dimension.length, car.base.dimension.width) == (4.4, 1.8)
    assert car.base_rmse.dimension.height == 0.2
    assert xyz(car.base.velocity) == [-8.0, -1.5, 0.0]
    sigma_mps = xyz(car.base_rmse.velocity)
    assert sigma_mps == pytest.approx([0.5, math.hypot(0.4, 0.1 * 0.5), 0.3])
    assert (car.header.tracking_id.value, car.header.existence_probability) == (1, 0.75)
    vehicle = car.candidate[0].vehicle_classification
    assert (vehicle.type, car.candidate[0].type) == (vehicle.TYPE_CAR, 2)
    states = [item.header.measurement_state for item in data.moving_object]
    assert states == [car.header.MEASUREMENT_STATE_MEASURED, 3, 2, 2]
    # a bus without a place is not there, lights and signs are beside the road users
    assert [item.header.tracking_id.value for item in data.traffic_light] == [5]
    assert [item.header.tracking_id.value for item in data.traffic_sign] == [6]
    assert data.traffic_sign[0].main_sign.base.position.x == 20.0


@pytest.mark.parametrize("mounting", [LEVEL, TURNED])
def test_a_sensor_that_is_mounted(mounting: Mounting) -> None:
    """By the mounting position, objects are where the program has them in the vehicle, upright."""
    data, places = sensor_data(mounting), frame().cuboids.in_vehicle(mounting)
    mounted = data.mounting_position
    vehicle_from_sensor = turn(mounted.orientation)
    for i, item in enumerate(data.moving_object):
        in_vehicle_m = vehicle_from_sensor.apply(xyz(item.base.position)) + xyz(mounted.position)
        np.testing.assert_allclose(in_vehicle_m, places.centre_m[i])
        upright = (vehicle_from_sensor * turn(item.base.orientation)).as_euler("ZYX", degrees=True)
        away_deg = (upright - [places.yaw_deg[i], 0.0, 0.0] + 180) % 360 - 180
        np.testing.assert_allclose(away_deg, 0.0, atol=1e-9)
    assert data.mounting_position_rmse.orientation.pitch == pytest.approx(math.radians(2.0))


def test_a_camera_at_an_unknown_height() -> None:
    mounting = replace(LEVEL, z_m=None)
    data = sensor_data(mounting, lanes=lanes())
    assert not data.mounting_position.position.HasField("z")
    assert not data.lane_boundary
    truth = OsiMessages(info(mounting)).of(frame())["GroundTruth"]
    assert [item.base.position.z for item in truth.moving_object] == [0.75, 0.8, 0.8, 0.8, 0.8]


def test_lines_of_the_lane() -> None:
    data = sensor_data(LEVEL, lanes=lanes())
    for line, y_m in zip(data.lane_boundary, (1.5, -2.0), strict=True):
        points = np.array([xyz(point.position) for point in line.boundary_line])
        np.testing.assert_allclose(points[:, 1:], np.tile([y_m, -1.3], (len(points), 1)))
        assert points[0, 0] == pytest.approx(700 * 1.3 / 230)
        assert (np.diff(points[:, 0]) > 0).all()
        sigmas = np.array([xyz(point.position) for point in line.boundary_line_rmse])
        assert (sigmas[:, 0] <= points[:, 0] * 0.25 + 1e-9).all()
        assert (sigmas > 0).all()
    assert not sensor_data(LEVEL).lane_boundary


def test_movement_states() -> None:
    """What has moved and is at rest has stopped; what was always at rest is stationary."""
    messages = OsiMessages(info())
    states = [
        [item.movement_state for item in messages.of(frame(index))["SensorData"].moving_object]
        for index in (0, 1)
    ]
    assert states == [[3, 2, 3, 0], [4, 2, 3, 0]]


@pytest.mark.parametrize("mounting", [None, LEVEL, TURNED])
def test_the_same_world_in_all_messages(mounting: Mounting | None) -> None:
    """SensorData over the mounting and the ego vehicle of GroundTruth give its objects."""
    data, own, truth = OsiMessages(info(mounting)).of(frame()).values()
    host = truth.moving_object[0]
    assert (truth.host_vehicle_id.value, host.id.value, own.host_vehicle_id.value) == (HOST_ID,) * 3
    assert xyz(own.location.position) == xyz(host.base.position)
    assert own.location_rmse.velocity.y > 0.29 > own.location_rmse.velocity.x
    map_from_host = turn(host.base.orientation)
    if mounting is None:
        centre_m = [100.0, -20.0 + WarningSettings().front_m - host.base.dimension.length / 2, 0.75]
        np.testing.assert_allclose(xyz(host.base.position), centre_m)
        assert not host.vehicle_attributes.HasField("bbcenter_to_rear")
        return
    reference_m = xyz(host.base.position) + map_from_host.apply(
        xyz(host.vehicle_attributes.bbcenter_to_rear)
    )
    mounted = data.mounting_position
    for item, true in zip(data.moving_object, truth.moving_object[1:], strict=True):
        in_vehicle_m = turn(mounted.orientation).apply(xyz(item.base.position))
        in_map_m = reference_m + map_from_host.apply(in_vehicle_m + xyz(mounted.position))
        np.testing.assert_allclose(in_map_m, xyz(true.base.position), atol=1e-9)
    # the camera drives at 10 m/s along its axis, which looks along y of the map, and turns to the left
    lever_m = np.subtract(xyz(host.base.position), [100.0, -20.0, 0.75])
    velocity_mps = [-0.1 * lever_m[1], 10.0 + 0.1 * lever_m[0], 0.0]
    np.testing.assert_allclose(xyz(host.base.velocity), velocity_mps, atol=1e-12)
    assert host.base.orientation_rate.yaw == pytest.approx(0.1)


# -- Rules of the standard
# -------------------------------------------------------------------------------------------------------


def fields(message: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """All values that are set, with their paths."""
    for field, value in message.ListFields():
        for part in value if field.is_repeated else [value]:
            name = f"{path}.{field.name}"
            if field.message_type is None:
                yield name, part
            else:
                yield name, part
                yield from fields(part, name)


def check_rules(message: Any) -> None:
    """Rules of the comments of OSI 3, as osi-validation has them in its folder `rules`."""
    for path, value in fields(message):
        name = path.rpartition(".")[2]
        if isinstance(value, float):
            assert math.isfinite(value), path
        if name in ("length", "width", "height", "age", "seconds") or "rmse" in path:
            assert not isinstance(value, float | int) or value >= 0, path
        if name == "velocity" and "rmse" not in path:
            assert len(value.ListFields()) == 3, path
        if name == "nanos":
            assert 0 <= value <= 999_999_999
        if "probability" in name:
            assert 0 <= value <= 1, path
        if name in ("roll", "pitch", "yaw") and "rate" not in path:
            assert -math.pi - 1e-12 < value <= math.pi, path
        if name == "moving_object" and hasattr(value, "candidate"):
            assert sum(candidate.probability for candidate in value.candidate) == 1.0
    assert (message.version.version_major, message.HasField("timestamp")) == (3, True)


def check_ground_truth(truth: Any) -> None:
    """Rules of GroundTruth: unique identities, one of which is the host's; nothing is unknown. The
    type of a vehicle needs its classification and attributes. esmini's traces have the same fields.
    """
    identities = [item.id.value for item in truth.moving_object]
    assert len(set(identities)) == len(identities)
    assert truth.host_vehicle_id.value in identities
    for item in truth.moving_object:
        assert item.type in (item.TYPE_VEHICLE, item.TYPE_PEDESTRIAN)
        for name in ("dimension", "position", "orientation"):
            assert item.base.HasField(name)
            assert len(getattr(item.base, name).ListFields()) == 3
        if item.type == item.TYPE_VEHICLE:
            assert item.HasField("vehicle_attributes")
            assert item.vehicle_classification.type > 1


def test_files_are_read_by_asams_utilities(written: dict[str, list[Any]], tmp_path: Path) -> None:
    names = {name: Counter(type(m).__name__ for m in given) for name, given in written.items()}
    assert names == {
        "run_sd.osi": {"SensorData": 5},
        "run_gt.osi": {"GroundTruth": 4},
        "run_osi.mcap": {"SensorData": 5, "GroundTruth": 4, "HostVehicleData": 4},
    }
    assert infer_message_type_from_filename("run_gt.osi") is MessageType.GROUND_TRUTH
    for message in chain(*written.values()):
        check_rules(message)
        if type(message).__name__ == "GroundTruth":
            check_ground_truth(message)
    in_mcap = [m for m in written["run_osi.mcap"] if type(m).__name__ == "SensorData"]
    assert [m.SerializeToString() for m in in_mcap] == [
        m.SerializeToString() for m in written["run_sd.osi"]
    ]
    host = written["run_gt.osi"][2].moving_object[0]
    assert not host.base.HasField("velocity")
    assert not in_mcap[3].moving_object[0].base.HasField("velocity")
    times = [(m.timestamp.seconds, m.timestamp.nanos) for m in in_mcap]
    assert times == [(0, index * 100_000_000) for index in range(5)]


@pytest.mark.parametrize(("name", "topic"), [("run_sd.osi", None), ("run_osi.mcap", "SensorData")])
def test_files_are_read_by_osi_python(
    written: dict[str, list[Any]], tmp_path: Path, name: str, topic: str | None
) -> None:
    trace = OSITrace(str(tmp_path / name), "SensorData", topic=topic)
    assert [len(message.moving_object) for message in trace] == [4] * 5
    trace.close()


def test_rules_can_fail(written: dict[str, list[Any]]) -> None:
    data, truth = written["run_sd.osi"][0], written["run_gt.osi"][0]
    data.moving_object[0].base.position.x = math.nan
    truth.moving_object[1].id.value = HOST_ID
    with pytest.raises(AssertionError):
        check_rules(data)
    with pytest.raises(AssertionError):
        check_ground_truth(truth)


def test_metadata_of_the_multi_channel_trace(written: dict[str, list[Any]], tmp_path: Path) -> None:
    """What the chapter on multi-channel trace files demands, as ASAM's reader and MCAP's see it."""
    path = tmp_path / "run_osi.mcap"
    reader = MultiTraceReader()
    assert reader.open(path)
    (own,) = [m["data"] for m in reader.get_file_metadata() if m["name"] == "net.asam.osi.trace"]
    assert own["version"] == own["min_osi_version"] == own["max_osi_version"]
    assert own["version"].count(".") == own["min_protobuf_version"].count(".") == 2
    assert own["zero_time"] == "2025-10-09T08:53:20.250000+00:00"
    keys = {f"net.asam.osi.trace.channel.{name}" for name in ("osi_version", "protobuf_version")}
    for channel in reader.list_channel_specifications():
        assert keys <= channel.metadata.keys()
    reader.close()
    by_own_schemas = MultiTraceReader("mcap-contained")
    assert by_own_schemas.open(path)
    n_messages = 0
    while by_own_schemas.has_next():
        assert by_own_schemas.read_message().status is ReadStatus.OK
        n_messages += 1
    by_own_schemas.close()
    assert n_messages == 13
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == 13
    assert summary.chunk_indexes
    assert {(schema.name, schema.encoding) for schema in summary.schemas.values()} == {
        ("osi3.SensorData", "protobuf"),
        ("osi3.GroundTruth", "protobuf"),
        ("osi3.HostVehicleData", "protobuf"),
    }


def test_a_killed_run_leaves_its_frames(tmp_path: Path) -> None:
    """All frames in .osi, and all chunks but the last in MCAP."""
    writers = [create_writer(name) for name in FORMATS]
    for writer in writers:
        writer.open(info(), tmp_path)
        for index in range(40):
            writer.write(frame(index, lanes=lanes()))
    assert len(read(tmp_path / "run_sd.osi")) == len(read(tmp_path / "run_gt.osi")) == 40
    in_mcap = []
    with (tmp_path / "run_osi.mcap").open("rb") as file, suppress(EndOfFile, McapError):
        messages = NonSeekingReader(file).iter_messages(log_time_order=False)
        in_mcap.extend(message.log_time for *_, message in messages)
    assert 3 * 20 < len(in_mcap) < 3 * 40
    for writer in writers:
        writer.close(None)


def test_the_last_frame_is_discarded(tmp_path: Path) -> None:
    writers = [create_writer(name) for name in FORMATS]
    for writer in writers:
        writer.open(info(), tmp_path)
        for index in range(3):
            writer.write(frame(index))
        writer.discard_last()  # type: ignore[attr-defined]
        writer.close(None)
    counts = {path.name: len(read(path)) for path in tmp_path.iterdir()}
    assert counts == {"run_sd.osi": 2, "run_gt.osi": 2, "run_osi.mcap": 6}


@pytest.mark.parametrize("name", ["osi", "osi-mcap"])
def test_full_disk(tmp_path: Path, name: str) -> None:
    with OpenWriters((name,), info(), tmp_path) as writers:
        path = next(tmp_path.iterdir())
        for index in range(10):
            writers.write(frame(index, lanes=lanes()))
        limit = file_size_limit(path.stat().st_size + 40)
        with limit, pytest.raises(OutputError, match=path.name):
            deque(map(writers.write, map(frame, range(10, 200))), maxlen=0)
    if name == "osi":
        assert len(read(path)) == 10

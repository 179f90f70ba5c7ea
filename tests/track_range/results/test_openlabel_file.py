"""run.openlabel.json: no finding of openlabel-checker, and the values of the rows."""

import json
from dataclasses import replace

import numpy as np
import pytest

from tests.support.results.frame_results import INFO, changed, result
from tests.track_range.results.moving_frames import frame
from track_range.detection.formats.label_formats import read_labels
from track_range.ranging.world.ego_path import EgoPose
from track_range.results.formats.adas.openlabel_file import OPENLABEL_FILE, OpenLabelWriter
from track_range.stereo.geometry.mounting import Mounting

EVENT = {
    "kind": "cut_in",
    "start_s": 0.2,
    "end_s": 0.3,
    "track_id": 3,
    "reason": "",
    "min_ttc_s": None,
}
INFO = replace(
    INFO,
    settings={"stereo": ["rtsp://user:word@host/left.mp4?key=1", "/videos/right.mp4"]},
    mounting=Mounting(yaw_deg=10.0, x_m=1.5, z_m=1.2),
    start_utc_s=1_760_000_000.0,
    events=lambda: [EVENT, EVENT | {"track_id": 99}],
)


@pytest.fixture
def written(tmp_path):
    """Writes frames; the path of the file."""

    def write(frames, info=INFO, *, discarded=()):
        writer = OpenLabelWriter()
        writer.open(info, tmp_path)
        for each in frames:
            writer.write(each)
            if each.index in discarded:
                writer.discard_last()
        writer.close({})
        return tmp_path / OPENLABEL_FILE

    return write


def findings(path):
    checker = pytest.importorskip("openlabel_checker", reason="openlabel-checker (extra dev)")
    return [(issue.severity.value, issue.message) for issue in checker.check_file(path).issues]


def with_cuboid(index):
    """Frame `index`, whose first track has a cuboid that looks as the camera does, 20 m ahead."""
    given = frame(index)
    cuboids = given.cuboids
    values = {
        "lwh_m": (4.0, 2.0, 1.5),
        "lwh_sigma_m": (0.4, 0.2, 0.1),
        "centre_m": (1.0, 0.5, 22.0),
        "centre_sigma_m": (0.1, 0.2, 0.3),
        "centre_correlation": (0.0, 0.5, 0.0),
        "yaw_deg": 0.0,
        "yaw_sigma_deg": 3.0,
    }
    columns = {name: np.array(getattr(cuboids, name)) for name in values}
    if index != 2:  # the first track is absent in it
        for name, column in columns.items():
            column[0] = values[name]
    world = replace(given.world, cuboids=replace(cuboids, **columns))
    return replace(given, world=world)


def test_no_finding_of_the_checker(written):
    path = written([with_cuboid(index) for index in (0, 1, 2, 3, 6, 9)])
    assert findings(path) == []
    content = json.loads(path.read_text())["openlabel"]
    car = content["objects"]["3"]
    assert (car["type"], car["name"]) == ("VehicleCar", "car 3")
    spans = [{"frame_start": 0, "frame_end": 1}, {"frame_start": 3, "frame_end": 9}]
    assert (
        car["frame_intervals"] == car["object_data_pointers"]["cuboid"]["frame_intervals"] == spans
    )
    assert [span["frame_end"] for span in content["frame_intervals"]] == [3, 6, 9]
    assert content["streams"]["camera"]["uri"] == "left.mp4"
    assert content["frames"]["1"]["frame_properties"]["timestamp"] == 1_760_000_000.1
    assert [action["type"] for action in content["actions"].values()] == ["cut_in"] * 2
    assert content["actions"]["0"]["frame_intervals"] == [{"frame_start": 2, "frame_end": 3}]
    assert list(content["relations"]) == ["0"]  # not of a track that is not in the file


def test_read_again(written):
    frames = [with_cuboid(index) for index in (0, 1, 3)]
    path = written(frames)
    table = read_labels(path)
    assert table.frame.tolist() == [0, 0, 1, 1, 3, 3]
    assert table.track_id.tolist() == [3, 7] * 3
    assert table.class_id.tolist() == frames[0].tracks.class_id.tolist() * 3
    np.testing.assert_allclose(table.xyxy_px[:2], frames[0].tracks.xyxy_px, atol=1e-4)
    np.testing.assert_allclose(table.score[:2], frames[0].tracks.score)
    assert table.observed.tolist() == frames[0].tracks.observed.tolist() * 3
    np.testing.assert_allclose(table.distance_m[:2], [12.0, np.nan])
    assert table.video.is_rectified
    assert (table.video.fps, table.video.name) == (pytest.approx(10), "left")
    content = json.loads(path.read_text())  # without the distances, those of the cuboids
    for each in content["openlabel"]["frames"].values():
        data = each["objects"]["3"]["object_data"]
        del data["num"]
        # a ray that is 1 m to the right and 0.5 m down at 20 m
        data["bbox"][0]["val"] = [320.5 + 35, 240.5 + 17.5, 100, 80]
    path.write_text(json.dumps(content))
    assert np.isnan(read_labels(path).distance_m).all()  # as measured, not of the filtered cuboid
    del content["openlabel"]["metadata"]["track_range.pixels"]
    path.write_text(json.dumps(content))
    assert read_labels(path).distance_m[::2] == pytest.approx(20.0)


def test_poses_and_their_axes(written):
    """A point of the vehicle is where `map` has it: ahead of the camera along its heading."""
    poses = [EgoPose(8.0, -1.0, np.radians(100.0), np.zeros((3, 3))), EgoPose()]
    path = written([changed(result(i), ego_pose=pose) for i, pose in enumerate(poses)])
    assert findings(path) == []
    content = json.loads(path.read_text())["openlabel"]
    step = content["frames"]["0"]["frame_properties"]["transforms"]["vehicle-iso8855_to_map"]
    moved = step["transform_src_to_dst"]
    # the camera looks 10 degrees to the left of the vehicle, which drives along y
    assert moved["quaternion"] == pytest.approx([0, 0, np.sqrt(0.5), np.sqrt(0.5)])
    assert moved["translation"] == pytest.approx([8.0, -2.5, 0.0])
    assert "transforms" not in content["frames"]["1"]["frame_properties"]


def test_discarded_frames_are_in_no_part(written):
    path = written([frame(index) for index in (0, 1, 3)], discarded=(0, 3))
    assert findings(path) == []
    content = json.loads(path.read_text())["openlabel"]
    assert list(content["frames"]) == ["1"]
    assert content["objects"]["3"]["frame_intervals"] == [{"frame_start": 1, "frame_end": 1}]


def test_a_run_without_frames(written):
    path = written([])
    assert findings(path) == []

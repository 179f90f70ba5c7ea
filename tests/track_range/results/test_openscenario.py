"""run.xosc: valid by ASAM's schema, with the positions of the rows."""

import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.support.results.frame_results import (
    INFO,
    changed,
    cuboids,
    result,
    with_unknown,
    writing,
)
from tests.track_range.results.moving_frames import frame
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import MOTION_STATES, ObjectMotion
from track_range.results.formats.adas.openscenario_file import OpenScenarioWriter
from track_range.stereo.geometry.mounting import Mounting


@pytest.fixture(scope="module")
def schema():
    xmlschema = pytest.importorskip("xmlschema", reason="xmlschema is not installed (extra dev)")
    schemas = pytest.importorskip(
        "schemas", reason="scenariogeneration is not installed (extra dev)"
    )
    return xmlschema.XMLSchema(Path(next(iter(schemas.__path__))) / "OpenSCENARIO_1_2.xsd")


def moved(index, *, state="moving", x_m=(30.0, 60.0), heading_deg=0.0, **cuboid):
    """Frame `index` of an ego vehicle that drives along x at 1 m per frame; the centre of the
    cuboid of its car is 2 m behind its visible side.
    """
    given = result(index)
    pair = np.array
    motion = ObjectMotion(
        pair([8.0, np.nan]), pair([0.4, np.nan]), pair([heading_deg, np.nan]), pair(x_m), pair([2.0, 3.0]),
        pair([float(MOTION_STATES.index(state)), np.nan]), pair([0.9, np.nan]),
    )  # fmt: skip
    pose = EgoPose(1.0 * index, 0.0, 0.0, np.zeros((3, 3)))
    boxes = with_unknown(cuboids(world_m=[x_m[0] + 2.0, 2.0, np.nan], **cuboid))
    return changed(
        given,
        frame=replace(given.frame, time_s=index / 10),
        motion=motion,
        ego_pose=pose,
        cuboids=boxes,
    )


def written(folder, frames, **info):
    with writing(folder, ("openscenario",), replace(INFO, **info)) as rows:
        for each in frames:
            rows.write(each)
    return folder / "run.xosc"


def root_of(path):
    return ElementTree.parse(path).getroot()  # noqa: S314 - a file of this test


def vertices(root, name):
    """(N, 4) time, x, y and heading of an object's trajectory."""
    path = root.find(f".//Trajectory[@name='{name} path']")
    rows = [
        (vertex.get("time"), *(vertex.find(".//WorldPosition").get(key) for key in "xyh"))
        for vertex in path.iter("Vertex")
    ]
    return np.array(rows, np.float64)


def test_valid_with_the_positions_of_the_rows(tmp_path, schema):
    path = written(tmp_path, [moved(index, x_m=(30.0 + index, 60.0)) for index in range(2, 7)])
    schema.validate(path)
    root = root_of(path)
    ego, car = vertices(root, "ego"), vertices(root, "car-3")
    np.testing.assert_allclose(ego, [[0.1 * i, 2.0 + i, 0.0, 0.0] for i in range(5)], atol=1e-3)
    np.testing.assert_allclose(car[:, 1], 34.0 + np.arange(5))
    np.testing.assert_allclose(car[:, 2:], np.tile([2.0, 0.0], (5, 1)))
    size = root.find(".//ScenarioObject[@name='car-3']//Dimensions").attrib
    assert size == {"width": "1.80", "length": "4.00", "height": "1.50"}
    # no traffic light
    assert [given.get("name") for given in root.iter("ScenarioObject")] == ["ego", "car-3"]


def test_parked_objects_do_not_move_and_headings_do_not_turn(tmp_path):
    parked = [
        moved(i, state="parked", x_m=(30.0 + 0.5 * (-1) ** i, 60.0), yaw_deg=yaw_deg, front_known=False)
        for i, yaw_deg in enumerate((170.0, -6.0, 178.0, 174.0, 174.0))
    ]  # fmt: skip
    rows = vertices(root_of(written(tmp_path, parked)), "car-3")
    assert np.ptp(rows[:, 1:], axis=0).max() == 0
    assert rows[0, 3] == pytest.approx(math.radians(174.0), abs=1e-4)
    moving = [
        moved(i, yaw_deg=yaw_deg, front_known=i == 2)
        for i, yaw_deg in enumerate((84, -90, 92, -88))
    ]
    headings = np.degrees(vertices(root_of(written(tmp_path, moving)), "car-3")[:, 3])
    np.testing.assert_allclose(headings, [84, 90, 92, 92], atol=0.01)


def test_sure_sizes_count_more(tmp_path):
    frames = [
        moved(0, lwh_m=[4.0, 1.8, 1.5], lwh_sigma_m=[0.4, 0.1, np.nan]),
        moved(1, lwh_m=[5.0, 1.6, 1.7], lwh_sigma_m=[0.2, 0.1, np.nan]),
    ]
    root = root_of(written(tmp_path, frames))
    size = root.find(".//ScenarioObject[@name='car-3']//Dimensions")
    assert size.attrib == {"length": "4.80", "width": "1.70", "height": "1.60"}


def test_objects_appear_and_disappear(tmp_path, schema):
    frames = [
        changed(frame(2), ego_pose=EgoPose(0.0, 0.0, 0.0, np.zeros((3, 3)))),
        moved(4),
        moved(5),
    ]
    path = written(tmp_path, frames)
    schema.validate(path)
    root = root_of(path)
    events = {
        event.get("name"): event.find(".//SimulationTimeCondition").get("value")
        for event in root.iter("Event")
    }
    start_s = frames[0].time_s
    assert float(events["car-3 appears"]) == pytest.approx(0.4 - start_s, abs=1e-3)
    assert float(events["car-3 disappears"]) == pytest.approx(0.5 - start_s, abs=1e-3)
    assert [given.get("entityRef") for given in root.iter("Private")] == ["ego"]


def test_a_run_without_poses_is_valid(tmp_path, schema):
    path = written(tmp_path, [changed(result(0), ego_pose=EgoPose())])
    schema.validate(path)
    assert list(root_of(path).iter("ScenarioObject")) == []


def test_a_discarded_frame_is_not_written(tmp_path):
    writer = OpenScenarioWriter()
    writer.open(INFO, tmp_path)
    for index in (2, 3, 4):
        writer.write(moved(index))
    writer.discard_last()
    writer.discard_last()  # a second call does nothing
    writer.write(changed(moved(5), ego_pose=EgoPose()))
    writer.discard_last()
    writer.close(None)
    root = root_of(tmp_path / "run.xosc")
    assert vertices(root, "ego")[:, 1].tolist() == [2.0, 3.0]
    assert len(vertices(root, "car-3")) == 2


@pytest.mark.slow
def test_a_run_names_the_files_that_it_has(tmp_path, run_on_noise):
    """Without a known position there is no road."""
    run = run_on_noise(tmp_path, overlay=False, write="csv,openscenario")
    list(run)
    names = {file.name for file in run.files}
    assert "run.xosc" in names
    assert "run.xodr" not in names
    assert all(file.exists() for file in run.files)


def test_box_of_the_ego_vehicle_is_where_the_mounting_states_it(tmp_path):
    """Its front is 2 m before the camera, which is 0.5 m to the right of its middle."""
    mounting = Mounting(yaw_deg=-58.0, x_m=1.5, y_m=-0.5, front_m=3.5)
    root = root_of(written(tmp_path, [moved(0)], mounting=mounting))
    centre = root.find("Entities/ScenarioObject[@name='ego']//Center").attrib
    assert centre == {"x": "-0.10", "y": "0.50", "z": "0.75"}


def test_vehicles_whose_state_is_unknown_make_no_lanes(tmp_path):
    """Speeds of new tracks are rough: that of a parked car may point backwards."""
    lanes = {}
    for state in (float(MOTION_STATES.index("oncoming")), math.nan):
        frames = [moved(index, x_m=(70.0 - index, 60.0)) for index in range(30)]
        motions = [replace(each.motion, state=np.array([state, math.nan])) for each in frames]
        boxes = [
            with_unknown(cuboids(world_m=[70.0 - i, 3.5, math.nan], yaw_deg=180.0))
            for i in range(30)
        ]
        given = [
            changed(f, motion=m, cuboids=b) for f, m, b in zip(frames, motions, boxes, strict=True)
        ]
        written(tmp_path, given)
        road = root_of(tmp_path / "run.xodr")
        lanes[math.isnan(state)] = [int(lane.get("id")) for lane in road.iter("lane")]
    assert lanes == {False: [1, 0, -1], True: [0, -1]}

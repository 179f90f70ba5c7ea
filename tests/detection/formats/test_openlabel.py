"""Files of ASAM OpenLABEL: cameras, coordinate systems, cuboids, and what is refused."""

from __future__ import annotations

import copy
import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.detection.formats.tool_files import FILES
from track_range.detection.formats.label_formats import read_labels
from track_range.detection.formats.tables.box_table import BoxTable, VideoFacts
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.ranging.truth.reference_distance import surface_distance_m

CAR = "00000007-0000-4000-8000-000000000000"
HALF = math.sqrt(0.5)
# of a camera that looks along x, 1.5 m above the vehicle's origin and 1 m ahead of it
CAMERA_POSE = {"quaternion": [-0.5, 0.5, -0.5, 0.5], "translation": [1.0, 0.0, 1.5]}
SYSTEMS = {
    "world": {"type": "scene_cs", "parent": ""},
    "vehicle": {"type": "local_cs", "parent": "world"},
    "CAM": {"type": "sensor_cs", "parent": "vehicle", "pose_wrt_parent": CAMERA_POSE},
    "LIDAR": {
        "type": "sensor_cs",
        "parent": "vehicle",
        "pose_wrt_parent": {"euler_angles": [math.pi / 2, 0, 0], "translation": [0, 0, 2]},
    },
}


def document(**parts: Any) -> dict[str, Any]:
    """The reference file of tool_files, with other parts."""
    content: Any = copy.deepcopy(FILES["openlabel"])
    content["openlabel"].update(parts)
    return content["openlabel"]


def read(tmp_path: Path, root: Any, name: str = "labels.json") -> BoxTable:
    path = tmp_path / name
    path.write_text(json.dumps({"openlabel": root}))
    return read_labels(path)


def cuboid(val: list[float], system: str = "vehicle") -> dict[str, Any]:
    return {"name": "box3d", "coordinate_system": system, "val": val}


def with_cuboid(item: dict[str, Any], *, has_boxes: bool = False) -> dict[str, Any]:
    """A car 20 m ahead of the camera in frame 0, as a cuboid."""
    data = {"cuboid": [item]}
    if has_boxes:
        box = {"name": "box", "coordinate_system": "CAM", "val": [50.5, 25.5, 8, 6]}
        data["bbox"] = [box]
    return document(
        coordinate_systems=SYSTEMS, frames={"0": {"objects": {CAR: {"object_data": data}}}}
    )


def test_facts_and_values(tmp_path: Path) -> None:
    root = document()
    root["metadata"]["track_range.pixels"] = "rectified"
    root["objects"][CAR]["type"] = "https://openlabel.asam.net/V1-0-0/ontologies/VehicleCar"
    data = root["frames"]["0"]["objects"][CAR]["object_data"]
    data["num"] = [{"name": "score", "val": 0.3}, {"name": "distance_m", "val": 12.5}]
    data["bbox"][0]["attributes"] = {
        "num": [{"name": "score", "val": 0.75}, {"name": "sigma_m", "val": 0.5}],
        "boolean": [{"name": "predicted", "val": True}],
    }
    table = read(tmp_path, root)
    assert table.video == VideoFacts("a", 3, 0, (100, 50), pytest.approx(10), is_rectified=True)
    assert table.class_name.tolist() == ["car", "car", "pedestrian"]
    assert (table.score[0], table.distance_m[0], table.sigma_m[0]) == (0.75, 12.5, 0.5)
    assert table.observed.tolist() == [False, True, True]
    assert np.isnan(table.distance_m[1:]).all()


@pytest.mark.parametrize(
    "item",
    [
        cuboid([23.0, 0, 1.5, 0, 0, 0, 4, 2, 1.5]),  # centre 22 m ahead of the camera, 4 m long
        cuboid([23.0, 0, 1.5, 0, 0, HALF, HALF, 2, 4, 1.5]),  # turned by a quarter, as of Kognic
        cuboid([23.0, 0, 1.5, 0, 0, math.pi / 2, 2, 4, 1.5]),
        cuboid([0, 0, 22, 0, 0, 0, 2, 1.5, 4], "CAM"),
        cuboid([0, -23, -0.5, 0, 0, 0, 2, 4, 1.5], "LIDAR"),  # x of the lidar is the vehicle's y
    ],
)
@pytest.mark.parametrize("has_boxes", [True, False])
def test_cuboids_in_any_system(tmp_path: Path, item: dict[str, Any], has_boxes: bool) -> None:
    table = read(tmp_path, with_cuboid(item, has_boxes=has_boxes))
    assert table.distance_m == pytest.approx(20.0)
    half = (4, 3) if has_boxes else (5, 3.75)  # 1 m and 0.75 m at 20 m
    np.testing.assert_allclose(
        table.xyxy_px, [[50 - half[0], 25 - half[1], 50 + half[0], 25 + half[1]]], atol=1e-9
    )


def test_poses_of_frames(tmp_path: Path) -> None:
    """A parked car in the world, which the vehicle approaches with 1 m per frame."""
    root = with_cuboid(cuboid([103, 50, 1.5, 0, 0, 0, 4, 2, 1.5], "world"))
    root["objects"] = {CAR: root["objects"][CAR] | {
        "frame_intervals": [{"frame_start": 4, "frame_end": 5}],
        "object_data": root["frames"]["0"]["objects"][CAR]["object_data"],
    }}  # fmt: skip
    move = {"src": "vehicle", "dst": "world"}
    root["frames"] = {
        str(f): {"frame_properties": {"transforms": {"ego": move | {"transform_src_to_dst": {
            "matrix4x4": [1, 0, 0, 76 + f, 0, 1, 0, 50, 0, 0, 1, 0, 0, 0, 0, 1],
        }}}}}
        for f in (3, 4, 5)
    }  # fmt: skip
    table = read(tmp_path, root)
    assert table.frame.tolist() == [4, 5]
    assert table.distance_m == pytest.approx([20.0, 19.0])
    del root["frames"]["4"]["frame_properties"]  # without the pose, it has no place in the image
    table = read(tmp_path, root)
    assert table.frame.tolist() == [5]
    assert "that no camera shows (1)" in table.notes[-1]


def test_distances_are_those_of_kitti_labels_with_the_same_boxes(tmp_path: Path) -> None:
    """An independent implementation, on boxes in KITTI's convention (bottom centre, yaw about y)."""
    rng = np.random.default_rng(1)
    n = 60
    location_m = rng.uniform([-8, 0.5, 8], [8, 2.5, 60], (n, 3))
    hwl_m, yaw_rad = rng.uniform([1, 1, 2], [3, 2.5, 9], (n, 3)), rng.uniform(-3, 3, n)
    middle_px = 100 * location_m[:, :2] / location_m[:, 2:] + [50, 25 - 3]
    rays = np.column_stack([(middle_px - [50, 25]) / 100, np.ones(n)])
    expected = surface_distance_m(rays, location_m, size_hwl_m=hwl_m, rotation_y_rad=yaw_rad)
    objects: Any = {}
    for i, ((x, y, z), (h, w, length)) in enumerate(zip(location_m, hwl_m, strict=True)):
        box = {"name": "box", "coordinate_system": "CAM", "val": [*(middle_px[i] + 0.5), 4, 4]}
        val = [x, y - h / 2, z, 0, yaw_rad[i], 0, length, h, w]
        objects[str(i)] = {"object_data": {"bbox": [box], "cuboid": [cuboid(val, "CAM")]}}
    root = document(
        coordinate_systems={"CAM": {"type": "sensor_cs", "parent": ""}},
        objects={uid: {"name": uid, "type": "car"} for uid in objects},
        frames={"0": {"objects": objects}},
    )
    assert 30 < np.isfinite(expected).sum() < n  # some rays miss
    np.testing.assert_allclose(read(tmp_path, root).distance_m, expected, rtol=1e-9)


def test_camera_with_axes_of_a_vehicle(tmp_path: Path) -> None:
    systems = copy.deepcopy(SYSTEMS)
    systems["CAM"]["pose_wrt_parent"]["quaternion"] = [0, 0, 0, 1]
    root = with_cuboid(cuboid([23.0, 0, 1.5, 0, 0, 0, 4, 2, 1.5]), has_boxes=True)
    assert read(tmp_path, root | {"coordinate_systems": systems}).distance_m == pytest.approx(20.0)


def test_system_of_a_cuboid(tmp_path: Path) -> None:
    """It may be that of the stream, as of Kognic and VisionAI, or of the object, else unknown."""
    item = cuboid([0, -23, -0.5, 0, 0, 0, 2, 4, 1.5], "LIDAR")
    item["stream"] = item.pop("coordinate_system")
    root = with_cuboid(item, has_boxes=True)
    assert read(tmp_path, root).distance_m == pytest.approx(20.0)
    del item["stream"]
    assert np.isnan(read(tmp_path, root).distance_m).all()
    root["objects"][CAR]["coordinate_system"] = "LIDAR"
    assert read(tmp_path, root).distance_m == pytest.approx(20.0)


def test_hidden_cuboids_and_cuboids_that_are_elsewhere_give_no_distance(tmp_path: Path) -> None:
    root = with_cuboid(cuboid([23.0, 0, 1.5, 0, 0, 0, 4, 2, 1.5]), has_boxes=True)
    data = root["frames"]["0"]["objects"][CAR]["object_data"]
    for hidden in (
        {"num": [{"name": "occluded", "val": 2}]},
        {"boolean": [{"name": "truncated", "val": True}]},
    ):
        data.update(hidden)
        assert np.isnan(read(tmp_path, root).distance_m).all()
        data.pop(*hidden)
    data["cuboid"][0]["val"][1] = 5.0  # to the left
    table = read(tmp_path, root)
    assert np.isnan(table.distance_m).all()
    assert "1 of 1 cuboids" in table.notes[-1]


def test_one_of_several_cameras(tmp_path: Path) -> None:
    root = document()
    boxes = root["frames"]["0"]["objects"][CAR]["object_data"]["bbox"]
    boxes.append({"name": "other", "val": [5, 5, 4, 4], "stream": "CAM_LEFT"})
    with pytest.raises(LabelFileError, match=r"found 2: CAM, CAM_LEFT; .*labels-CAM\.json"):
        read(tmp_path, root)
    assert len(read(tmp_path, root, "labels-CAM.json")) == 3
    assert read(tmp_path, root, "labels-CAM_LEFT.json").xyxy_px.tolist() == [[2.5, 2.5, 6.5, 6.5]]


def test_frames_of_the_stream(tmp_path: Path) -> None:
    root = document()
    for frame, number in (("0", 7), ("2", 8)):
        sync = {"stream_properties": {"sync": {"frame_stream": number}}}
        root["frames"][frame]["frame_properties"]["streams"] = {"CAM": sync}
    assert read(tmp_path, root).frame.tolist() == [7, 8, 8]


@pytest.mark.parametrize(
    ("change", "key_word"),
    [
        ({"metadata": {"schema_version": "0.3.0"}}, "schema_version"),
        ({"frames": {}}, "frames"),
        ({"objects": {}}, CAR),
    ],
)
def test_refused_files(tmp_path: Path, change: dict[str, Any], key_word: str) -> None:
    with pytest.raises(LabelFileError, match=key_word):
        read(tmp_path, document(**change))


@pytest.mark.parametrize(
    ("kind", "val", "key_word"),
    [
        ("rbbox", [20, 30, 10, 10, 0.5], "upright"),
        ("bbox", [0.2, 0.3, 0.1, 0.1], "fractions"),
        ("bbox", [20, 30, 10], "OpenLABEL"),
        ("bbox", ["wide", 30, 10, 1], "OpenLABEL"),
        ("cuboid", [20, 0, 1, 4, 2, 1.5], "9 or 10 values of a cuboid, found 6"),
    ],
)
def test_refused_boxes(tmp_path: Path, kind: str, val: list[Any], key_word: str) -> None:
    data = {kind: [{"name": "box", "val": val}]}
    root = document(frames={"0": {"objects": {CAR: {"object_data": data}}}})
    with pytest.raises(LabelFileError, match=key_word):
        read(tmp_path, root)


def test_vcd_4_is_named(tmp_path: Path) -> None:
    path = tmp_path / "labels.json"
    path.write_text('{"vcd": {"frames": {}}}')
    with pytest.raises(LabelFileError, match="VCD 4"):
        read_labels(path)

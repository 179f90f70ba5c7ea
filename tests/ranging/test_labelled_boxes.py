import numpy as np
import pytest

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.ranging.truth.frame_times import ASSUMED_STEP_S
from track_range.ranging.truth.labelled_boxes import box_set, greedy_matches
from track_range.stereo.geometry.rig import RigError


def test_car_seen_from_behind_by_hand(tmp_path, row, drives):
    """f = 700 px: a rear of 1.7 x 1.5 m at 20 m is 59.5 x 52.5 px; the ray through its centre meets
    it at 20 m."""
    boxes = box_set(*drives(tmp_path, {"a": [row(3, 7, "Car", 20.0)]}))
    assert boxes.distance_m == pytest.approx([20.0], abs=1e-4)
    assert boxes.xyxy_px[0, 2:] - boxes.xyxy_px[0, :2] == pytest.approx([59.5, 52.5], abs=1e-4)
    assert boxes.wh_over_f == pytest.approx(np.array([[0.085, 0.075]]), abs=1e-6)
    assert boxes.time_s == pytest.approx([3 * ASSUMED_STEP_S])
    assert (boxes.class_name[0], boxes.kitti_type[0], boxes.track_id[0]) == ("car", "Car", 7)
    assert boxes.is_rear_view.all()


def test_ray_starts_at_the_left_colour_camera(tmp_path, row, drives):
    """The fourth column of P2 is the position of camera 2; labels are in camera 0's frame.

    The ray of bearing 0.3 meets the back at 20 m; a car that is 1.2 m further right is met at its
    left side, which runs along x = 6.35 m: at 6.35 / 0.3 = 21.17 m.
    """
    slanted = row(0, 0, "Car", 20.0, x_m=6.0)
    plain = box_set(*drives(tmp_path / "plain", {"a": [slanted]}))
    shifted = box_set(*drives(tmp_path / "shifted", {"a": [slanted]}, shift_px=700 * 1.2))
    assert plain.distance_m == pytest.approx([20.0], abs=1e-3)
    assert plain.bearing == pytest.approx([0.3], abs=1e-4)
    assert shifted.distance_m == pytest.approx([6.35 / 0.3], abs=1e-3)


def test_usable_labels(tmp_path, row, drives):
    rows = [
        row(0, 0, "Car", 20.0),
        row(0, 1, "Car", 20.0, x_m=5.0, truncated=1),
        row(0, 2, "Car", 20.0, x_m=-5.0, occluded=2),
        row(0, 3, "Car", 4.9),
        row(0, 4, "Car", 101.0),
        row(1, 5, "Van", 30.0, occluded=1),
        row(1, 6, "Pedestrian", 30.0, x_m=3.0),
        row(1, 7, "Cyclist", 30.0, x_m=-3.0),
        row(1, 8, "Truck", 30.0, x_m=12.0),
    ]
    boxes = box_set(
        *drives(tmp_path, {"a": [*rows, rows[0].replace("Car", "Misc").replace("0 0", "0 9", 1)]})
    )
    assert boxes.track_id.tolist() == [0, 5, 6, 7, 8]
    assert boxes.class_name.tolist() == ["car", "van", "person", "bicycle", "truck"]
    # the truck has a lateral offset of 12 m
    assert boxes.is_rear_view.tolist() == [True, True, True, True, False]


def test_edge_noise_is_seeded(tmp_path, row, drives):
    rows = [
        row(frame, track, "Car", 20.0 + track, x_m=2.0 * track)
        for frame in range(50)
        for track in range(10)
    ]
    folders = drives(tmp_path, {"a": rows})
    exact, noisy, again, other = (
        box_set(*folders, noise_px=noise_px, seed=seed).xyxy_px
        for noise_px, seed in ((0, 0), (2, 0), (2, 0), (2, 1))
    )
    assert (noisy - exact).std() == pytest.approx(2.0, rel=0.05)
    assert (noisy - exact).mean() == pytest.approx(0.0, abs=0.15)
    assert (noisy == again).all()
    assert (noisy != other).any()
    assert box_set(*folders, noise_px=2).distance_m == pytest.approx(box_set(*folders).distance_m)
    thin = box_set(*folders, noise_px=50, seed=0)
    assert (thin.xyxy_px[:, 2:] - thin.xyxy_px[:, :2] >= 1.0 - 1e-9).all()


def test_detections_replace_boxes_but_not_the_truth(tmp_path, row, drives):
    """A match, a low-confidence one, one with too little overlap, and one of an occluded car next
    to a measured car."""
    hidden = row(1, 3, "Car", 20.0, x_m=1.0, occluded=3)
    folders = drives(
        tmp_path,
        {"a": [row(0, 1, "Car", 20.0), row(1, 2, "Car", 20.0), hidden, row(2, 4, "Van", 20.0)]},
    )
    exact = box_set(*folders)
    x1, y1, x2, y2 = exact.xyxy_px[0]
    for kind in ("Car", "Pedestrian"):
        (tmp_path / "rrc" / kind).mkdir(parents=True)
    shift_px = 700.0 / 20.0
    detection_lines = [
        f"0,{x1 + 2},{y1},{x2 + 2},{y2},0.9",
        f"0,{x1},{y1},{x2},{y2},0.4",
        f"1,{x1 + shift_px},{y1},{x2 + shift_px},{y2},0.9",
        f"2,{x1},{y1},{x2},{y2},0.9",  # a van is not a car
    ]
    (tmp_path / "rrc/Car/a.txt").write_text("\n".join(detection_lines))
    boxes = box_set(*folders, boxes=f"rrc:{tmp_path / 'rrc'}")
    assert boxes.track_id.tolist() == [1]
    assert boxes.xyxy_px[0] == pytest.approx([x1 + 2, y1, x2 + 2, y2])
    assert boxes.distance_m == pytest.approx([20.0], abs=1e-3)


def test_greedy_matching_by_confidence():
    labels = (np.array([0, 0, 1]), np.array([[0, 0, 10, 10], [4, 0, 14, 10], [0, 0, 10, 10.0]]))
    detections = (
        np.array([0, 0, 0, 1]),
        np.array([[1, 0, 11, 10], [0, 0, 10, 10], [50, 0, 60, 10], [9, 0, 19, 10.0]]),
    )
    row, detection = greedy_matches(labels, detections, score=np.array([0.9, 0.8, 0.95, 0.9]))
    assert sorted(zip(row.tolist(), detection.tolist(), strict=True)) == [(0, 0)]
    row, detection = greedy_matches(labels, detections, score=np.array([0.8, 0.9, 0.95, 0.9]))
    assert sorted(zip(row.tolist(), detection.tolist(), strict=True)) == [(0, 1), (1, 0)]


def test_object_labels_with_a_file_per_image(tmp_path, row, drives):
    """Rows without frame and id; images are divided into groups, since their drives are unknown."""
    images = {f"{k:06d}": [row(0, 0, "Car", 10.0 + k).split(maxsplit=2)[2]] for k in range(20)}
    images["000020"] = []
    boxes = box_set(*drives(tmp_path, images))
    assert boxes.distance_m == pytest.approx(10.0 + np.arange(20), abs=1e-3)
    assert len(np.unique(boxes.sequence)) == 10
    assert len(np.unique(boxes.frame)) == 20


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ({}, "label files"),
        ({"a": ["0 1 Car 0 0 0 1 1 9 9 -1 -1 -1 -1000 -1000 -1000 -10"]}, "3-D box"),
        ({"a": ["0 1 Misc 0 0 0 1 1 9 9 1.5 1.7 4 0 1.65 20 0"]}, "no usable label"),
        ({"a": ["0 1 Car 0 0"]}, "line 1"),
    ],
)
def test_invalid_labels(tmp_path, drives, rows, message):
    with pytest.raises(LabelFileError, match=message):
        box_set(*drives(tmp_path, rows))


def test_missing_calibration_or_folder(tmp_path, row, drives):
    labels, calib = drives(tmp_path, {"a": [row(0, 0, "Car", 20.0)]})
    with pytest.raises(LabelFileError, match="rrc:DIR"):
        box_set(labels, calib, boxes="other")
    with pytest.raises(LabelFileError, match="DIR/Car"):
        box_set(labels, calib, boxes=f"rrc:{tmp_path}")
    (labels / "a.txt").write_bytes(b"\xff\xfe\x00\x01")
    with pytest.raises(LabelFileError, match=r"a\.txt: .*UTF-8"):
        box_set(labels, calib)
    (calib / "a.txt").unlink()
    (labels / "a.txt").write_text(row(0, 0, "Car", 20.0))
    with pytest.raises(RigError):
        box_set(labels, calib)


def test_kitti_counts(shared_data):
    folders = shared_data / "kitti_labels"
    boxes = box_set(folders / "label_02", folders / "calib")
    counts = {name: int((boxes.class_name == name).sum()) for name in np.unique(boxes.class_name)}
    assert counts == {"bicycle": 1194, "car": 11918, "person": 2502, "truck": 724, "van": 1055}
    assert 0.2 < boxes.is_rear_view.mean() < 0.3
    with_detections = box_set(
        folders / "label_02", folders / "calib", boxes=f"rrc:{folders / 'rrc'}"
    )
    assert set(with_detections.class_name) == {"car", "person"}
    assert 0.85 < (with_detections.class_name == "car").sum() / counts["car"] < 1.0


def test_image_size(tmp_path, drives, row):
    """KITTI's images have the known size of their recording; others contain all labels, but not
    DontCare regions."""
    region = "0 -1 DontCare -1 -1 -10 0 0 1700 900 -1 -1 -1 -1000 -1000 -1000 -10"
    labels, calib = drives(
        tmp_path, {"0000": [row(0, 0, "Car", 20.0), row(0, 1, "Car", 10.0, x_m=9.0), region]}
    )
    right_px = 600.0 + 700.0 * (9.0 + 0.85) / 10.0
    assert box_set(labels, calib).size_px[0].tolist() == [int(np.ceil(right_px)) + 1, 360]
    text = (calib / "0000.txt").read_text().replace("700.0 ", "718.3351 ")
    (calib / "0000.txt").write_text(text)
    assert box_set(labels, calib).size_px[0].tolist() == [1238, 374]


def test_classes_that_kitti_does_not_have_are_counted(tmp_path, row, drives):
    rows = [
        row(0, 1, "Car", 20.0).replace("Car", "Bus"),
        row(0, 2, "Car", 30.0, x_m=6.0).replace("Car", "Pickup"),
        row(0, 3, "Car", 40.0, occluded=2).replace("Car", "Motorcycle"),
        row(0, 4, "Car", 50.0, x_m=9.0).replace("Car", "Misc"),
    ]
    boxes = box_set(*drives(tmp_path, {"a": rows}))
    assert boxes.class_name.tolist() == ["bus", "car"]
    assert [note.split(":")[0] for note in boxes.notes] == ["Time step", "Misc", "Motorcycle"]


def test_single_files_are_like_folders(tmp_path, row, drives):
    """One label file with its calibration, and one calibration of two label files."""
    labels, calib = drives(tmp_path, {name: [row(0, 1, "Car", 20.0)] for name in ("a", "b")})
    boxes = box_set(labels / "b.txt", calib / "b.txt")
    assert boxes.sequence_names == ("b",)
    assert boxes.distance_m == pytest.approx([20.0], abs=1e-3)
    assert len(box_set(labels, calib / "a.txt")) == 2
    assert box_set(labels / "b.txt", calib).distance_m == pytest.approx([20.0], abs=1e-3)

"""Published evaluations: lists of frames of the object set, reference distances, metrics, and
risk-coverage curves."""

import json

import numpy as np
import pytest

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.video_labels.kitti import read_kitti, read_kitti_image
from track_range.foundation.errors import UsageError
from track_range.ranging.evaluation.box_evaluation import metrics
from track_range.ranging.evaluation.box_methods import MethodOptions, measured_by
from track_range.ranging.evaluation.labelled_ranges import centre_offset_m, evaluate_ranges
from track_range.ranging.evaluation.settings import RangeEvaluationSettings
from track_range.ranging.truth.labelled_boxes import BoxSelection, box_set
from track_range.ranging.truth.reference_distance import lidar_distance_m, read_lidar

LIDAR_ROWS = """R0_rect: 1 0 0 0 1 0 0 0 1
Tr_velo_to_cam: 0 -1 0 0.1 0 0 -1 -0.2 1 0 0 -0.3
"""
"""Lidar axes x ahead, y to the left, z up; the lidar is 0.1 m left of, 0.2 m above and 0.3 m behind
the camera."""


def object_set(folder, labels, calib):
    """Tracking labels in the layout of KITTI's object set: a file of labels and of calibration per
    frame."""
    places = folder / "label_2", folder / "object_calib"
    for place in places:
        place.mkdir(parents=True)
    names = []
    for sequence, file in enumerate(sorted(labels.glob("*.txt"))):
        by_frame = {}
        for line in file.read_text().splitlines():
            frame, _, *cells = line.split()
            by_frame.setdefault(int(frame), []).append(" ".join(cells))
        for frame, lines in by_frame.items():
            names.append(f"{1000 * sequence + frame:06d}")
            (places[0] / f"{names[-1]}.txt").write_text("\n".join(lines) + "\n")
            (places[1] / f"{names[-1]}.txt").write_text((calib / file.name).read_text())
    return *places, names


def listed(path, names):
    path.write_text("\n".join(names) + "\n")
    return path


@pytest.fixture
def images(tmp_path, drives, row):
    rows = {
        f"{k:04d}": [
            row(frame, 0, "Car", 10.0 + 2 * frame + 3 * k, scale=1 + 0.02 * k)
            for frame in range(30)
        ]
        + [row(frame, 1, "Pedestrian", 8.0 + frame, x_m=3.0) for frame in range(30)]
        for k in range(4)
    }
    return object_set(tmp_path, *drives(tmp_path, rows))


def test_metrics_by_hand():
    result = metrics(np.array([10.0, 30.0, np.nan, 8.0]), np.array([10.0, 20.0, 5.0, 10.0]))
    assert (result["coverage"], result["n"]) == (0.75, 3)
    assert result["abs_rel"] == pytest.approx((0.5 + 0.2) / 3, abs=1e-4)
    assert result["sq_rel_m"] == pytest.approx((5.0 + 0.4) / 3, abs=1e-4)
    assert result["rmse_m"] == pytest.approx(np.sqrt(104 / 3), abs=1e-4)
    assert result["rmse_log"] == pytest.approx(
        np.sqrt((np.log(1.5) ** 2 + np.log(1.25) ** 2) / 3), abs=1e-4
    )
    assert result["delta_1_25"] == pytest.approx(1 / 3, abs=1e-4)
    assert result["delta_1_25_2"] == 1.0
    assert metrics(np.full(2, np.nan), np.ones(2))["abs_rel"] is None


def test_list_of_frames(tmp_path, images):
    labels, calib, names = images
    evaluated, fitted = names[:20], names[20:]
    settings = RangeEvaluationSettings(
        labels=labels,
        calib=calib,
        frames=listed(tmp_path / "val.txt", evaluated),
        fit_frames=listed(tmp_path / "train.txt", fitted),
        methods=("inverse-height", "mono"),
        region="europe",
    )
    figures = evaluate_ranges(settings)
    rows = figures["literature"]
    assert rows["mono"]["all"]["n_boxes"] == figures["n_boxes"] == 40
    assert rows["mono"]["car"]["n_boxes"] == rows["mono"]["person"]["n_boxes"] == 20
    assert rows["mono"]["car"]["coverage"] > 0.5
    assert 0.0 < rows["inverse-height"]["car"]["abs_rel"] < 0.08
    assert f"{tmp_path / 'train.txt'}" in figures["notes"][1]
    json.dumps(figures, allow_nan=False)


def test_split(tmp_path, images):
    labels, calib, names = images
    folder = tmp_path / "training" / "label_2"
    folder.parent.mkdir()
    folder.symlink_to(labels)
    lists = tmp_path / "ImageSets"
    lists.mkdir()
    val, train = listed(lists / "val.txt", names[:20]), listed(lists / "train.txt", names[20:40])
    by_lists = evaluate_ranges(
        RangeEvaluationSettings(
            labels=folder, calib=calib, frames=val, fit_frames=train, methods=("inverse-height",)
        )
    )
    for split in ("chen", str(lists)):
        settings = RangeEvaluationSettings(
            labels=folder, calib=calib, split=split, methods=("inverse-height",)
        )
        assert evaluate_ranges(settings) == by_lists
    for more, word in (
        ({"split": "chen", "frames": val}, "--frames"),
        ({"split": str(tmp_path)}, "train.txt"),
    ):
        with pytest.raises(UsageError, match=word):
            evaluate_ranges(RangeEvaluationSettings(labels=folder, calib=calib, **more))


def test_images_are_separate_drives(tmp_path, images):
    """The order of the images and the other images do not matter."""
    labels, calib, names = images
    sets, distances_m = [], []
    for chosen in (names[3:4], names[:50]):
        frames = listed(tmp_path / "some.txt", chosen)
        boxes = box_set(labels, calib, selection=BoxSelection(frames=frames))
        sets.append(boxes)
        distances_m.append(measured_by(("mono",), boxes, boxes, MethodOptions())["mono"].distance_m)
    alone, boxes = sets
    assert (len(alone.frame), len(boxes.frame)) == (2, 100)
    rows = boxes.frame == np.unique(boxes.frame)[3]
    assert np.isfinite(distances_m[0]).all()
    np.testing.assert_allclose(distances_m[1][rows], distances_m[0], rtol=1e-9)
    assert (boxes.track_id < 0).all()
    assert len(np.unique(boxes.frame)) == 50


@pytest.mark.parametrize(
    ("more", "word"),
    [
        ({"fit_frames": "val.txt"}, "000000"),
        ({"fit_frames": "train.txt", "cross_validate": True}, "--cross-validate"),
        ({"truth": "lidar"}, "--velodyne"),
        ({"frames": None, "fit_frames": "train.txt"}, "--frames"),
    ],
)
def test_contradicting_settings(tmp_path, images, more, word):
    labels, calib, names = images
    listed(tmp_path / "val.txt", names[:9]), listed(tmp_path / "train.txt", names[9:])
    chosen = {"frames": "val.txt", **more}
    paths = {
        key: tmp_path / value
        for key, value in chosen.items()
        if key in ("frames", "fit_frames") and value
    }
    rest = {key: value for key, value in chosen.items() if key not in ("frames", "fit_frames")}
    with pytest.raises(UsageError, match=word):
        evaluate_ranges(RangeEvaluationSettings(labels=labels, calib=calib, **paths, **rest))


@pytest.mark.parametrize(("content", "word"), [("", "empty"), ("000000\n424242\n", "424242")])
def test_bad_lists(tmp_path, images, content, word):
    labels, calib, _ = images
    frames = tmp_path / "bad.txt"
    frames.write_text(content)
    with pytest.raises(LabelFileError, match=rf"bad\.txt: .*{word}"):
        box_set(labels, calib, selection=BoxSelection(frames=frames))


def test_reference_distances(tmp_path, images):
    """A car 4 m long seen from behind: rear, centre 2 m behind it, and the lidar's 10th
    percentile."""
    labels, calib, names = images
    place = tmp_path / "velodyne"
    place.mkdir()
    for name in names:
        text = (calib / f"{name}.txt").read_text()
        (calib / f"{name}.txt").write_text(text + LIDAR_ROWS)
        car = read_kitti_image(labels / f"{name}.txt")
        rear_m = car.location_m[0, 2] - car.size_hwl_m[0, 2] / 2
        depth_m = rear_m + np.linspace(0.0, 1.0, 11)
        camera_m = np.stack([np.zeros(11), np.full(11, 1.0), depth_m], axis=1)
        lidar = np.stack(
            [camera_m[:, 2] + 0.3, 0.1 - camera_m[:, 0], -0.2 - camera_m[:, 1], np.ones(11)], axis=1
        )
        lidar.astype(np.float32).tofile(place / f"{name}.bin")
    truths = {
        truth: box_set(
            labels,
            calib,
            selection=BoxSelection(reference=truth, velodyne=place if truth == "lidar" else None),
        )
        for truth in ("surface", "centre", "lidar")
    }
    cars = {
        truth: boxes.select(boxes.class_name == "car").with_reference()
        for truth, boxes in truths.items()
    }
    np.testing.assert_allclose(
        cars["centre"].distance_m, cars["surface"].distance_m + 2.0, rtol=0.03
    )
    np.testing.assert_allclose(
        cars["lidar"].distance_m, cars["surface"].distance_m + 0.1, atol=0.02
    )
    assert not (truths["lidar"].class_name == "person").any()  # no points


def test_cut_and_hidden_objects_count_with_all_objects(tmp_path, drives, row):
    rows = [
        row(0, 0, "Car", 20.0),
        row(0, 1, "Car", 30.0, occluded=2),
        row(0, 2, "Car", 140.0, truncated=1, x_m=8.0),
    ]
    labels, calib, _ = object_set(tmp_path, *drives(tmp_path, {"0000": rows}))
    assert len(box_set(labels, calib)) == 1
    assert len(box_set(labels, calib, selection=BoxSelection(has_all_objects=True))) == 3


def test_offset_of_the_centre():
    boxes = np.array([[0.0, 0, 60, 50], [0, 0, 150, 50], [0, 0, 92.5, 50]])
    np.testing.assert_allclose(
        centre_offset_m(np.array(["car"] * 3), boxes), [2.1, 0.875, (2.1 + 0.875) / 2]
    )


def test_lidar_files(tmp_path, images):
    _, calib, names = images
    file, calibration = tmp_path / "a.bin", calib / f"{names[0]}.txt"
    with pytest.raises(LabelFileError, match=r"a\.bin"):
        read_lidar(file, calibration)
    np.zeros(7, np.float32).tofile(file)
    with pytest.raises(LabelFileError, match=r"a\.bin: .*7"):
        read_lidar(file, calibration)
    np.zeros(8, np.float32).tofile(file)
    with pytest.raises(LabelFileError, match="R0_rect"):
        read_lidar(file, calibration)
    labels = read_kitti_image(tmp_path / "label_2" / f"{names[0]}.txt")
    assert np.isnan(lidar_distance_m(labels, np.zeros((0, 3)), np.zeros(3))).all()


def test_risk_of_all_answers_is_the_mean_error(images):
    labels, calib, _ = images
    figures = evaluate_ranges(
        RangeEvaluationSettings(labels=labels, calib=calib, methods=("height-3", "mono"))
    )
    assert set(figures["risk_coverage"]) == {"mono"}
    curve = figures["risk_coverage"]["mono"]["car"]
    assert [row["answered_pct"] for row in curve["curve"]] == list(range(5, 101, 5))
    assert curve["curve"][-1]["mean_relative_error_pct"] == pytest.approx(
        figures["methods"]["mono"]["car"]["mean_relative_error_pct"], abs=1e-3
    )


@pytest.mark.real
def test_tracking_labels_as_an_object_set(tmp_path, shared_data):
    """KITTI's sequences 0004 and 0018 as images: the plain curves measure what they do as
    drives."""
    source = shared_data / "kitti_labels"
    for name in ("label_02", "calib"):
        (tmp_path / name).mkdir()
        for sequence in ("0004", "0018"):
            (tmp_path / name / f"{sequence}.txt").write_text(
                (source / name / f"{sequence}.txt").read_text()
            )
    labels, calib, names = object_set(tmp_path, tmp_path / "label_02", tmp_path / "calib")
    drives = box_set(tmp_path / "label_02", tmp_path / "calib")
    images = box_set(labels, calib)
    assert len(images) == len(drives)
    np.testing.assert_allclose(np.sort(images.distance_m), np.sort(drives.distance_m))
    all_rows = [read_kitti(tmp_path / "label_02" / f"{name}.txt") for name in ("0004", "0018")]
    everything = box_set(
        labels, calib, selection=BoxSelection(has_all_objects=True, reference="centre")
    )
    usual_types = ("Car", "Van", "Truck", "Pedestrian", "Cyclist")
    n = sum(
        int((np.isin(part.kitti_type, usual_types) & part.has_3d_box).sum()) for part in all_rows
    )
    assert len(everything) == pytest.approx(n, rel=0.01)
    settings = RangeEvaluationSettings(
        labels=labels,
        calib=calib,
        frames=listed(tmp_path / "val.txt", [name for name in names if name >= "001000"]),
        fit_frames=listed(tmp_path / "train.txt", [name for name in names if name < "001000"]),
        objects="all",
        truth="centre",
        methods=("inverse-height", "mono"),
        region="europe",
    )
    rows = evaluate_ranges(settings)["literature"]
    assert 0.02 < rows["mono"]["car"]["abs_rel"] < 0.08
    assert rows["mono"]["car"]["abs_rel"] < rows["inverse-height"]["car"]["abs_rel"]
    assert rows["mono"]["car"]["delta_1_25"] > 0.95

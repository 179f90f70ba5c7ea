import numpy as np
import pytest

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.ranging.truth.errors import (
    MethodColumn,
    coverage_only,
    match_boxes,
    match_truth,
    score_closing,
    score_methods,
)
from track_range.ranging.truth.truth import CSV_PROTOCOL, KITTI_PROTOCOL, Truth, read_truth
from track_range.stereo.geometry.camera import PinholeCamera

NAN = np.nan


def truth_of(frame, boxes, distance_m):
    n = len(frame)
    return Truth(
        np.array(frame),
        np.arange(n),
        np.full(n, "Car"),
        np.full(n, 2),
        np.array(boxes, float),
        np.array(distance_m),
        np.full(n, NAN),
    )


def test_matching_is_one_to_one_by_frame_and_iou():
    truth = truth_of(
        [0, 0, 1], [[0, 0, 10, 10], [20, 0, 30, 10], [0, 0, 10, 10]], [10.0, 20.0, 30.0]
    )
    boxes = np.array(
        [[1, 0, 11, 10], [0, 0, 10, 10], [20, 0, 30, 10], [0, 0, 10, 10], [6, 0, 16, 10]], float
    )
    assert match_truth(np.array([0, 0, 0, 2, 1]), boxes, truth).tolist() == [-1, 0, 1, -1, -1]


def test_unsorted_frames_are_matched_like_each_frame_by_itself():
    """Frames of one run only, and frames in any order, as in rows that are sorted by track."""
    rng = np.random.default_rng(5)
    frames, boxes = [rng.integers(low, low + 30, 200) for low in (0, 5)], []
    for _ in frames:
        corner = rng.uniform(0, 40, (200, 2))
        boxes.append(np.hstack([corner, corner + rng.uniform(20, 30, (200, 2))]))
    expected = np.full(200, -1)
    for number in range(35):
        a, b = (np.flatnonzero(frame == number) for frame in frames)
        match = match_boxes(np.zeros(len(a), int), boxes[0][a], np.zeros(len(b), int), boxes[1][b])
        expected[a[match >= 0]] = b[match[match >= 0]]
    assert 50 < np.count_nonzero(expected >= 0) < 150
    assert match_boxes(frames[0], boxes[0], frames[1], boxes[1]).tolist() == expected.tolist()


def scores(methods, true_m, **changes):
    n = len(true_m)
    rest = {"is_road_class": np.ones(n, bool), "kitti_type": np.full(n, "Car"), **changes}
    columns = {name: MethodColumn(np.array(d), np.array(s)) for name, (d, s) in methods.items()}
    return score_methods(columns, np.array(true_m), **rest)


def test_figures_by_hand():
    separate, common = scores(
        {
            "a": ([11.0, 18.0, NAN, 44.0], [1.0, 1.5, NAN, 1.0]),
            "b": ([10.0, NAN, 30.0, 40.0], [1.0, NAN, 1.0, 1.0]),
        },
        [10.0, 20.0, 30.0, 40.0],
    )
    a = separate["a"]
    assert (a["n"], a["coverage"]) == (3, 0.75)
    assert a["mean_relative_error_pct"] == pytest.approx(10.0)  # +10, -10, +10 %
    assert a["bias_pct"] == pytest.approx(10.0)
    assert (a["within_1_sigma"], a["within_2_sigma"]) == pytest.approx((1 / 3, 2 / 3), abs=1e-4)
    assert [(b["from_m"], b["n"]) for b in a["bands"]] == [
        (5, 0),
        (10, 1),
        (20, 1),
        (30, 1),
        (50, 0),
    ]
    assert separate["b"]["mean_relative_error_pct"] == 0.0
    assert common["a"]["n"] == common["b"]["n"] == 2  # the first and the last


def test_vans_are_scored_only_by_class():
    separate, _ = scores(
        {"a": ([11.0, 30.0], [1.0, 1.0])},
        [10.0, 20.0],
        is_road_class=np.array([True, False]),
        kitti_type=np.array(["Car", "Van"]),
    )
    assert separate["a"]["n"] == 1
    assert separate["a"]["by_class"]["Van"]["mean_relative_error_pct"] == pytest.approx(50.0)


def test_truth_out_of_range_or_missing_is_ignored():
    separate, common = scores({"a": ([5.0, 5.0, 5.0], [1.0, 1.0, 1.0])}, [4.9, 101.0, NAN])
    assert separate["a"]["n"] == 0
    assert separate["a"]["mean_relative_error_pct"] is None
    assert common == {}


def test_only_coverage_without_truth():
    figures = coverage_only({"a": MethodColumn(np.array([1.0, NAN]), np.array([1.0, NAN]))})["a"]
    assert (
        figures["coverage"],
        figures["n"],
        figures["mean_relative_error_pct"],
        figures["bands"],
    ) == (
        0.5,
        1,
        None,
        [],
    )


def test_median_relative_sigma():
    column = MethodColumn(np.array([10.0, 20.0, NAN, 40.0]), np.array([1.0, 1.0, NAN, 8.0]))
    assert coverage_only({"a": column})["a"]["median_sigma_pct"] == pytest.approx(10.0)
    untold = MethodColumn(column.distance_m, np.full(4, NAN))
    assert coverage_only({"a": untold})["a"]["median_sigma_pct"] is None


def test_truth_from_labels(tmp_path):
    rows = (
        "0 1 Car 0 0 0 295.5 240 345.5 265 1.5 1.6 4.0 0 0.75 20.0 -1.5707963",
        "0 2 Van 0 3 0 295.5 240 345.5 265 1.5 1.6 4.0 0 0.75 20.0 -1.5707963",
        "0 3 Car 1 0 0 295.5 240 345.5 265 1.5 1.6 4.0 0 0.75 20.0 -1.5707963",
        "0 -1 DontCare -1 -1 -10 1 2 3 4 -1000 -1000 -1000 -10 -1 -1 -1",
    )
    file = tmp_path / "label.txt"
    file.write_text("\n".join(rows))
    camera = PinholeCamera(1000.0, 1000.0, 320.0, 240.0, 640, 480)
    # the left camera is 1 m behind the reference camera
    truth = read_truth(file, camera, np.array([0.0, 0.0, 1.0]))
    assert truth.protocol == KITTI_PROTOCOL
    assert np.isnan(truth.closing_mps).all()
    assert truth.class_id.tolist() == [2, -1, 2, -1]
    # rear at 18 m, 1 m farther from the left camera
    assert truth.distance_m[0] == pytest.approx(19.0, abs=1e-4)
    assert np.isnan(truth.distance_m[1:]).all()
    file.write_text("\n".join([rows[0], rows[0]]))
    with pytest.raises(LabelFileError, match="id 1 twice"):
        read_truth(file, camera, np.zeros(3))
    file.write_text(rows[0].replace("0 1 Car", "0 -1 Car"))
    with pytest.raises(LabelFileError, match="track ids"):
        read_truth(file, camera, np.zeros(3))
    file.write_text(rows[-1])
    with pytest.raises(LabelFileError, match="3-D box"):
        read_truth(file, camera, np.zeros(3))


def test_closing_speeds_by_hand():
    figures = score_closing(
        np.array([1.0, -3.0, 5.0, NAN]),
        np.array([1.0, 0.6, NAN, NAN]),
        np.array([0.5, -2.0, 3.0, 7.0]),
    )
    assert figures is not None
    assert (figures["coverage"], figures["n"]) == (0.75, 3)  # errors +0.5, -1, +2
    assert (figures["median_error_mps"], figures["bias_mps"]) == (1.0, 0.5)
    assert figures["mean_error_mps"] == pytest.approx(3.5 / 3, abs=1e-4)
    # the third has no sigma
    assert (figures["within_1_sigma"], figures["within_2_sigma"]) == (0.5, 1.0)


def test_closing_speeds_unknown_or_unmeasured():
    nothing = np.full(2, NAN)
    assert score_closing(np.ones(2), np.ones(2), nothing) is None
    figures = score_closing(nothing, nothing, np.ones(2))
    assert figures is not None
    assert (
        figures["coverage"],
        figures["n"],
        figures["median_error_mps"],
        figures["within_1_sigma"],
    ) == (
        0.0,
        0,
        None,
        None,
    )


CAMERA = PinholeCamera(1000.0, 1000.0, 320.0, 240.0, 640, 480)


def csv_truth(
    path, *rows, header="frame,id,class,x1,y1,x2,y2,distance_m,visible_share,closing_mps"
):
    path.write_text("\n".join([header, *rows]) + "\n")
    return read_truth(path, CAMERA, np.array([0.0, 0.0, 1.0]))


def test_truth_from_csv(tmp_path):
    truth = csv_truth(
        tmp_path / "radar.csv",
        "0,1,car,295,240,345,265,18.25,0.5,2.5",
        "0,2,van,295,240,345,265,30,0.49,",  # more than half occluded
        "1,1,dontcare,295,240,345,265,,,",
        "1,1,person,295,240,345,265,,1,0",
    )
    assert truth.frame.tolist() == [0, 0, 1, 1]
    assert truth.track_id.tolist() == [1, 2, -1, 1]
    assert truth.class_id.tolist() == [2, 2, -1, 0]
    assert truth.kitti_type.tolist() == ["car", "van", "dontcare", "person"]
    # not shifted: already in the left camera's frame
    np.testing.assert_equal(truth.distance_m, [18.25, NAN, NAN, NAN])
    np.testing.assert_equal(truth.closing_mps, [2.5, NAN, NAN, 0.0])
    assert truth.protocol == CSV_PROTOCOL
    assert truth.select(np.array([3, 0])).closing_mps.tolist() == [0.0, 2.5]
    assert truth.select(truth.frame == 1).protocol == CSV_PROTOCOL


def test_other_classes_of_a_csv_are_named(tmp_path):
    rows = "0,1,car,295,240,345,265,18,,", "0,2,misc,295,240,345,265,18,,"
    truth = csv_truth(tmp_path / "t.csv", *rows)
    assert truth.class_id.tolist() == [2, -1]
    (note,) = truth.notes
    assert "misc (1)" in note


@pytest.mark.parametrize(
    ("box", "is_cut"),
    [
        ("1.1,1.1,637.9,477.9", False),
        ("1,9,99,99", True),
        ("9,0,99,99", True),
        ("9,9,638,99", True),
        ("9,9,99,480", True),
    ],
)
def test_boxes_cut_by_the_border_are_not_scored(tmp_path, box, is_cut):
    truth = csv_truth(tmp_path / "t.csv", f"0,1,car,{box},20,1,")
    assert bool(np.isnan(truth.distance_m[0])) == is_cut


def test_csv_without_distances_is_refused(tmp_path):
    with pytest.raises(LabelFileError, match="distance_m"):
        csv_truth(tmp_path / "t.csv", "0,1,car,9,9,99,99,,1,3")


def test_rays_of_real_labels_hit_their_boxes(shared_data):
    camera = PinholeCamera(721.5377, 721.5377, 609.5593, 172.854, 1242, 375)
    truth = read_truth(
        shared_data / "kitti_stereo/0003/label.txt", camera, np.array([0.0599, 0.0002, 0.0027])
    )
    centre_m = read_kitti(shared_data / "kitti_stereo/0003/label.txt").location_m[:, 2]
    gap = (centre_m - truth.distance_m)[np.isfinite(truth.distance_m)]
    assert len(gap) > 25
    assert 0.5 < np.median(gap) < 2.5  # the centre of a car is about 2 m behind its visible surface

import numpy as np
import pytest

from detection.kitti_format import LabelFileError, read_kitti
from ranging.evaluation import MethodColumn, coverage_only, match_truth, score_methods
from ranging.truth import Truth, read_truth
from stereo.camera import PinholeCamera

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
    )


def test_matching_is_one_to_one_by_frame_and_overlap():
    truth = truth_of([0, 0, 1], [[0, 0, 10, 10], [20, 0, 30, 10], [0, 0, 10, 10]], [10.0, 20.0, 30.0])
    boxes = np.array([[1, 0, 11, 10], [0, 0, 10, 10], [20, 0, 30, 10], [0, 0, 10, 10], [6, 0, 16, 10]], float)
    assert match_truth(np.array([0, 0, 0, 2, 1]), boxes, truth).tolist() == [-1, 0, 1, -1, -1]


def scores(methods, true_m, **changes):
    n = len(true_m)
    rest = {"is_road_class": np.ones(n, bool), "kitti_type": np.full(n, "Car"), **changes}
    columns = {name: MethodColumn(np.array(d), np.array(s)) for name, (d, s) in methods.items()}
    return score_methods(columns, np.array(true_m), **rest)


def test_figures_by_hand():
    mine, common = scores(
        {"a": ([11.0, 18.0, NAN, 44.0], [1.0, 1.5, NAN, 1.0]), "b": ([10.0, NAN, 30.0, 40.0], [1.0, NAN, 1.0, 1.0])},
        [10.0, 20.0, 30.0, 40.0],
    )
    a = mine["a"]
    assert (a["n"], a["coverage"]) == (3, 0.75)
    assert a["mean_relative_error_pct"] == pytest.approx(10.0)  # +10, -10, +10 %
    assert a["bias_pct"] == pytest.approx(10.0)
    assert (a["within_1_sigma"], a["within_2_sigma"]) == pytest.approx((1 / 3, 2 / 3), abs=1e-4)
    assert [(b["from_m"], b["n"]) for b in a["bands"]] == [(5, 0), (10, 1), (20, 1), (30, 1), (50, 0)]
    assert mine["b"]["mean_relative_error_pct"] == 0.0
    assert common["a"]["n"] == common["b"]["n"] == 2  # the first and the last


def test_vans_are_scored_under_their_own_name_only():
    mine, _ = scores(
        {"a": ([11.0, 30.0], [1.0, 1.0])},
        [10.0, 20.0],
        is_road_class=np.array([True, False]),
        kitti_type=np.array(["Car", "Van"]),
    )
    assert mine["a"]["n"] == 1
    assert mine["a"]["by_class"]["Van"]["mean_relative_error_pct"] == pytest.approx(50.0)


def test_truth_out_of_span_or_missing_does_not_count():
    mine, common = scores({"a": ([5.0, 5.0, 5.0], [1.0, 1.0, 1.0])}, [4.9, 101.0, NAN])
    assert mine["a"]["n"] == 0
    assert mine["a"]["mean_relative_error_pct"] is None
    assert common == {}


def test_without_truth_only_coverage_is_told():
    told = coverage_only({"a": MethodColumn(np.array([1.0, NAN]), np.array([1.0, NAN]))})["a"]
    assert (told["coverage"], told["n"], told["mean_relative_error_pct"], told["bands"]) == (0.5, 1, None, [])


def test_what_a_method_claims_is_the_median_of_its_relative_sigmas():
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
    truth = read_truth(file, camera, np.array([0.0, 0.0, 1.0]))  # the left camera stands a metre behind the reference
    assert truth.class_id.tolist() == [2, -1, 2, -1]
    assert truth.distance_m[0] == pytest.approx(19.0, abs=1e-4)  # rear at 18 m, a metre further from the left camera
    assert np.isnan(truth.distance_m[1:]).all()
    file.write_text("\n".join([rows[0], rows[0]]))
    with pytest.raises(LabelFileError, match="id 1 stands twice in frame 0"):
        read_truth(file, camera, np.zeros(3))
    file.write_text(rows[0].replace("0 1 Car", "0 -1 Car"))
    with pytest.raises(LabelFileError, match="its labels have no identities"):
        read_truth(file, camera, np.zeros(3))
    file.write_text(rows[-1])
    with pytest.raises(LabelFileError, match="no label has a 3-D box"):
        read_truth(file, camera, np.zeros(3))


def test_real_labels_meet_their_boxes(shared_data):
    camera = PinholeCamera(721.5377, 721.5377, 609.5593, 172.854, 1242, 375)
    truth = read_truth(shared_data / "kitti_stereo/0003/label.txt", camera, np.array([0.0599, 0.0002, 0.0027]))
    centre_m = read_kitti(shared_data / "kitti_stereo/0003/label.txt").location_m[:, 2]
    gap = (centre_m - truth.distance_m)[np.isfinite(truth.distance_m)]
    assert len(gap) > 25
    assert 0.5 < np.median(gap) < 2.5  # a car's centre lies about two metres behind the surface that is seen

import json

import numpy as np
import pytest

from detection.classes import ROAD_CLASSES
from ranging.size_curve import CurveError, SizeCurve, SizeCurves, load_curves
from ranging.size_curve_fit import SizeSamples, fit_curves, leave_one_out_error
from ranging.size_regression import SizeRegressionRanger
from stereo.camera import PinholeCamera
from stereo.frames import Frame
from tracking.tracks import Tracks

CAMERA = PinholeCamera(1000.0, 1000.0, 320.0, 240.0, 640, 480)
CAR = ROAD_CLASSES.index("car")
FRAME = Frame(0, 0.0, np.zeros((480, 640, 3), np.uint8), None)


def flat(height_m, **more):
    fields = {
        "per_log_height": -1.0,
        "per_log_width": 0.0,
        "per_bearing": 0.0,
        "sigma_relative": 0.1,
        "n": 9,
        "source": "",
    }
    return SizeCurve(intercept=float(np.log(height_m)), **{**fields, **more})


def tracks_of(*boxes, class_id=CAR, observed=True):
    n = len(boxes)
    return Tracks(np.arange(1, n + 1), np.array(boxes, float), np.full(n, class_id), np.ones(n), np.full(n, observed))


def test_an_object_of_known_height_by_hand():
    ranger = SizeRegressionRanger(CAMERA, SizeCurves({"car": flat(1.5)}, {"car": flat(1.5)}), box_sigma_px=0.0)
    ranges = ranger.measure(tracks_of([300, 200, 360, 250]), FRAME)  # 1.5 m over 50 px at f = 1000 px: 30 m
    assert ranges.distance_m == pytest.approx([30.0])
    assert ranges.sigma_m == pytest.approx([3.0])


def test_box_noise_widens_sigma_by_the_rule_of_errors():
    ranger = SizeRegressionRanger(CAMERA, SizeCurves({"car": flat(1.5)}, {"car": flat(1.5)}), box_sigma_px=2.0)
    sigma = ranger.measure(tracks_of([300, 200, 360, 250]), FRAME).sigma_m
    assert sigma == pytest.approx([30 * np.hypot(0.1, np.sqrt(2) * 2 / 50)])


def test_what_cannot_be_measured_is_nan():
    ranger = SizeRegressionRanger(CAMERA)
    cut = tracks_of([300, -0.5, 360, 250], [300, 200, 360, 479.5], [300, 200, 360, 203])
    assert np.isnan(ranger.measure(cut, FRAME).distance_m).all()
    assert np.isnan(ranger.measure(tracks_of([300, 200, 360, 250], observed=False), FRAME).distance_m).all()
    only_cars = SizeRegressionRanger(CAMERA, SizeCurves({"car": flat(1.5)}, {"car": flat(1.5)}))
    assert np.isnan(only_cars.measure(tracks_of([300, 200, 360, 250], class_id=0), FRAME).distance_m).all()
    assert len(ranger.measure(Tracks.empty(), FRAME)) == 0


def test_a_cut_side_leaves_the_width_out():
    curves = SizeCurves({"car": flat(1.5, per_log_width=-0.5)}, {"car": flat(1.5)})
    whole, cut = (
        SizeRegressionRanger(CAMERA, curves)
        .measure(tracks_of([300, 200, 360, 250], [-0.5, 200, 59.5, 250]), FRAME)
        .distance_m
    )
    assert whole != pytest.approx(30.0)
    assert cut == pytest.approx(30.0)


def test_packaged_curves_serve_every_class_and_fall_with_size():
    ranger = SizeRegressionRanger(CAMERA)
    for class_id in range(len(ROAD_CLASSES)):
        boxes = [[100, 100, 100 + s, 100 + s] for s in (5, 10, 20, 50, 100, 300)]
        ranges = ranger.measure(tracks_of(*boxes, class_id=class_id), FRAME)
        assert (np.diff(ranges.distance_m) < 0).all()
        assert (ranges.distance_m > 0).all()
        assert (ranges.sigma_m > 0).all()


def world(n=400, n_sequences=4, seed=0):
    """Cars of 1.5 m whose height differs from sequence to sequence by 5 %."""
    rng = np.random.default_rng(seed)
    sequence = np.arange(n) % n_sequences
    distance_m = rng.uniform(8, 80, n)
    height_m = 1.5 * (1 + 0.05 * np.array([1, -1, 1, -1])[sequence])
    sizes = np.stack([1.7 / distance_m, height_m / distance_m], axis=1) * np.exp(rng.normal(0, 0.01, (n, 2)))
    return SizeSamples(np.full(n, "car"), sequence, sizes, rng.uniform(-0.5, 0.5, n), distance_m)


def test_fit_finds_the_height_and_an_honest_sigma():
    samples = world()
    curve = fit_curves(samples, source="made up").height_only["car"]
    assert np.exp(curve.intercept) == pytest.approx(1.5, rel=0.03)
    assert curve.per_log_height == pytest.approx(-1.0, abs=0.02)
    assert 0.04 < curve.sigma_relative < 0.09  # between the sequences, not the 1 % within them
    error = leave_one_out_error(samples, use_width=False)
    assert np.sqrt((error**2).mean()) == pytest.approx(curve.sigma_relative, rel=0.01)


def test_what_is_fitted_can_be_loaded_even_where_the_labels_say_little(tmp_path):
    """One truck seen from one side: its width explains everything, and its height nothing."""
    distance_m = np.linspace(20, 21, 150)
    sizes = np.stack([2.5 / distance_m, 3.0 / 20 * np.ones(150)], axis=1)
    samples = SizeSamples(np.full(150, "truck"), np.zeros(150, np.int64), sizes, np.zeros(150), distance_m)
    fit_curves(samples, source="").save(tmp_path / "c.json")
    assert load_curves(tmp_path / "c.json").whole["truck"].per_log_height <= -0.1


def test_one_sequence_is_enough_to_fit_but_its_sigma_has_a_floor():
    samples = world()
    one = samples.select(samples.sequence == 0)
    assert fit_curves(one, source="").whole["car"].sigma_relative == 0.03


def test_too_few_samples_are_refused():
    with pytest.raises(CurveError, match=r"at least 100 labelled boxes .* found: car 12"):
        fit_curves(world(12), source="")


def test_curves_survive_the_file(tmp_path):
    curves = fit_curves(world(), source="made up")
    curves.save(tmp_path / "c.json")
    assert load_curves(tmp_path / "c.json").whole == curves.whole


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"track_range_size_curves": 99}, "version 99"),
        ({"whole": {"ufo": {}}}, "not a curve file"),
        ({"whole": None}, "not a curve file"),
    ],
)
def test_curve_files_that_cannot_be_used(tmp_path, change, message):
    file = tmp_path / "c.json"
    fit_curves(world(), source="").save(file)
    file.write_text(json.dumps({**json.loads(file.read_text()), **change}))
    with pytest.raises(CurveError, match=message):
        load_curves(file)


def test_a_curve_that_rises_with_size_or_is_missing_is_refused(tmp_path):
    file = tmp_path / "c.json"
    SizeCurves({"car": flat(1.5, per_log_height=0.5)}, {}).save(file)
    with pytest.raises(CurveError, match="distance must fall with size"):
        load_curves(file)
    with pytest.raises(CurveError, match="cannot be read"):
        load_curves(tmp_path / "none.json")

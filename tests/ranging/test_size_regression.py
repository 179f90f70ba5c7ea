"""SizeRanger as in a run: cut boxes, noise, classes and sigma."""

from dataclasses import replace

import numpy as np
import pytest

from track_range.detection.box_errors import NO_ERRORS, BoxError
from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.methods.size_regression import SizeRanger
from track_range.ranging.size_models.log_linear import SizeCurve, SizeCurves
from track_range.ranging.size_models.size_model import (
    SIZE_CLASSES,
    BoxNoise,
    box_error_table,
    detector_noise,
    have_hidden_sides,
    measured_boxes,
)
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

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
    return Tracks(
        np.arange(1, n + 1),
        np.array(boxes, float),
        np.full(n, class_id),
        np.ones(n),
        np.full(n, observed),
    )


def test_object_of_known_height_by_hand():
    ranger = SizeRanger(
        CAMERA, SizeCurves({"car": flat(1.5)}, {"car": flat(1.5)}), box_sigma_px=0.0
    )
    # 1.5 m over 50 px at f = 1000 px: 30 m
    ranges = ranger.measure(tracks_of([300, 200, 360, 250]), FRAME)
    assert ranges.distance_m == pytest.approx([30.0])
    assert ranges.sigma_m == pytest.approx([3.0])


def test_sigma_covers_both_classes_of_a_track_in_doubt():
    """A box of a car that may be a bus, with a probability of 0 to 1."""
    box, bus = [300.0, 200.0, 372.0, 250.0], ROAD_CLASSES.index("bus")

    def range_of(class_id, other=None, probability=0.0):
        tracks = tracks_of(box, class_id=class_id)
        if other is not None:
            doubt = {"other_class_id": np.array([other])}
            tracks = replace(tracks, **doubt, other_probability=np.array([probability]))
        ranges = SizeRanger(CAMERA).measure(tracks, FRAME)
        return float(ranges.distance_m[0]), float(ranges.sigma_m[0])

    (car_m, car_sigma_m), (bus_m, bus_sigma_m) = range_of(CAR), range_of(bus)
    assert bus_m - car_m > 3 * car_sigma_m
    assert range_of(CAR, bus, 0.0) == (car_m, car_sigma_m)
    assert range_of(CAR, bus, 1.0)[0] == pytest.approx(bus_m, rel=0.01)
    mixed_m, mixed_sigma_m = range_of(CAR, bus, 0.5)
    assert car_m < mixed_m < bus_m
    assert mixed_m - mixed_sigma_m < car_m + car_sigma_m
    assert mixed_m + 2 * mixed_sigma_m > bus_m - bus_sigma_m  # the shape is rather a car's
    # the same whichever of both is the class, but for what the sigma of a class is calibrated by
    assert range_of(bus, CAR, 0.5) == pytest.approx((mixed_m, mixed_sigma_m), rel=0.1)


def test_box_noise_widens_sigma_and_is_independent():
    ranger = SizeRanger(
        CAMERA, SizeCurves({"car": flat(1.5)}, {"car": flat(1.5)}), box_sigma_px=2.0
    )
    sized = ranger.measure(tracks_of([300, 200, 360, 250]), FRAME)
    assert sized.sigma_m == pytest.approx([30 * np.hypot(0.1, np.sqrt(2) * 2 / 50)])
    assert sized.sigma_systematic_m == pytest.approx([3.0])


def test_errors_of_a_detector_are_corrected_about_the_centre_and_systematic():
    """Boxes that are a tenth too low: 45 px high for 50 px, with both edges 2.5 px inside."""
    low = {"car": BoxError(float(np.log(0.9)), 0.06, 0.0, 0.0)}
    sizes = SizeCurves({"car": flat(1.5)}, {"car": flat(1.5)})
    known = SizeRanger(CAMERA, sizes, noise=BoxNoise(0.0, 0.0, 0.0), box_errors=low)
    ranges = known.measure(tracks_of([300, 202.5, 360, 247.5]), FRAME)
    assert ranges.distance_m == pytest.approx([30.0])
    assert ranges.sigma_m == ranges.sigma_systematic_m == pytest.approx([30 * np.hypot(0.1, 0.06)])
    box = np.array([[300.0, 202.5, 360, 247.5]])
    for name in ("car", "van"):
        size_class = np.array([SIZE_CLASSES.index(name)])
        table = box_error_table(low)
        boxes = measured_boxes(box, size_class, camera=CAMERA, noise=BoxNoise(), errors=table)
        assert boxes.bottom == pytest.approx([(250 - 240) / 1000])
        assert boxes.bearing == pytest.approx([10 / 1000])


def test_noise_of_a_detector_is_in_pixels_of_its_input():
    small, hd, full_hd = (detector_noise(width_px) for width_px in (320, 1280, 1920))
    assert small.px == pytest.approx(hd.px / 2)  # images below its input are not reduced
    assert full_hd.systematic_px == pytest.approx(1.5 * hd.systematic_px)
    box, car = np.array([[300.0, 200, 360, 250]]), np.array([CAR])
    sigma = measured_boxes(
        box, car, camera=CAMERA, noise=BoxNoise(0.0, systematic_px=2.0)
    ).systematic_sigma
    assert sigma == pytest.approx(np.array([[2 / 60, 2 / 50]]))


def test_boxes_of_an_unknown_detector_are_less_certain_than_exact_ones():
    boxes = tracks_of([300, 200, 360, 250])
    unknown, exact, known = (
        SizeRanger(CAMERA, **arguments).measure(boxes, FRAME)
        for arguments in ({}, {"box_sigma_px": 0.5}, {"box_errors": NO_ERRORS})
    )
    assert unknown.sigma_m > 1.05 * exact.sigma_m
    assert unknown.sigma_m > 1.05 * known.sigma_m


def test_detector_noise_grows_with_box_size():
    noise = BoxNoise(px=0.6, relative=0.01, relative_person=0.04)
    size_px = np.array([[80.0, 60.0], [80.0, 60.0]])
    sigma_px = noise.sigma_px(
        size_px, np.array([SIZE_CLASSES.index("van"), SIZE_CLASSES.index("person")])
    )
    assert sigma_px == pytest.approx(
        np.array([[1.0, np.hypot(0.6, 0.6)], [np.hypot(0.6, 3.2), np.hypot(0.6, 2.4)]])
    )
    far, near = (
        measured_boxes(np.array([[0, 0, s, s]], float), np.array([CAR]), camera=CAMERA, noise=noise)
        for s in (10, 200)
    )
    assert far.noise_variance[0, 0] > 10 * near.noise_variance[0, 0]


@pytest.mark.parametrize("curves", [None, SizeCurves({"car": flat(1.5)}, {"car": flat(1.5)})])
def test_unmeasurable_boxes_are_nan(curves):
    ranger = SizeRanger(CAMERA, curves)
    cut = tracks_of([300, -0.5, 360, 250], [300, 200, 360, 479.5], [300, 200, 360, 203])
    assert np.isnan(ranger.measure(cut, FRAME).distance_m).all()
    assert np.isnan(
        ranger.measure(tracks_of([300, 200, 360, 250], observed=False), FRAME).distance_m
    ).all()
    only_cars = SizeRanger(CAMERA, SizeCurves({"car": flat(1.5)}, {"car": flat(1.5)}))
    assert np.isnan(
        only_cars.measure(tracks_of([300, 200, 360, 250], class_id=0), FRAME).distance_m
    ).all()
    assert len(ranger.measure(Tracks.empty(), FRAME)) == 0


def test_cut_side_excludes_the_width():
    curves = SizeCurves({"car": flat(1.5, per_log_width=-0.5)}, {"car": flat(1.5)})
    whole, cut = (
        SizeRanger(CAMERA, curves)
        .measure(tracks_of([300, 200, 360, 250], [-0.5, 200, 59.5, 250]), FRAME)
        .distance_m
    )
    assert whole != pytest.approx(30.0)
    assert cut == pytest.approx(30.0)


HIDING = {
    "left": [220, 190, 300, 280],
    "right": [360, 190, 440, 280],
    "overlaps": [345, 190, 440, 280],
    "abuts": [366, 190, 440, 280],  # 6 px beside it, of at most 2 px and a tenth of its height
    "all": [290, 190, 440, 280],
}
SHOWING = {
    "beside": [368, 190, 440, 280],
    "farther": [345, 190, 440, 245],
    "low": [345, 228, 440, 280],  # covers less than the lower half
    "in the middle": [320, 190, 340, 280],
}


@pytest.mark.parametrize(("nearer", "is_hidden"), [(k, k in HIDING) for k in HIDING | SHOWING])
def test_width_of_a_box_with_a_hidden_side_is_not_used(nearer, is_hidden):
    boxes = tracks_of([300, 200, 360, 250], (HIDING | SHOWING)[nearer])
    assert have_hidden_sides(boxes.xyxy_px)[0] == is_hidden
    curves = SizeCurves({"car": flat(1.5, per_log_width=-0.5)}, {"car": flat(1.5)})
    distance_m = (
        SizeRanger(CAMERA, curves, has_visible_boxes=True).measure(boxes, FRAME).distance_m[0]
    )
    assert (distance_m == pytest.approx(30.0)) == is_hidden
    # boxes of labels
    assert SizeRanger(CAMERA, curves).measure(boxes, FRAME).distance_m[0] != pytest.approx(30.0)


def test_packaged_priors_with_a_hidden_side():
    """Of a car, a nearer one leaves a third visible: the distance remains that by height, and sigma
    grows."""
    whole = SizeRanger(CAMERA).measure(tracks_of([300, 200, 360, 250]), FRAME)
    ranger = SizeRanger(CAMERA, has_visible_boxes=True)
    parts = ranger.measure(tracks_of([300, 200, 320, 250], [320, 190, 440, 280]), FRAME)
    assert parts.distance_m[0] == pytest.approx(1.53 / 50 * 1000, rel=0.08)
    assert whole.sigma_m[0] / whole.distance_m[0] < parts.sigma_m[0] / parts.distance_m[0] < 0.2
    assert not have_hidden_sides(np.zeros((0, 4))).size


def test_packaged_priors_with_a_cut_side():
    """A car cut to a narrow strip is ranged by its height only."""
    ranger = SizeRanger(CAMERA)
    (sliver,) = ranger.measure(tracks_of([-0.5, 200, 9.5, 250]), FRAME).distance_m
    assert sliver == pytest.approx(1.53 / 50 * 1000, rel=0.08)


def test_van_uses_the_curve_of_cars():
    ranger = SizeRanger(CAMERA, SizeCurves({"car": flat(1.5)}, {"car": flat(1.5)}))
    van = tracks_of([300, 200, 360, 250], class_id=SIZE_CLASSES.index("van"))
    assert ranger.measure(van, FRAME).distance_m == pytest.approx([30.0])


def test_packaged_priors_decrease_with_size():
    ranger = SizeRanger(CAMERA)
    for class_id in range(len(SIZE_CLASSES)):
        boxes = [
            [320 - s / 2, 240 - s / 2, 320 + s / 2, 240 + s / 2] for s in (5, 10, 20, 50, 100, 300)
        ]
        ranges_by_size = [ranger.measure(tracks_of(box, class_id=class_id), FRAME) for box in boxes]
        distance_m = np.concatenate([ranges.distance_m for ranges in ranges_by_size])
        assert (np.diff(distance_m) < 0).all(), SIZE_CLASSES[class_id]
        assert (distance_m > 0).all()
        assert (np.concatenate([ranges.sigma_m for ranges in ranges_by_size]) > 0).all()

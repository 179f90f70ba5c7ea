"""Sizes of road users by region, and the region of a position."""

from typing import get_args

import numpy as np
import pytest

from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.region import Region, region_at
from track_range.ranging.size_models.size_model import SIZE_CLASSES, BoxNoise, measured_boxes
from track_range.stereo.geometry.camera import PinholeCamera

CAMERA = PinholeCamera(1000.0, 1000.0, 640.0, 360.0, 1280, 720)
REGIONS = get_args(Region)
MODELS = {region: load_curves(region=region) for region in REGIONS}


def measured(region, name, size_px):
    """Distance and relative sigma of one box of a size in px, ahead, whose bottom edge counts for
    nothing."""
    width, height = size_px
    xyxy_px = np.array([[640 - width / 2, 400 - height, 640 + width / 2, 400]])
    use = np.ones(1, np.bool_), np.zeros(1, np.bool_)
    size_class = np.array([SIZE_CLASSES.index(name)])
    boxes = measured_boxes(
        xyxy_px, size_class, camera=CAMERA, noise=BoxNoise(), uses_width_bottom=use
    )
    ranges = MODELS[region].measure(boxes)
    return float(ranges.distance_m[0]), float(ranges.sigma_m[0] / ranges.distance_m[0])


@pytest.mark.parametrize(
    ("position", "region"),
    [
        ((49.0, 8.4), "europe"),
        ((37.8, -122.4), "north-america"),
        ((1.3, 103.8), "east-asia"),
        ((35.7, 139.7), "east-asia"),
        ((-33.9, 151.2), "unknown"),
        ((28.6, 77.2), "unknown"),
    ],
)
def test_region_of_a_position(position, region):
    assert region_at(*position) == region


@pytest.mark.parametrize("region", REGIONS)
def test_priors_are_valid(region):
    for prior in MODELS[region].priors.values():
        assert not prior.faults()
        assert sum(fraction for fraction, _ in prior.components) == pytest.approx(1.0, abs=1e-3)
        assert 0 < prior.drive_sigma < prior.log_sigma[0]


def test_cars_of_north_america_are_larger_and_farther():
    europe, _ = measured("europe", "car", (47.0, 40.0))
    america, sigma = measured("north-america", "car", (47.0, 40.0))
    assert 1.03 < america / europe < 1.2
    assert sigma > 0.06


def test_an_unknown_region_lies_between_and_is_less_certain():
    distances = {region: measured(region, "car", (47.0, 40.0)) for region in REGIONS}
    assert distances["europe"][0] < distances["unknown"][0] < distances["north-america"][0]
    assert distances["unknown"][1] > 1.2 * distances["europe"][1]


def test_narrow_boxes_are_those_of_higher_cars():
    """At equal height, the box of a pickup or SUV is narrower than that of a saloon, so it is
    farther."""
    saloon, _ = measured("north-america", "car", (56.0, 40.0))
    pickup, _ = measured("north-america", "car", (43.0, 40.0))
    assert pickup > 1.08 * saloon
    assert (
        measured("europe", "car", (43.0, 40.0))[0]
        < 1.05 * measured("europe", "car", (56.0, 40.0))[0]
    )


def test_a_bicycle_without_rider_is_near():
    """A box as wide as it is high is a rider from the side; a low, wide one a bicycle alone: 1.1 m
    high, not 1.7."""
    with_rider, _ = measured("unknown", "bicycle", (100.0, 100.0))
    alone, sigma = measured("unknown", "bicycle", (155.0, 100.0))
    assert with_rider == pytest.approx(17.0, rel=0.1)
    assert alone == pytest.approx(11.0, rel=0.1)
    assert sigma < 0.2


@pytest.mark.parametrize(
    ("width_m", "height_m"),
    [(2.03, 2.12), (2.05, 2.04), (2.50, 3.40)],  # a full-size van, a heavy pickup, a lorry
)
def test_large_vehicles_called_cars_are_within_two_sigma(width_m, height_m):
    """Seen from behind at 40 m: 1000 px of focal length make 25 px of each metre."""
    distance_m, sigma = measured("north-america", "car", (25 * width_m, 25 * height_m))
    assert 40 * 0.7 < distance_m < 40 * 1.1
    assert abs(distance_m - 40) < 2 * sigma * distance_m

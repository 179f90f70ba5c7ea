"""Units of lengths, and parts of cameras, from the quantities of a calibration."""

import numpy as np
import pytest

from track_range.stereo.rig_formats.values.cameras import distortion_of, of_scalars, stated_size
from track_range.stereo.rig_formats.values.quantities import quantities_of
from track_range.stereo.rig_formats.values.units import Unit, unit_of


@pytest.mark.parametrize(
    ("content", "length", "metres", "reason"),
    [
        ({"T": [-120, 0, 0]}, 120.0, 0.001, "to be in millimetres"),
        ({"T": [-12, 0, 0]}, 12.0, 0.01, "in millimetres it would be 0.012 m"),
        # squares of 24 mm: T is in millimetres, too
        ({"T": [-12, 0, 0], "square_size": 24}, 12.0, 0.001, "to be in millimetres"),
        ({"T": [-0.12, 0, 0]}, 0.12, 1.0, "square size was given in metres"),
        ({"T": [-2, 0, 0]}, 2.0, 1.0, "a wide baseline"),
        ({"T": [-12, 0, 0], "units": "inches"}, 12.0, 0.01, "to be in"),
        ({"T": [-12, 0, 0], "units": "in"}, 12.0, 0.0254, "inches as the file states"),
        ({"T": [-12, 0, 0], "unit": "Metres"}, 12.0, 1.0, "metres as the file states"),
        ({"translation_mm": [-12, 0, 0]}, 12.0, 0.001, "millimetres by the name of T"),
        # 12 units are 12.1 cm, so the unit is the centimetre
        ({"T": [-12, 0, 0], "baseline_mm": 121}, 12.0, 0.01, "centimetres by the name of baseline"),
    ],
)
def test_unit_of_lengths(content, length, metres, reason):
    unit = unit_of(quantities_of(content, "a.yml"), length)
    assert (unit.metres, unit.is_doubtful) == (metres, False)
    assert reason in unit.reason


def test_a_length_between_metres_and_centimetres_is_in_doubt():
    given = quantities_of({"T": [-4, 0, 0]}, "a.yml")
    assert unit_of(given, 4.0).is_doubtful
    usual = Unit(0.001, "as usual")
    assert unit_of(given, 4.0, usual) == usual


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ({"D": [0.1, 0.2]}, [0.1, 0.2, 0, 0]),
        ({"RadialDistortion": [0.1, 0.2, 0.3]}, [0.1, 0.2, 0, 0, 0.3]),
        ({"k1": 0.1, "k2": 0.2, "p1": 0.3, "p2": 0.4}, [0.1, 0.2, 0.3, 0.4]),
        ({"k1": 0.1, "k3": 0.2}, [0.1, 0, 0, 0, 0.2]),
        ({"k1": 0.1, "k2": 0.2, "k3": 0.3, "k4": 0.4}, [0.1, 0.2, 0.3, 0.4]),  # Kannala-Brandt
        ({"k1": 0.1, "p1": 0.2, "k6": 0.3}, [0.1, 0, 0.2, 0, 0, 0, 0, 0.3]),
        ({"K": list(range(9))}, None),
    ],
)
def test_distortion_in_the_order_of_opencv(content, expected):
    distortion = distortion_of(quantities_of(content, "a.yml"), None)
    assert (None if distortion is None else distortion.tolist()) == expected


def test_camera_matrix_of_scalars():
    content = {"focal_length": 700, "cx": 320, "cy": 180}
    assert of_scalars(quantities_of(content, "a.yml"), None).tolist() == [700, 700, 320, 180]
    assert of_scalars(quantities_of({"focal_length": 700, "cx": 320}, "a.yml"), None) is None


@pytest.mark.parametrize("size", [[1280, 720], [720, 1280]])  # or rows and columns
def test_size_in_the_order_of_the_principal_point(size):
    given = quantities_of({"image_size": size}, "a.yml")
    assert stated_size(given, None, np.array([641.0, 355.0])).tolist() == [1280, 720]

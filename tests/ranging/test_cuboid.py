"""Boxes of cuboids against the projection of their eight corners and the ray to their surface."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.ranging.size_models.cuboid import CuboidBox, box_of_cuboid
from track_range.ranging.truth.reference_distance import surface_distance_m

HEIGHT_M = 1.65


def test_rear_straight_ahead_by_hand():
    """A cuboid 1.5 m high and 1.8 m wide with its rear at 20 m."""
    box = box_of_cuboid(
        np.log([1.5, 1.8, 4.0]),
        yaw_rad=np.zeros(1),
        bearing=np.zeros(1),
        distance_m=np.array([20.0]),
        camera_height_m=HEIGHT_M,
    )
    assert np.exp(box.log_width) == pytest.approx([1.8 / 20])
    assert np.exp(box.log_inverse_depth) == pytest.approx([1 / 20])
    top = (HEIGHT_M - 1.5) / 24  # of the front edge of the roof
    assert np.exp(box.log_height) == pytest.approx([HEIGHT_M / 20 - top])


@pytest.mark.parametrize("height_m", [1.2, 1.65, 3.2])
def test_boxes_of_another_height(height_m: float) -> None:
    """Lower and higher than the camera: the roof is seen or not."""

    def box(of_height_m: float) -> CuboidBox:
        return box_of_cuboid(
            np.log([of_height_m, 1.8, 4.0]),
            yaw_rad=np.array([0.0, 0.4, -1.2]),
            bearing=np.array([0.0, 0.3, -0.2]),
            distance_m=np.array([9.0, 20.0, 40.0]),
            camera_height_m=HEIGHT_M,
        )

    other = box(1.5).log_height_of(np.array(height_m), HEIGHT_M)
    np.testing.assert_allclose(other, box(height_m).log_height, rtol=1e-12)


@pytest.mark.slow
@given(
    st.floats(-1.5, 1.5),
    st.floats(-0.8, 0.8),
    st.floats(12.0, 80.0),
    st.tuples(st.floats(1.2, 3.5), st.floats(0.5, 2.5), st.floats(0.6, 6.0)),
)
@settings(deadline=None, max_examples=30)
def test_box_equals_projected_corners(yaw, bearing, distance_m, hwl):
    box = box_of_cuboid(
        np.log(hwl),
        yaw_rad=np.array([yaw]),
        bearing=np.array([bearing]),
        distance_m=np.array([distance_m]),
        camera_height_m=HEIGHT_M,
    )
    position = true_position(yaw, bearing, distance_m, hwl)
    columns, rows = corners(position, yaw, hwl)
    assert box.log_width == pytest.approx(np.log(columns.max() - columns.min()), abs=0.02)
    assert box.log_height == pytest.approx(np.log(rows.max() - rows.min()), abs=0.02)
    assert np.exp(box.log_inverse_depth) * HEIGHT_M == pytest.approx(rows.max(), rel=0.02)


def corners(position, yaw, hwl):
    """Columns and rows, divided by the focal length, of the eight corners of a cuboid at (x, z)."""
    height, width, length = hwl
    i, j, k = np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [0.0, 1.0])
    x = position[0] + np.sin(yaw) * i * length + np.cos(yaw) * j * width
    z = position[1] + np.cos(yaw) * i * length - np.sin(yaw) * j * width
    return x / z, (HEIGHT_M - k * height) / z


def true_position(yaw, bearing, distance_m, hwl):
    """(x, z) of a cuboid with the given bearing and surface distance, by damped iteration with
    `surface_distance_m`."""
    x, z = bearing * (distance_m + 1), distance_m + 1
    for _ in range(200):
        columns, _ = corners((x, z), yaw, hwl)
        x += 0.5 * (bearing - (columns.min() + columns.max()) / 2) * z
        (surface_m,) = surface_distance_m(
            np.array([[bearing, 0.0, 1.0]]),
            np.array([[x, hwl[0] / 2, z]]),
            size_hwl_m=np.array([hwl]),
            rotation_y_rad=np.array([yaw - np.pi / 2]),
        )
        step = 0.5 * (distance_m - surface_m)
        x, z = x + bearing * step, z + step
    assert surface_m == pytest.approx(distance_m, abs=1e-3)
    return x, z

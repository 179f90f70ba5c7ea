"""Errors of measured cuboids against those of labels, by cell.

    heading         difference of the yaws: modulo 360 of objects that move, modulo 180 of others
    nearest side    the edge of the footprint nearest to the straight path of the camera, below 30 m;
                    its sigma is propagated from centre, yaw, length and width as if their errors
                    were independent
    centre          distance between the centres, and its parts in the axes of the camera

A fraction within sigma takes the yaw modulo 180 where the front is not known, and modulo 360 where
it is stated. A side is seen where the view is at least 15 degrees off the long axis of the cuboid.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.bootstrap import Resamples, Statistic, figures_of
from track_range.ranging.truth.errors import fraction, within_sigmas
from track_range.ranging.world.cuboid_corners import cuboid_corners
from track_range.ranging.world.cuboids import Cuboids, wrapped_deg

_SIDE_DEG = 15.0  # smallest angle between the view and the long axis at which a side is seen
_SIDE_BELOW_M = 30.0  # distance up to which the nearest side is compared
DISTANCES_M = ((5, 10), (10, 20), (20, 30), (30, 50), (50, 100))

Errors = Mapping[str, tuple[FloatArray, FloatArray | None]]
"""(N,) signed errors, and errors in units of sigma, by the name of the quantity; NaN = unknown,
None = a distance without sign and sigma."""


def labelled_cuboids(
    bottom_m: FloatArray, size_hwl_m: FloatArray, rotation_y_rad: FloatArray
) -> Cuboids:
    """Cuboids of labels in KITTI's convention, whose bottom centres are in the camera's frame."""
    height_m = size_hwl_m[:, :1]
    return replace(
        Cuboids.unknown(len(bottom_m)),
        lwh_m=size_hwl_m[:, ::-1],
        yaw_deg=wrapped_deg(-90.0 - np.degrees(rotation_y_rad)),
        centre_m=bottom_m - height_m * [0.0, 0.5, 0.0],
    )


def are_sides_seen(true: Cuboids) -> BoolArray:
    """(N,) whether the view shows a long side."""
    view_deg = np.degrees(np.arctan2(-true.centre_m[:, 0], true.centre_m[:, 2]))
    off_axis = np.abs(np.sin(np.radians(true.yaw_deg - view_deg)))
    return np.asarray(off_axis >= np.sin(np.radians(_SIDE_DEG)))


def cuboid_errors(
    measured: Cuboids, true: Cuboids, *, is_moving: BoolArray, axis_rad: FloatArray | float = 0.0
) -> Errors:
    """Errors of N cuboids; `axis_rad` is the direction of the camera's axis from that of its path,
    positive = to the left.
    """
    difference_deg = measured.yaw_deg - true.yaw_deg
    either_deg, front_deg = (wrapped_deg(difference_deg, period) for period in (180.0, 360.0))
    stated_deg = np.where(measured.front_known, front_deg, either_deg)
    relative = measured.lwh_m / true.lwh_m - 1
    relative_sigma = measured.lwh_sigma_m / true.lwh_m
    offset_m = measured.centre_m - true.centre_m
    in_sigmas = offset_m / measured.centre_sigma_m
    side, side_sigma = _nearest_side(measured, true, axis_rad)
    sizes = {
        f"{name}_pct": (100 * relative[:, i], relative[:, i] / relative_sigma[:, i])
        for i, name in enumerate(("length", "width", "height"))
    }
    parts = {
        f"centre_{name}_m": (offset_m[:, i], in_sigmas[:, i])
        for i, name in enumerate(("right", "down", "forward"))
    }
    return {
        "heading_deg": (
            np.where(is_moving, front_deg, either_deg),
            stated_deg / measured.yaw_sigma_deg,
        ),
        **sizes,
        "nearest_side_m": (side, side / side_sigma),
        "centre_m": (np.linalg.norm(offset_m, axis=1), None),
        **parts,
    }


def _nearest_side(
    measured: Cuboids, true: Cuboids, axis_rad: FloatArray | float
) -> tuple[FloatArray, FloatArray]:
    """(N,) errors of the nearest edge across the path, positive = too far from it, with sigma."""
    right = np.stack(np.broadcast_arrays(np.cos(axis_rad), 0.0, -np.sin(axis_rad)), axis=-1)
    outward = np.sign((true.centre_m * right).sum(axis=1))[:, None] * right
    edge_m, true_edge_m = (
        (cuboid_corners(one) @ outward[..., None]).min(axis=(1, 2)) for one in (measured, true)
    )
    is_near = np.linalg.norm(true.centre_m[:, [0, 2]], axis=1) < _SIDE_BELOW_M
    turn_rad = np.radians(measured.yaw_deg) + axis_rad
    sin, cos = np.sin(turn_rad), np.cos(turn_rad)
    length_m, width_m, _ = measured.lwh_m.T
    of_turn = np.sign(sin * cos) * (length_m * np.abs(cos) - width_m * np.abs(sin)) / 2
    variance_m2 = ((measured.covariance_m2 @ right[..., None])[..., 0] * right).sum(axis=1)
    variance_m2 += (sin / 2 * measured.lwh_sigma_m[:, 0]) ** 2
    variance_m2 += (cos / 2 * measured.lwh_sigma_m[:, 1]) ** 2
    variance_m2 += (of_turn * np.radians(measured.yaw_sigma_deg)) ** 2
    return np.where(is_near, edge_m - true_edge_m, np.nan), np.sqrt(variance_m2)


def cuboid_figures(
    errors: Errors,
    cells: Mapping[str, BoolArray],
    measured: Cuboids,
    true: Cuboids,
    resamples: Resamples | None = None,
) -> dict[str, Any]:
    """Figures of each quantity by cell, as JSON values, with resamples also their 95 % intervals.

    Besides, of each cell: the number of boxes, the fraction with a cuboid, that of those whose
    front is stated, and the fraction of stated fronts that are right.
    """
    is_measured = np.isfinite(measured.yaw_deg)
    is_right = np.abs(wrapped_deg(measured.yaw_deg - true.yaw_deg)) < 90.0
    counts = {
        name: {
            "n": int(rows.sum()),
            "coverage": fraction(is_measured[rows]),
            "front_known": fraction(measured.front_known[rows & is_measured]),
            "front_right": fraction(is_right[rows & measured.front_known]),
        }
        for name, rows in cells.items()
    }
    figures = {
        quantity: {name: _figures(*values, rows, resamples) for name, rows in cells.items()}
        for quantity, values in errors.items()
    }
    return {"counts": counts, **figures}


def _figures(
    error: FloatArray, in_sigmas: FloatArray | None, rows: BoolArray, resamples: Resamples | None
) -> dict[str, Any]:
    chosen = np.where(rows, error, np.nan)
    size = np.abs(chosen)
    statistics = {"median": Statistic(size, 0.5), "p90": Statistic(size, 0.9)}
    if in_sigmas is not None:
        statistics["bias"] = Statistic(chosen, 0.5)
        statistics |= within_sigmas(np.where(rows, np.abs(in_sigmas), np.nan))
    return {"n": int(np.isfinite(chosen).sum()), **figures_of(statistics, resamples)}


def view_cells(true: Cuboids, rows: Mapping[str, BoolArray]) -> dict[str, BoolArray]:
    """Masks (N,) of the chosen rows by whether the view shows a side, with the name before it."""
    sides = {"side seen": are_sides_seen(true), "no side seen": ~are_sides_seen(true)}
    return {
        f"{name}, {side}": chosen & is_seen
        for name, chosen in rows.items()
        for side, is_seen in sides.items()
    }


def distance_cells(true: Cuboids, rows: BoolArray) -> dict[str, BoolArray]:
    """Masks (N,) of the chosen rows by the distance of the centre."""
    distance_m = true.centre_m[:, 2]
    return {
        f"{low}-{high} m": rows & (distance_m >= low) & (distance_m < high)
        for low, high in DISTANCES_M
    }

"""Errors and sigmas of measured motion by cell and by drive.

A cell is a named mask of the boxes. A sigma that is true for all boxes together may be too small in
the cells that matter and too large in the others; a pooled figure may hide a drive.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.evaluation.motion.labelled_motion import LabelledMotion
from track_range.evaluation.motion.measured_motion import MeasuredMotion
from track_range.evaluation.motion.scores import answers, between, quantities, resampled_drives
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.bootstrap import Resamples, Statistic, figures_of
from track_range.ranging.truth.errors import within_sigmas

_DISTANCES_M = ((5, 10), (10, 20), (20, 40), (40, 80))
_OWN_SPEEDS_MPS = {"0-0.5": (0.0, 0.5), "0.5-2": (0.5, 2.0), "2-6": (2.0, 6.0), "6-": (6.0, np.inf)}
MOVING_MPS = 1.0  # smallest own speed of an object that certainly moves in the labels
CLASSES = {
    "vehicles": ("car", "van", "truck", "bus"),
    "people": ("person",),
    "cyclists": ("bicycle", "motorcycle"),
}
_BORDER_PX = 2.0  # distance from the image border within which a box counts as cut
_TURN_RAD_S = 0.1  # smallest yaw rate of a turn: 6 degrees per second
_BELIEVED = 0.9  # smallest probability of an object that is believed to be static
_STANDING_MPS = 0.5  # largest speed of a camera that stands
_MIN_OF_DRIVE = 50  # smallest number of values of a drive that can be the worst one


def cell_figures(
    truth: LabelledMotion, measured: MeasuredMotion, seed: int | None = None
) -> dict[str, Any]:
    """Figures of closing speed, speed over ground and time to collision by cell, and by drive with
    the worst drive of each, as JSON values, with a seed also their 95 % intervals.
    """
    names, sequence = truth.boxes.sequence_names, truth.boxes.sequence
    drives = {names[number]: sequence == number for number in np.unique(sequence).tolist()}
    cells = motion_cells(truth, measured)
    resamples = None if seed is None else resampled_drives(truth, seed)
    tracks = dict[str, Resamples]()
    if seed is not None:
        track_id = truth.boxes.track_id
        tracks = {key: Resamples.of(track_id, seed=seed, rows=rows) for key, rows in drives.items()}
    by_cell, by_drive = dict[str, Any](), dict[str, Any]()
    for name, values in quantities(truth, measured).items():
        by_cell[name] = {
            key: quantity_figures(values, rows, resamples) for key, rows in cells.items()
        }
        by_drive[name] = {
            key: quantity_figures(values, rows, tracks.get(key)) for key, rows in drives.items()
        }
    worst = {name: worst_drive(figures) for name, figures in by_drive.items()}
    return {"cells": by_cell, "drives": by_drive, "worst_drives": worst}


def motion_cells(truth: LabelledMotion, measured: MeasuredMotion) -> dict[str, BoolArray]:
    """Masks (N,) of the boxes, by the name of the cell."""
    boxes, own_mps = truth.boxes, truth.speed_mps
    is_moving = own_mps > MOVING_MPS
    at = {f"{low}-{high} m": between(boxes.distance_m, low, high) for low, high in _DISTANCES_M}
    is_turn = np.abs(truth.yaw_rad_s) > _TURN_RAD_S
    is_speed_known = np.isfinite(measured.ego_mps)
    x1_px, y1_px, x2_px, y2_px = boxes.xyxy_px.T
    right_px, bottom_px = boxes.size_px.T - 1 - _BORDER_PX
    is_cut = (np.minimum(x1_px, y1_px) <= _BORDER_PX) | (x2_px >= right_px) | (y2_px >= bottom_px)
    return {
        "all": np.ones(len(boxes), np.bool_),
        **at,
        **{f"moving, {name}": is_moving & rows for name, rows in at.items()},
        "cut by the border": is_cut,
        "turn, speed known": is_turn & is_speed_known,
        "turn, speed unknown": is_turn & ~is_speed_known,
        **{
            f"own speed {name} m/s": between(own_mps, *limits)
            for name, limits in _OWN_SPEEDS_MPS.items()
        },
        "believed static": measured.static > _BELIEVED,
        **{name: np.isin(boxes.class_name, listed) for name, listed in CLASSES.items()},
        "camera stands": np.abs(truth.ego_mps) < _STANDING_MPS,
    }


def quantity_figures(
    values: FloatArray, rows: BoolArray, resamples: Resamples | None = None
) -> dict[str, Any]:
    """Errors and sigmas of values, sigmas and true values (3, N) in the rows (N,); None without an
    answer.

    `rms` and `stated_sigma` are root mean squares, so that they agree if sigma is true.
    """
    counts, error, sigma = answers(values, rows)
    statistics = {
        "rms": Statistic(error**2, is_root=True),
        "median_error": Statistic(error, 0.5),
        "stated_sigma": Statistic(sigma**2, is_root=True),
        **within_sigmas(error / sigma, (1, 2, 3)),
    }
    return {**counts, **figures_of(statistics, resamples)}


def worst_drive(by_drive: Mapping[str, Mapping[str, float | None]]) -> str | None:
    """The drive with the smallest fraction within 2 sigma of those with enough values; None = none
    has.
    """
    fractions = {
        name: figures["within_2_sigma"] or 0.0
        for name, figures in by_drive.items()
        if (figures["n"] or 0) * (figures["coverage"] or 0.0) >= _MIN_OF_DRIVE
    }
    return min(fractions, key=fractions.__getitem__, default=None)

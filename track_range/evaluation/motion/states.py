"""Scores of states of motion against the true ones.

A true speed below 0.5 m/s is `parked`; a faster object is `moving` or `oncoming` within 45 degrees
of the direction of the drive or against it, and else `crossing`. Slow objects and those near 45
degrees count in full, though no measurement can tell them apart.
"""

import itertools
from typing import Any

import numpy as np

from track_range.evaluation.motion.labelled_motion import LabelledMotion
from track_range.evaluation.motion.measured_motion import MeasuredMotion
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.truth.errors import fraction
from track_range.ranging.world.object_motion import MOTION_STATES

RESTING_MPS = 0.5  # true speed below which an object is parked
_PEOPLE = ("person", "bicycle")
# limits of the classes of stated probabilities, which are compared with how many states are right
_BINS = (0.5, 0.8, 0.9, 0.95, 0.99, 1.0)


def true_states(truth: LabelledMotion) -> FloatArray:
    """(N,) indices into `MOTION_STATES`; NaN = unknown."""
    angle_rad = truth.heading_rad + truth.axis_rad[truth.boxes.sequence]
    forward, left = np.cos(angle_rad), np.sin(angle_rad)
    conditions = {
        "parked": truth.speed_mps < RESTING_MPS,
        "moving": forward > np.abs(left),
        "oncoming": forward < -np.abs(left),
        "crossing": np.isfinite(angle_rad),
    }
    codes = [float(MOTION_STATES.index(name)) for name in conditions]
    state = np.select(list(conditions.values()), codes, np.nan)
    return np.where(np.isfinite(truth.speed_mps), state, np.nan)


def state_figures(truth: LabelledMotion, measured: MeasuredMotion) -> dict[str, Any]:
    """Figures of the states of vehicles and of people, as JSON values."""
    is_person = np.isin(truth.boxes.class_name, _PEOPLE)
    true = true_states(truth)
    return {
        "vehicles": _figures(true, measured, ~is_person),
        "people": _figures(true, measured, is_person),
    }


def _figures(true: FloatArray, measured: MeasuredMotion, rows: BoolArray) -> dict[str, Any]:
    """Fractions of the rows (N,) with a state and of the wrong states, the states by true state,
    and the right ones by stated probability.
    """
    rows = rows & np.isfinite(true)
    stated = rows & np.isfinite(measured.state)
    is_wrong = measured.state != true
    by_state: dict[str, Any] = {}
    for code, name in enumerate(MOTION_STATES):
        of_state = rows & (true == code)
        stated_codes = measured.state[of_state & stated]
        by_state[name] = {
            "n": int(of_state.sum()),
            "coverage": fraction(stated[of_state]),
            **{other: fraction(stated_codes == index) for index, other in enumerate(MOTION_STATES)},
        }
    reliability: dict[str, Any] = {}
    p = measured.state_probability
    for low, high in itertools.pairwise(_BINS):
        within = stated & (p >= low) & ((p < high) | (high == 1.0))
        reliability[f"{low:g}-{high:g}"] = {
            "n": int(within.sum()),
            "stated": round(float(p[within].mean()), 4) if within.any() else None,
            "right": fraction(~is_wrong[within]),
        }
    return {
        "n": int(rows.sum()),
        "coverage": fraction(stated[rows]),
        "wrong": fraction(is_wrong[stated]),
        "by_true_state": by_state,
        "reliability": reliability,
    }

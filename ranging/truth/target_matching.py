"""Matching of tracks and targets without boxes, over the whole of a track, and the offset of clocks.

A track and a target are compared in all moments that both have. In each, the largest deviation counts,
in standard deviations, of distance, lateral offset and closing speed:

    gain = sum over moments of  G - min(max(e_z^2, e_x^2, e_v^2), 2 G)        G: square of the gate

A pair with a negative gain is no match. Pairs are occupied in the order of their gain; a track has one
target, and a target has one track at a time, so that a target whose track was lost may have another one
later. Matched rows count with any error: only the whole of a track decides.

The clocks differ by a constant, which is what changes in time show: distances relative to the median of
their track, so that an error of scale does not look like an offset, and closing speeds. Its sigma is the
larger of that of the delete-a-group jackknife over spans of 2 s and of the curvature of the misfit.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.robust_statistics import jackknife_sigma
from track_range.ranging.truth.target_table import TargetTable

_GATE = 3.0  # standard deviations
# of a true distance, relative and in m (which point of the object was measured), of an offset to the
# side in m, and of a speed in m/s
_SCALE_SIGMA, _POINT_SIGMA_M, _SIDE_SIGMA_M, _SPEED_SIGMA_MPS = 0.05, 0.5, 0.7, 0.7
_REACH_S, _COARSE_S, _FINE_S = 5.0, 0.1, 0.02  # of offsets that are tried, and their steps
_FINE_REACH_S = 2.0
_GROUP_S = 2.0
_MAX_OFFSET_SIGMA_S = 0.3  # of an offset that is used
_FEWEST_GROUPS = 4
_MOST_NAMED = 5  # targets that a note names
_LEAST_MISFIT = 1e-6  # square of 0.1 %: exact measurements of exact targets
_MOST_ROWS = 5_000  # that show the offset


@dataclass(frozen=True, slots=True)
class MeasuredRows:
    """N rows of a run, one per track and frame."""

    frame: IntArray
    time: FloatArray  # (N,) of the clock of the table, before the offset
    track_id: IntArray
    # (3, N) distance ahead, offset to the right, closing speed, and their standard deviations
    values: FloatArray
    sigmas: FloatArray

    def select(self, rows: Any) -> "MeasuredRows":
        """The chosen rows."""
        parts = (self.frame[rows], self.time[rows], self.track_id[rows])
        return MeasuredRows(*parts, self.values[:, rows], self.sigmas[:, rows])


@dataclass(frozen=True, slots=True)
class MatchedTargets:
    """The target of each of N rows, and how the clocks fit."""

    target: IntArray  # (N,) index of the target; -1 = none
    values: FloatArray  # (3, N) true values
    offset_s: float  # of the clocks, as used
    offset_sigma_s: float  # NaN = given, or not known


def match_targets(table: TargetTable, rows: MeasuredRows) -> MatchedTargets:
    """Targets of the rows; the offset of the clocks is estimated if the table has none."""
    offset_s, sigma_s = table.offset_s or 0.0, np.nan
    if table.offset_s is None:
        step = max(1, len(rows.frame) // _MOST_ROWS)
        some = rows.select(slice(None, None, step))
        coarse = np.arange(-_REACH_S, _REACH_S + _COARSE_S / 2, _COARSE_S)
        totals = [_gains(table, some, offset).clip(min=0).max(axis=1).sum() for offset in coarse]
        # of equal ones that nearest to 0
        best = max(zip(totals, -np.abs(coarse), coarse, strict=True))[2]
        offset_s, sigma_s = _fine_offset(table, some, float(best))
        if not sigma_s <= _MAX_OFFSET_SIGMA_S:
            offset_s = 0.0
    target = _assigned(table, rows, offset_s)
    return MatchedTargets(target, _true_values(table, rows, target, offset_s), offset_s, sigma_s)


def offset_notes(table: TargetTable, matches: MatchedTargets) -> tuple[str, ...]:
    """Notes on the offset of the clocks, and on targets that no track was matched to."""
    name, sigma_s = table.path.name, matches.offset_sigma_s
    notes = []
    if sigma_s <= _MAX_OFFSET_SIGMA_S:
        notes.append(
            f"{name}: time of the video minus its time: {matches.offset_s:+.2f} s (sigma "
            f"{sigma_s:.2f} s), by how distances and speeds change; --truth-offset-s states it."
        )
    elif table.offset_s is None:
        notes.append(
            f"{name}: no offset of its clock was found in how distances and speeds change; 0 s is "
            "used. --truth-offset-s states another one."
        )
    lost = [one for number, one in enumerate(table.names) if not (matches.target == number).any()]
    if lost:
        more = " and more" if len(lost) > _MOST_NAMED else ""
        notes.append(
            f"{name}: no track fits {len(lost)} of {len(table.names)} targets: "
            f"{', '.join(lost[:_MOST_NAMED])}{more}."
        )
    return tuple(notes)


def _true_values(
    table: TargetTable, rows: MeasuredRows, target: IntArray, offset_s: float
) -> FloatArray:
    """(3, N) values of the targets of the rows."""
    values = np.full((3, len(target)), np.nan)
    for number in np.unique(target[target >= 0]).tolist():
        own = target == number
        values[:, own] = table.at(number, rows.time[own] - offset_s)
    return values


def _gains(table: TargetTable, rows: MeasuredRows, offset_s: float) -> FloatArray:
    """(tracks, targets) gains of the pairs."""
    tracks, index = np.unique(rows.track_id, return_inverse=True)
    gains = np.zeros((len(tracks), len(table.names)))
    floors = np.array([_POINT_SIGMA_M, _SIDE_SIGMA_M, _SPEED_SIGMA_MPS])[:, None]
    for number in range(len(table.names)):
        true = table.at(number, rows.time - offset_s)
        scale = np.array([_SCALE_SIGMA, 0.0, 0.0])[:, None] * true[0]
        sigma = np.sqrt(np.nan_to_num(rows.sigmas) ** 2 + floors**2 + scale**2)
        squares = np.nan_to_num(((rows.values - true) / sigma) ** 2, nan=0.0)
        is_known = np.isfinite(true[0]) & np.isfinite(rows.values[0])
        gain = _GATE**2 - np.minimum(squares.max(axis=0), 2 * _GATE**2)
        gains[:, number] = np.bincount(index, np.where(is_known, gain, 0.0), len(tracks))
    return gains


def _assigned(table: TargetTable, rows: MeasuredRows, offset_s: float) -> IntArray:
    """(N,) target of each row, -1 = none."""
    tracks, index = np.unique(rows.track_id, return_inverse=True)
    gains = _gains(table, rows, offset_s)
    target = np.full(len(rows.frame), -1)
    occupied: dict[int, set[int]] = {}
    free = set(range(len(tracks)))
    for pair in np.argsort(-gains, axis=None, kind="stable").tolist():
        track, number = divmod(pair, len(table.names))
        if gains[track, number] <= 0:
            break
        own = np.flatnonzero(index == track)
        frames = set(rows.frame[own].tolist())
        if track in free and not frames & occupied.setdefault(number, set()):
            occupied[number] |= frames
            free.discard(track)
            known = np.isfinite(table.at(number, rows.time[own] - offset_s)[0])
            target[own[known]] = number
    return target


def _fine_offset(table: TargetTable, rows: MeasuredRows, coarse_s: float) -> tuple[float, float]:
    """Offset and its sigma, infinite if the changes in time do not show it, from the tracks that
    match at a rough offset.
    """
    target = _assigned(table, rows, coarse_s)
    rows, target = rows.select(target >= 0), target[target >= 0]
    if not len(target):
        return 0.0, np.inf
    span = np.floor(rows.time / _GROUP_S)
    keys = np.stack([rows.track_id.astype(np.float64), span])
    group = np.unique(keys, axis=1, return_inverse=True)[1].reshape(-1)
    offsets = coarse_s + np.arange(-_FINE_REACH_S, _FINE_REACH_S + _FINE_S / 2, _FINE_S)
    curves = np.stack([_misfit(table, rows, target, offset, group) for offset in offsets])
    # the usual deviation at the offset where most spans fit
    usual = max(float(np.median(curves, axis=1).min()), _LEAST_MISFIT)
    curves = np.minimum(curves / usual, _GATE**2)
    if curves.shape[1] < _FEWEST_GROUPS:
        return 0.0, np.inf
    total = curves.sum(axis=1)
    without = offsets[np.argmin(total[:, None] - curves, axis=0)]
    near = offsets[total <= total.min() + 1]
    half_width = float(near.max() - near.min()) / 2
    spread = float(jackknife_sigma(without[:, None])[0])
    return float(offsets[np.argmin(total)]), max(half_width, spread, _FINE_S)


def _misfit(
    table: TargetTable, rows: MeasuredRows, target: IntArray, offset_s: float, group: IntArray
) -> FloatArray:
    """(groups,) mean squares of the deviations from the median of each track, relative for distances
    and of speeds as far as they move an object in a group.
    """
    true = _true_values(table, rows, target, offset_s)
    ratio = np.log(np.maximum(rows.values[0], 0.1) / np.maximum(true[0], 0.1))
    for track in np.unique(rows.track_id):
        own = rows.track_id == track
        if np.isfinite(ratio[own]).any():
            ratio[own] -= np.nanmedian(ratio[own])
    speed = (rows.values[2] - true[2]) * _GROUP_S / rows.values[0]
    # rows outside of the target's times say nothing for or against an offset
    squares = np.stack([ratio**2, speed**2])
    known = np.isfinite(squares)
    n = np.bincount(group, known.sum(axis=0))
    sums = np.bincount(group, np.where(known, squares, 0.0).sum(axis=0))
    return np.where(n > 0, sums / np.maximum(n, 1), np.inf)

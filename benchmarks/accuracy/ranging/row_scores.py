"""Errors of the rows of a run in the quantities that users see: fused and stereo distance, closing
speed, and the speed of the camera.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import track_range as tr
from benchmarks.harness import Figures
from track_range.foundation.arrays import FloatArray
from track_range.ranging.truth.errors import match_truth
from track_range.ranging.truth.truth import Truth

QUANTITIES = ("fused", "stereo", "closing", "ego")
NEAREST_M, FARTHEST_M = 5.0, 100.0  # distances that count


class RowScores:
    """Errors of the rows of a run."""

    def __init__(
        self,
        truth: Truth | None,
        true_mps: FloatArray | None = None,
        moment: Callable[[int], int] = lambda index: index,
    ) -> None:
        """`true_mps` (F,) are the speeds of the camera in the frames of the drive, `moment` gives
        the frame of the drive at the time of a frame of the run.
        """
        self._truth, self._true_mps, self._moment = truth, true_mps, moment
        self._rows: list[FloatArray] = []  # frame, time, box, and value and sigma of each quantity
        self._ego: list[tuple[float, ...]] = []  # time, true speed, speed, sigma

    def add(self, result: tr.FrameResult) -> None:
        """Add the rows of a frame with a detection, and the speed of the camera."""
        if self._true_mps is not None:
            true_mps = float(self._true_mps[self._moment(result.index)])
            self._ego.append((result.time_s, true_mps, result.ego_mps, result.ego_sigma_mps))
        n = len(result.tracks)
        unknown = np.full(n, np.nan)
        columns = [np.full(n, result.index), np.full(n, result.time_s), *result.tracks.xyxy_px.T]
        for name in ("fused", "stereo"):
            ranges = result.ranges.get(name)
            columns += [unknown, unknown] if ranges is None else [ranges.distance_m, ranges.sigma_m]
        columns += [result.closing_mps, result.closing_sigma_mps]
        self._rows.append(np.stack(columns, axis=1)[result.tracks.observed])

    def scores(self, from_s: float, until_s: float) -> dict[str, Any]:
        """Numbers of rows, of those without a value, and of those within 1 and 2 sigma, the median
        error and sigma, by quantity: distances in per cent, speeds in m/s.
        """
        figures: dict[str, Any] = {}
        values = dict.fromkeys(QUANTITIES, np.zeros((0, 4)))
        if self._truth is not None and self._rows:
            rows = np.concatenate(self._rows)
            match = match_truth(rows[:, 0].astype(np.int64), rows[:, 2:6], self._truth)
            rows, match = rows[match >= 0], match[match >= 0]
            true_m, true_mps = self._truth.distance_m[match], self._truth.closing_mps[match]
            is_true = np.isfinite(true_m) & (true_m >= NEAREST_M) & (true_m <= FARTHEST_M)
            for k, name in enumerate(("fused", "stereo", "closing")):
                true = np.where(is_true, true_m if k < 2 else true_mps, np.nan)
                values[name] = np.column_stack([rows[:, 1], true, rows[:, 6 + 2 * k : 8 + 2 * k]])
        if self._ego:
            values["ego"] = np.array(self._ego)
        for name in QUANTITIES:
            rows = values[name]
            is_scored = np.isfinite(rows[:, 1])
            is_scored &= (rows[:, 0] >= from_s - 1e-6) & (rows[:, 0] < until_s - 1e-6)
            figures |= quantity(name, *rows[is_scored, 1:].T)
        return figures


def quantity(
    name: str, true: FloatArray, value: FloatArray, sigma: FloatArray
) -> dict[str, float | int]:
    is_known = np.isfinite(value)
    error = np.abs(value - true)[is_known]
    unit, factor = ("mps", 1.0) if name in ("closing", "ego") else ("pct", 100 / true[is_known])
    spread = sigma[is_known]
    return {
        f"{name}_rows": len(true),
        f"{name}_known": len(error),
        f"{name}_1_sigma": int((error < spread).sum()),
        f"{name}_2_sigma": int((error < 2 * spread).sum()),
        f"{name}_median_{unit}": median(error * factor),
        f"{name}_sigma_{unit}": median(spread * factor),
    }


def median(values: Any) -> float:
    values = np.asarray(values, np.float64)
    values = values[np.isfinite(values)]
    return round(float(np.median(values)), 3) if len(values) else float("nan")


def pooled(rows: Sequence[dict[str, Any]]) -> Figures:
    """Figures of many runs: coverages over all rows, medians over the runs."""
    figures: Figures = {}
    for name in QUANTITIES:
        n_rows, n_known, n_1, n_2 = (
            sum(row[f"{name}_{part}"] for row in rows)
            for part in ("rows", "known", "1_sigma", "2_sigma")
        )
        unit = "mps" if name in ("closing", "ego") else "pct"
        figures |= {
            f"{name}_median_{unit}": median([row[f"{name}_median_{unit}"] for row in rows]),
            f"{name}_sigma_{unit}": median([row[f"{name}_sigma_{unit}"] for row in rows]),
            f"{name}_within_1_sigma": round(n_1 / n_known, 2) if n_known else float("nan"),
            f"{name}_within_2_sigma": round(n_2 / n_known, 2) if n_known else float("nan"),
            f"{name}_blank": round(1 - n_known / n_rows, 2) if n_rows else float("nan"),
        }
    return figures

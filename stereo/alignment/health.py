"""RigHealth: the distance errors that follow from a measured alignment, before and after its
correction, and how the parts of a drive agree.

    Z_measured / Z = d / (d - e(u))          d = f B / Z: true disparity, e(u) = d_true - d_measured at the column u

A wrong baseline, or a wrong focal length of both cameras, scales all distances and moves no point
of an image relative to another: no figure here contains this error.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.alignment.right_view import RightView
from track_range.stereo.geometry.alignment import MAX_ROW_OFFSET_PX, Alignment
from track_range.stereo.geometry.rig import StereoRig

DISTANCES_M = (10.0, 20.0, 30.0, 50.0)  # distances of the reported errors
# distance, and relative error of distances there from which an error matters
REFERENCE_M, MATTERS = 30.0, 0.01
# columns of the reported errors: the middle, and half-way to the edges
COLUMNS_U = np.array([-0.5, 0.0, 0.5])
# smallest noticed error in standard deviations; one of 46 windows of true rigs exceeded 2.5
_MIN_SIGMAS = 3.0
_MIN_FRACTION = 0.5  # smallest noticed error as a fraction of the one that matters
# smallest noticed movement in standard deviations: the most significant of several times
_MIN_MOVE_SIGMAS = 3.5

# Errors of a rig that no estimate from images contains.
UNSEEN = (
    "A wrong baseline, or a wrong focal length of both cameras, cannot be seen in the images: "
    "either error scales all distances by the same factor (1 % of the baseline changes every "
    "distance by 1 %). Check one known distance."
)

_PART = "without the error of the baseline"  # what images can show

State = Literal["good", "off", "unknown"]


class Window(NamedTuple):
    """The offset in a part of a drive."""

    drive: int  # number of the drive, from 0
    from_s: float
    to_s: float
    offset_px: float  # with the slope and the curvature of the whole estimate
    sigma_px: float


class Move(NamedTuple):
    """A change of the offset between two windows."""

    time_s: float  # middle of the time between them
    change_px: float  # offset after minus offset before
    sigma_px: float


@dataclass(frozen=True, slots=True)
class RigHealth:
    """State of a rig in terms of distances."""

    rig: StereoRig  # the rectified pair
    measured: Alignment
    applied: Alignment
    # offsets of the parts of the drive, in order of time; empty = not from a drive
    windows: tuple[Window, ...] = ()
    later: Move | None = None  # by the images after the windows

    @property
    def is_noticed(self) -> bool:
        """Whether an error that matters was measured: of the disparities, or of the rows."""
        return self.has_row_error or self.has_disparity_error

    @property
    def has_row_error(self) -> bool:
        """Whether corresponding points have different rows."""
        # a yaw is an error of the disparities
        view = replace(RightView.of(self.measured), yaw_deg=0.0)
        return view.rows_px(self.rig.left) > MAX_ROW_OFFSET_PX

    @property
    def has_disparity_error(self) -> bool:
        """Whether the error of the disparities is significant, and of a size that matters."""
        if not self.measured.is_measured:
            return False
        m, u = self.measured, COLUMNS_U
        error_px = np.abs(self._error_px)
        sigma_px = np.sqrt(
            m.offset_sigma_px**2 + (m.slope_sigma_px * u) ** 2 + (m.curvature_sigma_px * u**2) ** 2
        )
        return bool(
            (
                (error_px > _MIN_SIGMAS * sigma_px)
                & (error_px > _MIN_FRACTION * matters_px(self.rig))
            ).any()
        )

    @property
    def state(self) -> State:
        """The state: "off" if an error was noticed, "unknown" if disparities were not measured,
        else "good".
        """
        if self.is_noticed:
            return "off"
        return "good" if self.measured.is_measured else "unknown"

    @property
    def move(self) -> Move | None:
        """The time at which the offset changed most, if the windows do not agree within their
        sigmas.
        """
        return move_of(self.windows, self.rig) or self.later

    def before_pct(self, distance_m: float) -> FloatArray:
        """(3,) expected error in per cent at `COLUMNS_U` as calibrated, positive = too far; NaN =
        not measurable.
        """
        d = self._fb / distance_m
        measured_px = d - self._error_px
        with np.errstate(divide="ignore", invalid="ignore"):
            return np.where(measured_px > 0, 100 * (d / measured_px - 1), np.nan)

    def sigma_pct(self, distance_m: float) -> float:
        """Standard deviation of `before_pct` in the middle of the image."""
        return 100 * self.measured.offset_sigma_px * distance_m / self._fb

    def after_pct(self, distance_m: float) -> float:
        """Standard deviation of the relative error that remains, with or without a correction."""
        return 100 * self.applied.residual_px * distance_m / self._fb

    def to_dict(self) -> dict[str, Any]:
        """Plain values for JSON; null = unknown."""
        move = self.move
        return {
            "state": self.state,
            "is_noticed": self.is_noticed,
            "distances": [self._row(distance_m) for distance_m in DISTANCES_M],
            "windows": [window._asdict() for window in self.windows],
            "moved": None if move is None else move._asdict(),
            "sentence": self.sentence(),
            "move_sentence": self.move_sentence(),
            "unseen": UNSEEN,
        }

    def sentence(self) -> str:
        """The state of the rig at 30 m, as one sentence for users."""
        distance = f"{REFERENCE_M:.0f} m"
        after = f"{self.after_pct(REFERENCE_M):.1f} %"
        if self.state == "unknown":
            reason = (
                "" if self.measured.source == Alignment().source else f", {self.measured.source}"
            )
            return (
                f"Rig: not measured{reason}; expected error at {distance}, {_PART}: {after} (1 "
                "sigma)."
            )
        if self.state == "good":
            return (
                f"Rig: fits the images that were aligned; expected error at {distance}, {_PART}: "
                f"{after} (1 sigma)."
            )
        if not self.has_disparity_error:
            return (
                f"Rig: left and right images differ vertically; expected error at {distance} after "
                f"correction, {_PART}: {after} (1 sigma)."
            )
        left_pct, middle_pct, right_pct = self.before_pct(REFERENCE_M).tolist()
        before = (
            f"{middle_pct:+.1f} % in the middle, {left_pct:+.1f} % half-way to the left edge and "
            f"{right_pct:+.1f} % half-way to the right edge"
        )
        if not all(map(math.isfinite, (left_pct, middle_pct, right_pct))):
            before = "more than 100 %"
        if self.applied.is_correcting:
            return (
                f"Rig: distance error at {distance} as calibrated: {before}; after the correction, "
                f"{_PART}: {after} (1 sigma)."
            )
        return f"Rig: distance error at {distance} as calibrated: {before}; not corrected."

    def move_sentence(self) -> str:
        """Whether the rig moved during the drive, as one sentence for users; empty with fewer than
        two windows.
        """
        move = self.move
        if move is None and len(self.windows) < 2:
            return ""
        if move is None:
            spread_px = max(window.sigma_px for window in self.windows)
            return (
                f"Rig: {len(self.windows)} parts of the drive agree within {spread_px:.2f} px (1 "
                "sigma)."
            )
        # what has to be added to disparities that became smaller is positive
        change = f"{-move.change_px:+.2f} ± {move.sigma_px:.2f} px"
        pct = 100 * abs(move.change_px) * REFERENCE_M / self._fb
        return (
            f"Rig: a camera moved at about {move.time_s:.1f} s, which changed disparities by "
            f"{change} ({pct:.1f} % at {REFERENCE_M:.0f} m); mount the cameras more firmly."
        )

    @property
    def _error_px(self) -> FloatArray:
        """(3,) d_true - d_measured at `COLUMNS_U` as calibrated, with a large yaw of the right
        camera.
        """
        camera = self.rig.left
        x = COLUMNS_U * camera.width_px / 2 / camera.fx_px
        yaw_px = camera.fx_px * math.tan(math.radians(self.measured.yaw_deg)) * (1 + x**2)
        return self.measured.error_px(COLUMNS_U) - yaw_px

    @property
    def _fb(self) -> float:
        return self.rig.left.fx_px * self.rig.baseline_m

    def _row(self, distance_m: float) -> dict[str, float | None]:
        before_pct = (
            self.before_pct(distance_m) if self.measured.is_measured else np.full(3, np.nan)
        )
        left, middle, right = (round(float(v), 3) if math.isfinite(v) else None for v in before_pct)
        return {
            "distance_m": distance_m,
            "before_pct": middle,
            "before_left_pct": left,
            "before_right_pct": right,
            "before_sigma_pct": round(self.sigma_pct(distance_m), 3),
            "after_sigma_pct": round(self.after_pct(distance_m), 3),
        }


def move_of(windows: Sequence[Window], rig: StereoRig) -> Move | None:
    """The time at which the offset changed most between windows of a drive, in order of time; None
    = those of each drive agree within their sigmas.
    """
    moves = []
    for drive in {window.drive for window in windows}:
        own = [window for window in windows if window.drive == drive]
        for n in range(1, len(own)):
            (first_px, first_sigma_px), (last_px, last_sigma_px) = _mean(own[:n]), _mean(own[n:])
            time_s = (own[n - 1].to_s + own[n].from_s) / 2
            move = Move(time_s, last_px - first_px, math.hypot(first_sigma_px, last_sigma_px))
            smallest_px = max(_MIN_MOVE_SIGMAS * move.sigma_px, _MIN_FRACTION * matters_px(rig))
            if abs(move.change_px) > smallest_px:
                moves.append(move)
    return max(moves, key=lambda move: abs(move.change_px) / move.sigma_px, default=None)


def matters_px(rig: StereoRig) -> float:
    """Disparity error that changes distances by 1 % at 30 m."""
    return MATTERS * rig.left.fx_px * rig.baseline_m / REFERENCE_M


def _mean(windows: Sequence[Window]) -> tuple[float, float]:
    """Mean offset weighted by inverse variance, and its standard deviation."""
    offset_px, sigma_px = np.array([[window.offset_px, window.sigma_px] for window in windows]).T
    weight = sigma_px**-2
    return float((offset_px * weight).sum() / weight.sum()), float(weight.sum() ** -0.5)

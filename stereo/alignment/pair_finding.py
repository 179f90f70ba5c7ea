"""find_fault: the explanation of the figures of a pair, and its consequence for a run.

    fits       as in the rig                             verged     a constant error of the disparities: corrected
    swapped    left and right exchanged: an error        turned     both images upside down: turned back
    unsteady   rows change: not simultaneous, a matter of `recording.pairs.sync_monitor`
    refused    another explanation, or several: no stereo           unknown    too few matches

Two votes decide whether left and right are exchanged: the motion of the camera, and the road, on
which disparities grow downwards below the horizon, more regularly than disparities of trees and
houses grow upwards above the horizon.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import Note, Severity
from track_range.stereo.alignment.from_drive import NOT_MEASURED
from track_range.stereo.alignment.pair_evidence import Motion, PairFigures
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.rig import StereoRig

Fault = Literal["fits", "verged", "swapped", "turned", "unsteady", "refused", "unknown"]
# of which a pair is ranged by stereo
_USABLE = ("fits", "verged", "turned", "unsteady")

# matches of successive left images from which a pair without matches is one of different scenes
_MIN_TRACKED = 100
# largest ratio of agreeing matches to those, or half of that to matches, of images that differ
_MAX_UNRELATED = 0.05
_MAX_CHANCE = 0.3  # largest ratio of matches between different scenes to those
_MIN_AGREEING = 60  # minimum number of agreeing matches of all pairs
_MIN_FRACTION = 0.6  # minimum fraction of the matches that agree in rows
# of rows: smallest agreeing fraction, largest change between pairs
_STEADY_FRACTION, _STEADY_PX = 0.7, 0.25
# largest disparity without parallax, and the fraction that has none
_EQUAL_PX, _EQUAL_FRACTION = 1.5, 0.95
_MAX_HEIGHT_M = 3.5  # height of the cameras up to which points on the road must have more disparity
_LEAD = 1.15  # minimum ratio of the supports of two explanations
# minimum correlation of the half of the image with the road, and its lead
_MIN_GROUND, _GROUND_LEAD = 0.5, 0.1
# Disparity that no rig has, and the fractions of such points from which the order is doubted, and
# which needs a reason.
_NEGATIVE_PX, _MIN_EXCHANGED, _MAX_NEGATIVE = -3.0, 0.3, 0.1
_MIN_STEPS, _MIN_SUPPORT = 3, 0.25  # smallest number of steps, and support, of an offset
_MIN_OFFSET_PX, _MIN_SIGMAS = 5.0, 4.0  # smallest error of the disparities that is corrected here
# fractions of the points with less disparity than half of the offset: with a negative offset, far
# points must be there; with a positive offset, nearly no point may be
_MIN_FAR, _MAX_BEYOND = 0.03, 0.25
_MODEL_PX = 2.0  # standard deviation of the offset from other errors than noise
_YAW_ERROR_DEG = 0.7  # largest error of the yaw from rows
# Smallest yaw that is not residual distortion, and one that rows show clearly, with the smallest
# ratios of the supports of motion with and without it; largest ratio of the offsets with and
# without it.
_MIN_YAW_DEG, _CLEAR_YAW_DEG, _SMALL_YAW, _CLEAR_YAW, _MAX_REST = 0.5, 1.5, 1.05, 0.8, 0.6
_MIN_ROWS_PX = 1.5  # smallest error of rows that is corrected here
# ends of the sentence on a pair
_CORRECTED = "; corrected, but calibrate again."
_FOUND = "; corrected."
WITHOUT_STEREO = ". Distances come from the left video alone."
GIVEN = (
    "; --align auto corrects this error; with the given alignment, distances come from the left "
    "video alone."
)
LATER = (
    "; this error was found only after the vehicle moved, so distances come from the left video "
    "alone; start the run where it moves (--start), or calibrate again."
)
_ARRANGED = {
    "turned": "upside down (turned by 180 degrees)",
    "mirrored": "mirrored left to right",
    "flipped": "mirrored upside down",
}


@dataclass(frozen=True, slots=True)
class PairFinding:
    """The explanation of a pair, and its consequence."""

    fault: Fault
    explanation: str = ""  # for the user: what was found, without a full stop; empty = no message
    consequence: str = ""  # what a run does, or the user can do: continues the explanation
    prior: Alignment = NOT_MEASURED  # correction of the images with which the alignment starts

    @property
    def sentence(self) -> str:
        """What was found, and its consequence; empty = no message."""
        return f"{self.explanation}{self.consequence}"

    @property
    def note(self) -> Note:
        """The sentence with the code of its fault, "pair-" and its name."""
        severity: Severity = "warning" if self.fault in _USABLE else "error"
        return Note(self.sentence, f"pair-{self.fault}", severity, "pair")

    def uncorrected(self, consequence: str = GIVEN) -> PairFinding:
        """The finding in a run that shifts no images: no stereo if the pair needs a shift."""
        if self.fault != "verged":
            return self
        return replace(self, fault="refused", consequence=consequence)

    def corrected(self) -> PairFinding:
        """The finding where images are shifted: the inverse of `uncorrected`."""
        if self.fault != "refused" or self.prior == NOT_MEASURED:
            return self
        return replace(self, fault="verged", consequence=_CORRECTED)

    @property
    def needs_correction(self) -> bool:
        """Whether the images are corrected before the alignment is estimated."""
        is_shifted = self.fault == "fits" and self.prior != NOT_MEASURED
        return is_shifted or self.fault in ("verged", "turned")

    @property
    def has_stereo(self) -> bool:
        """Whether the pair can be ranged."""
        return self.fault not in ("swapped", "refused")


def find_fault(figures: PairFigures, rig: StereoRig, *, is_packed: bool = False) -> PairFinding:
    """The explanation of the figures of pairs that are rectified to `rig`.

    `is_packed`: whether both images are in one video, whose layout tells left from right.
    """
    n_agreeing = len(figures.left_px)
    if figures.is_late:
        return PairFinding("unsteady")
    n_tracked = figures.n_tracked * figures.n_pairs
    if (
        n_agreeing < _MAX_UNRELATED * min(n_tracked, 2 * figures.n_matches)
        and figures.n_tracked >= _MIN_TRACKED
    ):
        few = (
            f"{_pct(n_agreeing / figures.n_matches)} of {figures.n_matches} matching points are in "
            "consistent rows"
        )
        if figures.n_matches > _MAX_CHANCE * n_tracked:
            return _refused(
                f"{few}: the rig belongs to other cameras, a camera has turned, or left and right "
                "images are from different times; check the rig and the videos, or calibrate again"
            )
        return _refused(
            f"{few}, and successive left images have {figures.n_tracked:.0f} matches each: the "
            "videos show different scenes or times, or one camera is covered; check the names of "
            "the videos"
        )
    if n_agreeing < _MIN_AGREEING or figures.row_fraction < _MIN_FRACTION:
        return PairFinding("unknown" if n_agreeing < _MIN_AGREEING else "unsteady")
    if figures.row_fraction < _STEADY_FRACTION or figures.row_change_px > _STEADY_PX:
        return PairFinding("unsteady")
    if _is_without_parallax(figures, rig):
        return _refused(
            f"{100 * _EQUAL_FRACTION:.0f} % or more of {n_agreeing} matched points have no "
            "disparity, whether near or far: left and right images come from one camera; give the "
            "videos of both cameras"
        )
    exchanged, is_upright = _exchange(figures, rig)
    if figures.arrangement != "equal":
        return _arranged(figures, exchanged)
    if exchanged:
        return _exchanged(figures, rig, is_upright, is_packed=is_packed)
    return _verged(figures, rig) if exchanged is not None else _contradictory(figures, rig)


def _refused(reason: str) -> PairFinding:
    return PairFinding("refused", f"The rig does not fit these images: {reason}", WITHOUT_STEREO)


def _is_without_parallax(figures: PairFigures, rig: StereoRig) -> bool:
    """Whether near points have the disparity of far points, 0."""
    d = figures.disparity_px
    height_px = figures.left_px[:, 1] - rig.left.cy_px
    is_near = rig.baseline_m * height_px / _MAX_HEIGHT_M > 2 * _EQUAL_PX
    is_equal = np.abs(d) < _EQUAL_PX
    if is_near.sum() < _MIN_AGREEING / 2:
        return False
    return bool(min(is_equal.mean(), is_equal[is_near].mean()) >= _EQUAL_FRACTION)


def _exchange(figures: PairFigures, rig: StereoRig) -> tuple[bool | None, bool | None]:
    """Whether left and right are exchanged, None = contradictory; whether the road is below; None =
    unknown.
    """
    by_ground, is_upright = _vote_of_ground(figures)
    is_negative = float((figures.disparity_px < _NEGATIVE_PX).mean()) > _MIN_EXCHANGED
    if not is_negative:
        return False, is_upright
    votes = {_vote_of_motion(figures, rig), by_ground} - {None}
    return (votes.pop() if len(votes) == 1 else None), is_upright


def _vote_of_ground(figures: PairFigures) -> tuple[bool | None, bool | None]:
    """Whether left and right are exchanged, and whether the road is below, by how disparities grow
    with rows; None = unknown.
    """
    above, below = figures.ground
    if abs(below) >= _MIN_GROUND and abs(below) > abs(above) + _GROUND_LEAD:
        return below < 0, True
    if abs(above) >= _MIN_GROUND and abs(above) > abs(below) + _GROUND_LEAD:
        return above > 0, False
    return None, None


def _vote_of_motion(figures: PairFigures, rig: StereoRig) -> bool | None:
    """Whether left and right are exchanged, by the motion of the camera; None = unknown."""
    motion = _best(figures, rig)
    if motion is None:
        return None
    own = motion.support
    other = max(m.exchanged_support for m in (figures.motion, figures.turned_motion) if m)
    if other > _LEAD * own:
        return True
    return False if own > _LEAD * other else None


def _best(figures: PairFigures, rig: StereoRig) -> Motion | None:
    """The motion with or without the yaw that rows show; a small yaw must explain the disparities
    better.
    """
    plain, turned, yaw_deg = figures.motion, figures.turned_motion, abs(figures.view.yaw_deg)
    if plain is None or turned is None or yaw_deg < _MIN_YAW_DEG or turned.n_steps < _MIN_STEPS:
        return plain
    largest_px = max(
        rig.left.fx_px * math.tan(math.radians(_YAW_ERROR_DEG)), _MIN_SIGMAS * turned.sigma_px
    )
    if abs(turned.offset_px) > largest_px or not math.isfinite(largest_px):
        return plain
    is_better = (
        turned.support > (_CLEAR_YAW if yaw_deg >= _CLEAR_YAW_DEG else _SMALL_YAW) * plain.support
    )
    is_explained = abs(turned.offset_px) < _MAX_REST * abs(plain.offset_px) and _is_offset(plain)
    return turned if is_better or is_explained else plain


def _is_offset(motion: Motion) -> bool:
    """Whether the offset is large and significant."""
    smallest_px = max(_MIN_OFFSET_PX, _MIN_SIGMAS * math.hypot(motion.sigma_px, 1.0))
    return (
        motion.n_steps >= _MIN_STEPS
        and motion.support > _MIN_SUPPORT
        and abs(motion.offset_px) > smallest_px
    )


def _has_far_points(disparity_px: FloatArray, offset_px: float) -> bool:
    """Whether the smallest disparities, of far points, have the offset, rather than the points of
    one near object.
    """
    beyond = float((disparity_px < offset_px / 2).mean())
    return beyond > _MIN_FAR if offset_px < 0 else beyond < _MAX_BEYOND


def _arranged(figures: PairFigures, exchanged: bool | None) -> PairFinding:
    how = _ARRANGED[figures.arrangement]
    which = (
        "one of the two videos"
        if exchanged is None
        else "the left video"
        if exchanged
        else "the right video"
    )
    return _refused(
        f"{100 * figures.row_fraction:.0f} % of {figures.n_matches} points match if {which} is "
        f"{how}; correct {which}"
    )


def _exchanged(
    figures: PairFigures, rig: StereoRig, is_upright: bool | None, *, is_packed: bool
) -> PairFinding:
    evidence = _negative(figures, rig)
    if is_upright is False:
        return PairFinding(
            "turned",
            f"Both videos are upside down (turned by 180 degrees): {evidence}",
            ", and near points are at the top of the images, which are turned back.",
        )
    advice = "swap the two videos"
    if is_packed:
        advice = "give another --stereo-layout (Python: stereo_layout)"
    other = (
        "if both are mirrored, mirror them instead"
        if is_upright
        else "or turn both, if they are upside down"
    )
    return PairFinding(
        "swapped", f"left and right are swapped: {evidence}", f"; {advice} ({other})."
    )


def _contradictory(figures: PairFigures, rig: StereoRig) -> PairFinding:
    causes = "left and right are swapped, both are upside down, or a camera has turned"
    return _refused(
        f"{_negative(figures, rig)}: {causes}; check the videos, or record some seconds in motion"
    )


def _negative(figures: PairFigures, rig: StereoRig) -> str:
    """The evidence of negative disparities."""
    negative, motion = float((figures.disparity_px < 0).mean()), _best(figures, rig)
    text = f"{_pct(negative)} of {len(figures.left_px)} matched points have a negative disparity"
    if motion is None:
        return text
    own, other = _pct(motion.support), _pct(motion.exchanged_support)
    return (
        f"{text}, and their motion fits swapped videos ({other} of the points) or a turned camera "
        f"({own})"
    )


def _verged(figures: PairFigures, rig: StereoRig) -> PairFinding:
    """A pair in the right order: whether its disparities or rows have a large error."""
    motion, view = _best(figures, rig), replace(figures.view, yaw_deg=0.0)
    is_yaw = motion is not None and motion is figures.turned_motion and motion is not figures.motion
    prior = NOT_MEASURED
    if view.rows_px(rig.left) > _MIN_ROWS_PX:
        prior = replace(
            rig.unaligned,
            row_offset_px=view.row_offset_px,
            roll_deg=view.roll_deg,
            focal_ratio=view.focal_ratio,
        )
    is_offset = (
        motion is not None
        and _is_offset(motion)
        and _has_far_points(figures.disparity_px, motion.offset_px)
    )
    if motion is None or not (is_yaw or is_offset):
        negative = float((figures.disparity_px < _NEGATIVE_PX).mean())
        return (
            _contradictory(figures, rig)
            if negative > _MAX_NEGATIVE
            else PairFinding("fits", prior=prior)
        )
    sigma_px, yaw_deg, offset_px = math.hypot(_MODEL_PX, motion.sigma_px), 0.0, motion.offset_px
    size = "large" if offset_px > 0 else "small"
    what = (
        f"disparities are {abs(offset_px):.0f} px too {size}, as with shifted images or a turned "
        "camera"
    )
    # it explains rows and most of the offset; the rest is within its uncertainty, or that of the
    # motion
    if is_yaw:
        rest_px = offset_px if _MIN_SIGMAS * motion.sigma_px < _MIN_OFFSET_PX else 0.0
        yaw_deg = figures.view.yaw_deg + math.degrees(math.atan(rest_px / rig.left.fx_px))
        sigma_px = math.hypot(sigma_px, abs(offset_px) / 2)
        offset_px = 0.0
        what = f"the right camera is turned by {-yaw_deg:+.1f} degrees about its vertical axis"
    prior = replace(
        prior,
        offset_px=-offset_px,
        yaw_deg=yaw_deg,
        offset_sigma_px=sigma_px,
        residual_px=sigma_px,
        source=f"the first {figures.n_pairs} pairs",
    )
    support = (
        f"{_pct(motion.support)} of {motion.n_points} points move as this explains, "
        f"{_pct(motion.exchanged_support)} as in swapped videos"
    )
    if rig.is_assumed:
        return PairFinding(
            "verged", f"The cameras are not parallel: {what} ({support})", _FOUND, prior
        )
    return PairFinding(
        "verged", f"The rig does not fit these images: {what} ({support})", _CORRECTED, prior
    )


def _pct(fraction: float) -> str:
    return f"{100 * fraction:.0f} %"

"""Realignment: the alignment of a pair whose right camera moved far, from the frames after it.

    disparities changed by more than `RightCameraMonitor` measures well       -> estimating
    left and right no longer match: without right images, first pairs again   -> estimating
    estimating: 16 frames or more, with the images corrected so far           -> aligned

On simulated drives the monitor follows a yaw of 0.7 degrees (8 px) with a sigma of 0.1 px, and one of
2 degrees (23 px) with 1.7 px; changed rows it corrects as well as this estimate would.
"""

from __future__ import annotations

import math
from concurrent.futures import Future
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.background import Background, BackgroundObject, InThreads
from track_range.foundation.errors import Note
from track_range.stereo.alignment.from_drive import MIN_STEP_S, DriveAlignment
from track_range.stereo.alignment.pair_evidence import PairEvidence
from track_range.stereo.alignment.pair_finding import PairFinding, find_fault
from track_range.stereo.alignment.right_view import RightView
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.right_camera.correction import OFFSET, RightCamera

_FAR_PX = 8.0  # change of the disparities
# Fraction of the static points tracked to a frame that its right image shows, below which the pair
# is lost: 0.9 and more on simulated drives, 0.05 to 0.3 where the right camera turns by 2 degrees.
_MIN_SHOWN, _MIN_STATIC = 0.35, 30
_N_PAIRS, _MAX_PAIRS = 7, 10  # pairs by which a lost pair is explained: in motion, and at most
_MIN_FLOW_PX = 3.0  # median motion of the left image between them
_WAIT_AT_REST_S = 0.4  # time between two pairs without motion
_ROUGH_PX = 2.0  # standard deviation of the disparities of a pair that was explained


class Realigned(NamedTuple):
    """A pair that is aligned again."""

    base: FloatArray  # (3, 3) correction of the directions in the right image
    alignment: Alignment  # of the images corrected by it


class _LostPair(NamedTuple):
    """The evidence of a lost pair after a frame."""

    n_pairs: int
    is_moving: bool
    finding: PairFinding | None  # None = not enough pairs in motion


def _explain_with(evidence: PairEvidence, frame: Frame, rig: StereoRig) -> _LostPair:
    """Add a frame with a right image, and explain the pairs so far if they are enough."""
    if frame.right is not None:
        evidence.add(frame.left, whole_image(frame.right))
    is_moving = evidence.flow_px >= _MIN_FLOW_PX
    is_enough = evidence.n_pairs >= _N_PAIRS and is_moving
    finding = find_fault(evidence.figures(), rig) if is_enough else None
    return _LostPair(evidence.n_pairs, is_moving, finding)


def _align_with(drive: DriveAlignment, frame: Frame) -> Alignment | None:
    """Add a frame; the alignment if it is complete."""
    drive.add(frame)
    return drive.estimate() if drive.has_segments or drive.is_full else None


class Realignment:
    """Aligns the frames of one stream again, when its right camera moved far."""

    def __init__(self, rig: StereoRig, background: Background | None = None) -> None:
        """Start with a pair that matches; pairs are explained and aligned in the `background`, None
        = in threads, with waiting.
        """
        self._rig, self._background = rig, background or InThreads()
        # times at which left and right were lost first, and found last
        self._lost_s = self._until_s = math.nan
        self._evidence: BackgroundObject[PairEvidence] | None = None  # None = they match
        self._next_s = -math.inf  # time of its next pair
        self._drive: BackgroundObject[DriveAlignment] | None = None
        # what the background makes of the last frame that it got; None = it has none
        self._pending_pair: Future[_LostPair] | None = None
        self._pending_alignment: Future[Alignment | None] | None = None
        self._camera = RightCamera(rig.left)  # corrects the images of the drive

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        if math.isnan(self._lost_s):
            return ()
        lost = (
            f"Left and right images do not match from {self._lost_s:.1f} s on, as if the right "
            "camera moved far, or was covered"
        )
        if self.is_lost:
            return (
                Note(
                    f"{lost}: distances come from the left video alone.",
                    "pair-lost",
                    "error",
                    "pair",
                ),
            )
        return (
            Note(
                f"{lost}, until {self._until_s:.1f} s: distances came from the left video alone, and "
                "from then on, the pair has another alignment. Mount the cameras more firmly.",
                "pair-realigned",
                "warning",
                "pair",
            ),
        )

    @property
    def is_lost(self) -> bool:
        """Whether left and right do not match."""
        return self._evidence is not None

    @property
    def is_rough(self) -> bool:
        """Whether the next alignment is being estimated, or looked for."""
        return self.is_lost or self._drive is not None

    def check(self, time_s: float, n_static: int, n_shown: int, right: RightCamera) -> None:
        """Check whether left and right match: by the number of static points that were tracked to
        the left image, and of those that the right image shows. A hit that these show is known.
        """
        are_missing = n_static >= _MIN_STATIC and n_shown < _MIN_SHOWN * n_static
        if are_missing and not (right.is_hit or self.is_lost):
            self._drive = self._pending_alignment = None
            self._look()
            self._lost_s = time_s if math.isnan(self._lost_s) else self._lost_s

    def update(self, frame: Frame, right: RightCamera) -> Realigned | None:
        """Use the next frame, and how the right camera moved; returns the pair that is aligned again
        by this frame.
        """
        if self._evidence is not None:
            return self._rough_correction(self._evidence, frame)
        if self._drive is None and abs(right.applied_px[OFFSET]) > _FAR_PX:
            self._begin(right.matrix)
        return None if self._drive is None else self._estimated(self._drive, frame)

    def _look(self) -> None:
        """Look for a rough correction of a lost pair."""
        self._evidence = self._background.create(PairEvidence, self._rig.left)
        self._pending_pair = None

    def _begin(self, base: FloatArray) -> None:
        """Estimate the alignment of the next frames, corrected by `base`."""
        self._camera = RightCamera(self._rig.left, base=base)
        name = "the frames after a movement"
        self._drive = self._background.create(DriveAlignment, self._rig, None, name)
        self._pending_alignment = None

    def _rough_correction(
        self, evidence: BackgroundObject[PairEvidence], frame: Frame
    ) -> Realigned | None:
        """The rough correction of a lost pair."""
        if self._pending_pair is None and frame.right is not None and frame.time_s >= self._next_s:
            self._pending_pair = evidence.call(_explain_with, frame, self._rig)
        if self._pending_pair is None or not self._background.is_ready(self._pending_pair):
            return None
        lost, self._pending_pair = self._pending_pair.result(), None
        self._next_s = frame.time_s + (MIN_STEP_S if lost.is_moving else _WAIT_AT_REST_S)
        if lost.n_pairs >= _MAX_PAIRS:
            self._look()
        if lost.finding is None or lost.finding.fault not in ("fits", "verged"):
            return None
        self._evidence, self._until_s = None, frame.time_s
        prior = lost.finding.prior if lost.finding.needs_correction else self._rig.unaligned
        sigma_px = max(prior.residual_px, _ROUGH_PX)
        rough = replace(prior, residual_px=sigma_px, offset_sigma_px=sigma_px)
        corrected = self._realigned(rough, np.eye(3))
        self._begin(corrected.base)
        return corrected

    def _estimated(self, drive: BackgroundObject[DriveAlignment], frame: Frame) -> Realigned | None:
        """The estimate from the frames since the movement, if it is complete."""
        if self._pending_alignment is None and frame.right is not None:
            corrected = replace(frame, right=self._camera.warped(frame.right))
            self._pending_alignment = drive.call(_align_with, corrected)
        if self._pending_alignment is None or not self._background.is_ready(
            self._pending_alignment
        ):
            return None
        alignment, self._pending_alignment = self._pending_alignment.result(), None
        if alignment is None:
            return None
        if not alignment.is_measured:
            self._begin(self._camera.base)
            return None
        self._drive = None
        return self._realigned(alignment, self._camera.base)

    def _realigned(self, alignment: Alignment, base: FloatArray) -> Realigned:
        """The pair with an alignment of images that are corrected by `base`."""
        camera = self._rig.left
        shift = np.eye(3)
        shift[0, 2] = -alignment.shift_px / camera.fx_px
        view = RightView.of(alignment).if_needed(camera)
        corrected = replace(
            alignment.after_shift(), row_offset_px=0.0, roll_deg=0.0, focal_ratio=1.0, yaw_deg=0.0
        )
        return Realigned(shift @ view.matrix(camera) @ base, corrected)

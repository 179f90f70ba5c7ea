"""PairMonitor: explains the first pairs of a run; see `stereo.alignment.pair_finding`."""

import math
from concurrent.futures import Future
from contextlib import suppress
from typing import NamedTuple

from track_range.foundation.background import Background, InThreads
from track_range.foundation.errors import Note
from track_range.stereo.alignment.from_drive import MIN_STEP_S
from track_range.stereo.alignment.pair_evidence import PairEvidence, PairFigures
from track_range.stereo.alignment.pair_finding import PairFinding, find_fault
from track_range.stereo.alignment.right_view import RightView
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import RigError, StereoRig

MAX_CHECKED_PAIRS = 10  # largest number of pairs that are checked
_N_PAIRS = 7  # number of pairs that are enough in motion
_MIN_FLOW_PX = 3.0  # median motion from which the camera moves
_WAIT_S = 0.4  # longest time between two pairs, without motion
_WAIT_AT_REST_S = 1.0  # the same after the first explanation, which lacks the evidence of motion
MAX_FRAMES = round(MAX_CHECKED_PAIRS * _WAIT_S / MIN_STEP_S)  # number of frames with so many pairs

_UNMATCHED = Note(
    "The rig could not be checked: left and right have too few matching points in equal rows in "
    f"the first {MAX_CHECKED_PAIRS} pairs; check that the two videos and the rig belong together.",
    "pair-unmatched",
    "error",
    "pair",
)
_MIN_ROW_FRACTION = 0.5  # of the matches of an uncalibrated pair that has equal rows
_MAX_ROW_OFFSET_PX = 1.5  # vertical offset above which the user is warned if it is not corrected


class _Added(NamedTuple):
    """The evidence after a pair was added."""

    n_pairs: int
    flow_px: float  # median motion since the pair before


def _add(evidence: PairEvidence, frame: Frame) -> _Added:
    """Add a frame with a right image."""
    if frame.right is not None:
        evidence.add(frame.left, whole_image(frame.right))
    return _Added(evidence.n_pairs, evidence.flow_px)


class PairMonitor:
    """Checks the first pairs, which are rectified to `rig`, and explains contradictions.

    Pairs at rest do not show errors that all disparities have in common: the first pairs in motion
    are checked again.
    """

    def __init__(
        self,
        rig: StereoRig,
        *,
        is_packed: bool = False,
        background: Background | None = None,
    ) -> None:
        """Start without pairs; `is_packed` = left and right are parts of the same images. The
        features are found and matched in the `background`; None = in threads, with waiting.
        """
        self._is_packed, self._background = is_packed, background or InThreads()
        self._finding: PairFinding | None = None
        self._view = RightView()  # rows of the right camera
        self._row_fraction = 0.0
        self._rig = rig
        self._start()
        self._next_s, self._wait_s = -math.inf, MIN_STEP_S
        self._is_at_rest = False  # whether the pairs that were explained show no motion
        self._is_finished = False

    def _start(self) -> None:
        """Collect the evidence of other pairs."""
        self._evidence = self._background.create(PairEvidence, self._rig.left)
        self._n_pairs = self._n_moving = 0
        # the pair that is added, with its time, and the explanation; None = none in progress
        self._added: tuple[float, Future[_Added]] | None = None
        self._figures: Future[PairFigures] | None = None

    @property
    def finding(self) -> PairFinding | None:
        """The explanation of the pairs; None = not known yet."""
        return self._finding

    def add(self, frame: Frame) -> PairFinding | None:
        """Check a frame, if it is due; returns the explanation if it is known, or another one, from
        this frame on.

        Raises RigError once left and right are known to be swapped.
        """
        before = self._finding
        self._check_order()
        self._use_results()
        is_busy = self._added is not None or self._figures is not None
        is_due = frame.right is not None and frame.time_s >= self._next_s
        if is_due and not (self._is_finished or is_busy):
            self._added = frame.time_s, self._evidence.call(_add, frame)
            self._use_results()
        return None if self._finding is before else self._finding

    def _use_results(self) -> None:
        """Use the pair that was added, and the explanation, if they are ready."""
        if self._added is not None and self._background.is_ready(self._added[1]):
            (time_s, added), self._added = self._added, None
            self._count(time_s, *added.result())
            if self._has_enough and not self._is_at_rest:
                self._figures = self._evidence.call(PairEvidence.figures)
        if self._figures is not None and self._background.is_ready(self._figures):
            figures, self._figures = self._figures.result(), None
            self._explain(figures)
            self._check_order()

    def _count(self, time_s: float, n_pairs: int, flow_px: float) -> None:
        """Count the pair of a time, and decide when the next one is due."""
        self._n_pairs = n_pairs
        is_moving = flow_px > _MIN_FLOW_PX
        self._n_moving += is_moving
        if self._is_at_rest:
            self._wait_for_motion(is_moving=is_moving)
        elif n_pairs > 1 and not is_moving:
            self._wait_s = min(2 * self._wait_s, _WAIT_S)
        elif flow_px > 4 * _MIN_FLOW_PX:
            self._wait_s = MIN_STEP_S
        self._next_s = time_s + 0.99 * self._wait_s

    def _wait_for_motion(self, *, is_moving: bool) -> None:
        """Collect other pairs after an explanation at rest: from the first motion on, and before it in
        groups of `MAX_CHECKED_PAIRS`.
        """
        self._is_at_rest = not is_moving
        if is_moving or self._n_pairs >= MAX_CHECKED_PAIRS:
            self._start()
        self._wait_s = _WAIT_AT_REST_S if self._is_at_rest else MIN_STEP_S

    @property
    def _has_enough(self) -> bool:
        """Whether the pairs are enough for an explanation."""
        n_pairs = self._n_pairs
        return n_pairs >= MAX_CHECKED_PAIRS or (
            n_pairs >= _N_PAIRS and self._n_moving >= _N_PAIRS // 2
        )

    def explained(self) -> PairFinding | None:
        """The explanation of the pairs so far, None without pairs."""
        with suppress(RigError):
            self._use_results()
        if self._finding is None and self._n_pairs:
            self._explain(self._evidence.call(PairEvidence.figures).result())
        return self._finding

    def finish(self) -> PairFinding | None:
        """The same; only the first later pairs in motion are checked. Raises RigError if left and
        right are swapped.
        """
        finding = self.explained()
        self._check_order()
        return finding

    def _check_order(self) -> None:
        if self._finding is not None and self._finding.fault == "swapped":
            raise RigError(self._finding.sentence)

    def _explain(self, figures: PairFigures) -> None:
        finding = find_fault(figures, self._rig, is_packed=self._is_packed)
        if self._finding is None:
            self._finding, self._view = finding, figures.view
            self._row_fraction = figures.row_fraction
            self._is_at_rest = not self._n_moving and finding.fault == "fits"
        elif finding.fault in ("verged", "refused"):
            self._finding = finding
        self._is_finished = not self._is_at_rest

    def fits(self, frame: Frame) -> bool:
        """Whether a pair can be ranged by itself, which may not be enough for an explanation."""
        if frame.right is None:
            return False
        evidence = PairEvidence(self._rig.left)
        _add(evidence, frame)
        return find_fault(evidence.figures(), self._rig).has_stereo

    @property
    def has_equal_rows(self) -> bool:
        """Whether the images show that matching points of the pair have, or can get, equal rows."""
        if self._finding is None:
            return False
        if self._finding.fault == "unsteady":
            return self._row_fraction >= _MIN_ROW_FRACTION
        return self._finding.fault in ("fits", "verged", "turned")

    def notes(self, finding: PairFinding | None, corrected_px: float) -> tuple[str, ...]:
        """Messages for the user on the finding of a run, None = not known yet, which corrects a
        vertical offset of the checked pairs.
        """
        if finding is None:
            return ()
        if finding.fault == "unknown":
            return (_UNMATCHED,)
        if finding.sentence:
            return (finding.note,)
        row_px = self._view.row_offset_px - corrected_px
        if finding.fault == "unsteady" or abs(row_px) <= _MAX_ROW_OFFSET_PX:
            return ()
        return (
            Note(
                f"Left and right have a vertical offset of {row_px:+.1f} px: the rig does not fit "
                "these videos well, so stereo distances are less accurate; calibrate again.",
                "rig-does-not-fit",
                "warning",
                "pair",
            ),
        )

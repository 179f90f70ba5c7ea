"""PairMonitor: explains the first pairs of a run; see `stereo.alignment.pair_finding`."""

import math
from collections.abc import Iterable
from dataclasses import replace
from itertools import islice

from track_range.stereo.alignment.from_drive import MIN_STEP_S
from track_range.stereo.alignment.model import RightView
from track_range.stereo.alignment.pair_evidence import PairEvidence
from track_range.stereo.alignment.pair_finding import PairFinding, find_fault
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import RigError, StereoRig

MAX_CHECKED_PAIRS = 10  # largest number of pairs that are checked
_N_PAIRS = 7  # number of pairs that are enough in motion
_MIN_FLOW_PX = 3.0  # median motion from which the camera moves
_WAIT_S = 0.4  # longest time between two pairs, without motion
_WAIT_AT_REST_S = 1.0  # the same after the first explanation, which lacks the evidence of motion
_MAX_FRAMES = round(MAX_CHECKED_PAIRS * _WAIT_S / MIN_STEP_S)  # number of frames with so many pairs

_UNMATCHED = (
    "The rig could not be checked: left and right have too few matching points in equal rows in "
    f"the first {MAX_CHECKED_PAIRS} pairs; check that the two videos and the rig belong together."
)
_SWAP = "swap the two videos"  # advice of `find_fault`
_MIN_ROW_FRACTION = 0.5  # of the matches of an uncalibrated pair that has equal rows
_MAX_ROW_OFFSET_PX = 1.5  # vertical offset above which the user is warned if it is not corrected


class PairMonitor:
    """Checks the first pairs, which are rectified to `rig`, and explains contradictions.

    Pairs at rest do not show errors that all disparities have in common: the first pairs in motion
    are checked again.
    """

    def __init__(self, rig: StereoRig, *, is_packed: bool = False) -> None:
        self._is_packed = is_packed  # whether left and right are parts of the same images
        self.finding: PairFinding | None = None  # None = not known yet
        self.corrected_px = 0.0  # row offset that is corrected in the frames after the check
        self.view = RightView()  # rows of the right camera
        self._row_fraction = 0.0
        self._rig, self._evidence = rig, PairEvidence(rig.left)
        self._next_s, self._wait_s, self._n_moving = -math.inf, MIN_STEP_S, 0
        self._is_at_rest = False  # whether the pairs that were explained show no motion
        self._is_finished = False

    def add(self, frame: Frame) -> None:
        """Check a frame, if it is due; raises RigError once left and right are known to be
        swapped.
        """
        if self.finding is not None:
            self.finish()
        if self._is_finished or frame.right is None or frame.time_s < self._next_s:
            return
        self._evidence.add(frame.left, whole_image(frame.right))
        is_moving = self._evidence.flow_px > _MIN_FLOW_PX
        self._n_moving += is_moving
        n_pairs = self._evidence.n_pairs
        if self._is_at_rest:
            self._is_at_rest = not is_moving
            if is_moving or n_pairs >= MAX_CHECKED_PAIRS:
                self._evidence, self._n_moving = PairEvidence(self._rig.left), 0
                n_pairs = 0
            self._wait_s = _WAIT_AT_REST_S if self._is_at_rest else MIN_STEP_S
        elif n_pairs > 1 and not is_moving:
            self._wait_s = min(2 * self._wait_s, _WAIT_S)
        elif self._evidence.flow_px > 4 * _MIN_FLOW_PX:
            self._wait_s = MIN_STEP_S
        self._next_s = frame.time_s + 0.99 * self._wait_s
        is_enough = n_pairs >= MAX_CHECKED_PAIRS or (
            n_pairs >= _N_PAIRS and self._n_moving >= _N_PAIRS // 2
        )
        if is_enough and not self._is_at_rest:
            self._explain()
            self.finish()

    def watch(self, frames: Iterable[Frame]) -> None:
        """Read frames that are added to this monitor, until they are explained."""
        for _ in islice(frames, _MAX_FRAMES):
            if self.finding is not None:
                return

    def finish(self) -> PairFinding | None:
        """The explanation of the pairs so far, None without pairs; only the first later pairs in
        motion are checked.
        """
        if self.finding is None and self._evidence.n_pairs:
            self._explain()
        if self.finding is not None and self.finding.fault == "swapped":
            advice = (
                "give another --stereo-layout (Python: stereo_layout)" if self._is_packed else _SWAP
            )
            raise RigError(self.finding.sentence.replace(_SWAP, advice))
        return self.finding

    def _explain(self) -> None:
        figures = self._evidence.figures()
        finding = find_fault(figures, self._rig)
        if self.finding is None:
            self.finding, self.view, self._row_fraction = (
                finding,
                figures.view,
                figures.row_fraction,
            )
            self._is_at_rest = not self._n_moving and finding.fault == "fits"
        elif finding.fault in ("verged", "refused"):
            self.finding = finding
        self._is_finished = not self._is_at_rest

    @property
    def has_stereo_so_far(self) -> bool:
        """Whether the pairs so far can be ranged, although they may not be enough for an
        explanation.
        """
        return find_fault(self._evidence.figures(), self._rig).has_stereo

    @property
    def row_offset_px(self) -> float | None:
        """The vertical offset that makes rows of an uncalibrated pair equal; None if there is no
        such offset.
        """
        if self.finding is None or self.finding.fault not in ("fits", "verged", "unsteady"):
            return None
        is_shift = (
            replace(self.view, row_offset_px=0.0).rows_px(self._rig.left) <= _MAX_ROW_OFFSET_PX
        )
        if self.finding.fault == "unsteady":
            return 0.0 if self._row_fraction >= _MIN_ROW_FRACTION else None
        return self.view.row_offset_px if is_shift else None

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        if self.finding is None:
            return ()
        if self.finding.fault == "unknown":
            return (_UNMATCHED,)
        row_px = self.view.row_offset_px - self.corrected_px
        if (
            self.finding.sentence
            or self.finding.fault == "unsteady"
            or abs(row_px) <= _MAX_ROW_OFFSET_PX
        ):
            return tuple(filter(None, [self.finding.sentence]))
        return (
            f"Left and right have a vertical offset of {row_px:+.1f} px: the rig does not fit "
            "these videos well, so stereo distances are less accurate; calibrate again.",
        )

"""PairAligner: frames of two cameras as they are recorded -> simultaneous, rectified frames with
their alignment.

    recorded frame -> rectify -> synchronise (`SyncMonitor`) -> check (`PairMonitor`)
                   -> estimate -> frame with its alignment

    state        frames that are returned         event                      -> next state
    looking      none: they are read again        enough frames              -> fixed
                                                  verged, turned, rows       -> looking, corrected
                                                  refused                    -> refused
    estimating   not corrected, or by the last    estimate                   -> estimating
                 estimate; without right images   last estimate              -> fixed
                 until the pair is explained      verged, turned             -> estimating, corrected
                                                  refused                    -> refused
    fixed        corrected by the estimate or by  verged, refused            -> see `reads_ahead`
                 what is given, or not corrected  turned                     -> fixed, corrected
    refused      without right images; or, if it  -
                 was looking, without a rig; so
                 are pairs of which neither rig
                 nor images show equal rows

Events are explanations of `PairMonitor` (`stereo.alignment.pair_finding`) or
estimates. Frames of files and cameras are read ahead, so they start with looking (`look`, `start`);
frames that come one by one with estimating (`add`, `estimate`); both with fixed if the alignment is
given, after a look. Swapped images are an error in each state. What depends on the source of the
frames is in `AlignerPolicy`.
"""

import math
import time
from collections import deque
from collections.abc import Iterable, Iterator
from concurrent.futures import Future
from dataclasses import dataclass, replace
from typing import NamedTuple

from track_range.foundation.background import Background, BackgroundObject, InThreads
from track_range.recording.cameras.auto_alignment import PairAlignment
from track_range.recording.cameras.calibration import RecordingCalibration
from track_range.recording.pairs.estimates import AlignmentEstimates, PairEstimate
from track_range.recording.pairs.pair_monitor import MAX_FRAMES, PairMonitor
from track_range.recording.pairs.sync_monitor import SyncMonitor
from track_range.recording.video.frame import RecordedFrame
from track_range.recording.video.threads import FRAMES_AHEAD
from track_range.stereo.alignment.common_moment import ClockOffset
from track_range.stereo.alignment.from_drive import MIN_STEP_S, DriveAlignment
from track_range.stereo.alignment.pair_finding import LATER, WITHOUT_STEREO, PairFinding
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame

# length, in s, of the part of a drive from which the alignment is estimated
ESTIMATION_SPAN_S = 8.0
# frames between two checks of the synchronisation of those from which the alignment is estimated
_FIRST_PERIOD = 2
# frames that wait for the background, which takes a second for some; further ones are left out
_MAX_PENDING = 8
_MAX_PENDING_BEFORE = 1  # the same before the pair is checked, which would have to wait for them
# explanations that a pair of different moments has, too
_DOUBTFUL = ("unsteady", "unknown", "refused", "swapped")
_UNSTEADY = (
    "not measured, since the vertical offset between left and right changes, as in images of "
    "different times"
)


@dataclass(frozen=True, slots=True, kw_only=True)
class AlignerPolicy:
    """What depends on where the frames of a pair come from."""

    # Whether the first frames are read before any frame is returned, and then again. If not, the
    # errors that are found later are corrected from then on; if so, they end stereo, since frames
    # that are already returned cannot be corrected.
    reads_ahead: bool
    # times of the estimates, in s after the first frame in motion; not used for frames read ahead,
    # which have one estimate of all
    estimates_s: tuple[float, ...] = ()
    n_ahead: int = 0  # frames that wait for later ones, by which they are paired again
    has_checks: bool = True  # whether the order, the rows and the times of the pair are checked


RECORDED = AlignerPolicy(reads_ahead=True, n_ahead=FRAMES_AHEAD)
LIVE = AlignerPolicy(reads_ahead=True)  # a frame that waits would delay a stream
ONE_BY_ONE = AlignerPolicy(reads_ahead=False, estimates_s=(2.0, 4.0, 8.0))


@dataclass(frozen=True, slots=True)
class AlignedFrame:
    """A rectified frame."""

    # with the alignment at its time; without its right image if this is not simultaneous, or not
    # usable
    frame: Frame
    calibration: RecordingCalibration  # by which it is rectified
    finding: PairFinding | None  # how the pair fits the rig; None = not known yet, or not checked


def _apart(offset: ClockOffset) -> PairFinding:
    """The explanation of a pair in which no right image shows the moment of a left one."""
    return PairFinding(
        "refused",
        "Left and right do not show the same moment: no right image of the first seconds has more "
        f"than {offset.points:.0f} points in the rows of a left image, although successive left "
        f"images share {offset.other_points:.0f}; give two videos of one drive that start together",
        WITHOUT_STEREO,
    )


class _Look:
    """First frames, which are read again: the drive of the estimate, and how many are needed."""

    def __init__(self, drive: DriveAlignment | None, sync: SyncMonitor | None) -> None:
        self.drive = drive  # None = the alignment is given
        self.sync = sync  # None = without checks
        self.began_s = time.perf_counter()
        self.first_s, self.last_s = math.nan, -math.inf
        self._used_s, self._n_used = -math.inf, 0

    def uses(self, frame: Frame) -> bool:
        """Whether a frame has the interval of those that are used."""
        if math.isnan(self.first_s):
            self.first_s = frame.time_s
        self.last_s = frame.time_s
        is_used = frame.time_s - self._used_s >= MIN_STEP_S
        if is_used:
            self._used_s = frame.time_s
            self._n_used += 1
        return is_used

    def has_enough(self, finding: PairFinding | None) -> bool:
        """Whether no more frames are needed, by what is known of the pair."""
        if self.last_s - self.first_s > ESTIMATION_SPAN_S:
            return True
        if self.drive is None:
            return finding is not None or self._n_used >= MAX_FRAMES
        return self.drive.is_full


@dataclass(frozen=True, slots=True)
class _Sample:
    """A frame from which the alignment may be estimated."""

    aligned: Frame  # synchronised and rectified
    recorded: RecordedFrame
    estimates: BackgroundObject[AlignmentEstimates]  # that use it


class _Pending(NamedTuple):
    """What the background makes of a sample."""

    estimates: BackgroundObject[AlignmentEstimates]
    estimate: Future[PairEstimate | None]


class PairAligner:
    """Aligns the frames of a pair, in order, in one thread at a time; what it returns are values.

    Frames that are read ahead: `look` and `start` as long as `is_looking`, then `frames`. Frames that
    come one by one: `add`, and then `estimate`, which another frame or `use_estimates` uses.
    """

    def __init__(
        self,
        calibration: RecordingCalibration,
        policy: AlignerPolicy,
        given: PairAlignment | None = None,
        *,
        is_packed: bool = False,
        background: Background | None = None,
    ) -> None:
        """Start with a pair that is not aligned yet.

        Args:
            calibration: the pair without its alignment.
            policy: what depends on the source of the frames.
            given: an alignment that does not change; None = it is estimated.
            is_packed: whether left and right are parts of the same images.
            background: where pairs are checked, and estimates are made of frames that come one by
                one; None = in threads, with waiting.
        """
        self._policy, self._given = policy, given
        self._background = background or InThreads()
        if calibration.rig is None:
            raise ValueError("calibration: expected that of a pair")
        self._rig = rig = calibration.rig
        self._plain = calibration  # without the alignment
        self._calibration = calibration if given is None else calibration.with_alignment(given)
        # frames for estimates: without an alignment, or corrected by the prior of the estimates
        self._unaligned = calibration
        has_checks = policy.has_checks or rig.is_assumed
        self._check: PairMonitor | None = None
        if has_checks:
            self._check = PairMonitor(rig, is_packed=is_packed, background=self._background)
        self._sync: SyncMonitor | None = None
        self._finding: PairFinding | None = None
        self._has_stereo = True
        self._sample: _Sample | None = None
        self._sampled_s = -math.inf  # time of the last sample
        self._pending: deque[_Pending] = deque()
        # the state of the alignment: looking or estimating; None = fixed, or refused
        self._state: _Look | BackgroundObject[AlignmentEstimates] | None = None
        if not policy.reads_ahead:
            self._has_stereo = False  # until the pair is explained
            self._sync = SyncMonitor(policy.n_ahead)
            self._state = None if given is not None else self._estimates()
        elif given is not None and not has_checks:
            self._begin(given)
        else:
            self._state = self._look()

    @property
    def calibration(self) -> RecordingCalibration:
        """The camera models of the next rectified frame, with the alignment as known so far."""
        return self._calibration

    @property
    def finding(self) -> PairFinding | None:
        """How the pair fits the rig; None = not known yet, or not checked."""
        return self._finding

    @property
    def sync(self) -> SyncMonitor | None:
        """The check that left and right show the same moment; None = there is none."""
        return self._sync

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user about the pair so far, without those of its calibration."""
        pair = () if self._check is None else self._check.notes(self._finding, self._corrected_px)
        times = () if self._sync is None else self._sync.notes
        return (*pair, *times)

    @property
    def _corrected_px(self) -> float:
        """The vertical offset of the pairs that were checked which is corrected since then."""
        alignment = self._calibration.alignment
        if alignment is None or self._given is not None:
            return 0.0
        return alignment.measured.row_correction_px

    @property
    def is_looking(self) -> bool:
        """Whether the first frames are read ahead, from the first one on."""
        return isinstance(self._state, _Look)

    @property
    def is_estimating(self) -> bool:
        """Whether the frames that are read ahead are used to estimate the alignment."""
        return isinstance(self._state, _Look) and self._state.drive is not None

    @property
    def looked_s(self) -> float:
        """Length of the part that was read ahead."""
        look = self._state
        if not isinstance(look, _Look) or math.isnan(look.first_s):
            return 0.0
        return look.last_s - look.first_s

    def look(self, recorded: RecordedFrame) -> bool:
        """Use the next of the first frames; returns whether more are needed.

        Raises RigError once left and right are known to be swapped.
        """
        if not isinstance(self._state, _Look):
            return False
        frame = self._calibration.rectified(recorded)
        sync = self._state.sync
        return self._look_at(self._state, [frame] if sync is None else sync.add(frame))

    def _look_at(self, look: _Look, frames: Iterable[Frame]) -> bool:
        """Check simultaneous frames and use them for the estimate, until they are enough."""
        for frame in frames:
            if look.uses(frame):
                if self._check is not None:
                    self._check.add(frame)
                if look.drive is not None:
                    look.drive.add(frame)
            if self._has_enough(look):
                return False
        return True

    @property
    def doubts_moments(self) -> bool:
        """Whether the frames that were read ahead may be pairs of different moments."""
        if not isinstance(self._state, _Look) or self._check is None:
            return False
        finding = self._check.explained()
        return finding is None or finding.fault in _DOUBTFUL

    def look_again(self) -> None:
        """Start with other pairs of the same two videos."""
        self._check = PairMonitor(self._rig, background=self._background)
        self._state = self._look()

    def start(self, offset: ClockOffset | None = None) -> None:
        """Explain the pair by the frames that were read ahead, and align it, or look again.

        `offset` is what a search for other pairs has shown; None = there was none. Raises RigError
        if left and right are swapped.
        """
        look = self._state
        if not isinstance(look, _Look):
            return
        if look.sync is not None and not self._has_enough(look):
            self._look_at(look, look.sync.flush())
        self._finding = None if self._check is None else self._check.finish()
        if self._finding is not None and self._given is not None:
            self._finding = self._finding.uncorrected()
        finding = self._finding or PairFinding("unknown")
        is_explained = finding.fault not in ("unsteady", "unknown")
        if offset is not None and offset.kind == "apart" and not is_explained:
            finding = self._finding = _apart(offset)
        if self._rig.is_assumed and (self._check is None or not self._check.has_equal_rows):
            self._check = None  # the calibration has the note
            finding = PairFinding("refused")
        if not finding.has_stereo:
            # the images are returned, but without a rig nothing is measured by them
            self._calibration, self._state = replace(self._plain, rig=None), None
            return
        is_corrected = self._unaligned is not self._plain
        if finding.fault == "turned" and not is_corrected:
            self._turn()
        if self._given is not None:
            self._begin(self._given)
        elif finding.fault == "unsteady":
            unsteady = replace(self._rig.unaligned, source=_UNSTEADY)
            self._begin(PairAlignment(measured=unsteady, is_applied=False, rig=self._rig))
        elif finding.needs_correction and not is_corrected:
            self._correct(finding.prior)
            self._state = self._look(finding.prior)
        elif look.drive is not None:
            estimated = PairAlignment.of_drive(look.drive, self._rig)
            estimation_s = time.perf_counter() - look.began_s
            self._begin(replace(estimated, estimation_s=estimation_s))

    def _has_enough(self, look: _Look) -> bool:
        return look.has_enough(None if self._check is None else self._check.finding)

    def _begin(self, alignment: PairAlignment) -> None:
        """Return frames with an alignment from now on."""
        self._calibration = self._plain.with_alignment(alignment)
        self._state = None
        self._sync = SyncMonitor(self._policy.n_ahead) if self._policy.has_checks else None

    def _look(self, prior: Alignment | None = None) -> _Look:
        """The state in which the first frames are read, corrected by `prior`."""
        drive = DriveAlignment(self._rig, prior) if self._given is None else None
        sync = None
        if self._check is not None:
            sync = SyncMonitor(self._policy.n_ahead, _FIRST_PERIOD)
        return _Look(drive, sync)

    def add(self, recorded: RecordedFrame) -> list[AlignedFrame]:
        """Align the next frame; returns the frames that need not wait any longer: without
        `AlignerPolicy.n_ahead`, this frame.

        Raises RigError once left and right are known to be swapped.
        """
        self.use_estimates()
        frame = self._calibration.rectified(recorded)
        ready = [frame] if self._sync is None else self._sync.add(frame)
        return [self._aligned(one, recorded if one is frame else None) for one in ready]

    def frames(self, recorded: Iterable[RecordedFrame]) -> Iterator[Frame]:
        """All frames of a recording whose first ones were read ahead."""
        for one in recorded:
            yield from (aligned.frame for aligned in self.add(one))
        if self._sync is not None:
            for frame in self._sync.flush():
                yield self._aligned(frame, None).frame

    def _aligned(self, frame: Frame, recorded: RecordedFrame | None) -> AlignedFrame:
        """A simultaneous frame after its check, with its alignment."""
        calibration, has_stereo = self._calibration, self._has_stereo
        if self._check is not None:
            has_stereo = self._checked(self._check, frame)
        self._sample, state = None, self._state
        has_pair = self._finding is None or self._finding.has_stereo
        is_due = frame.time_s - self._sampled_s >= MIN_STEP_S
        # without a recorded frame, the right image is that of another one
        if isinstance(state, BackgroundObject) and has_pair and is_due and recorded is not None:
            self._sample, self._sampled_s = _Sample(frame, recorded, state), frame.time_s
        alignment = self._calibration.alignment
        aligned = replace(
            frame,
            right=frame.right if has_stereo else None,
            alignment=None if alignment is None else alignment.of_frames,
        )
        return AlignedFrame(aligned, calibration, self._finding)

    def _checked(self, check: PairMonitor, frame: Frame) -> bool:
        """Whether the right image of a frame is used, after the check of the frame.

        Not before the pair is explained, unless the alignment is given and the first pair looks
        right, and not in the frame that shows an error which is corrected from then on.
        """
        finding = check.add(frame)
        if finding is None:
            is_first = frame.index == 0 and self._finding is None
            if is_first and self._given is not None and not self._policy.reads_ahead:
                self._has_stereo = check.fits(frame)
            return self._has_stereo
        if self._policy.reads_ahead:
            finding = finding.uncorrected(LATER)
        elif self._given is not None:
            finding = finding.uncorrected()
        self._finding, self._has_stereo = finding, finding.has_stereo
        if not finding.has_stereo:
            self._state = None
        elif not self._policy.reads_ahead and finding.fault in ("verged", "turned"):
            self._repair(finding)
            return False
        return self._has_stereo

    def _repair(self, finding: PairFinding) -> None:
        """Correct the error of a pair from the next frame on."""
        if finding.fault == "turned":
            self._turn()
        if self._given is None:
            self._correct(finding.prior)
            self._state = self._estimates(finding.prior)
        else:
            self._calibration = self._plain.with_alignment(self._given)

    def _turn(self) -> None:
        """Turn both images back."""
        self._plain = self._unaligned = self._plain.turned()

    def _correct(self, prior: Alignment) -> None:
        """Correct the next frames by `prior` until they have an estimate, which starts from it."""
        corrected = PairAlignment(measured=prior, is_applied=True, rig=self._rig)
        self._unaligned = self._calibration = self._plain.with_alignment(corrected)

    def _estimates(self, prior: Alignment | None = None) -> BackgroundObject[AlignmentEstimates]:
        after_s = self._policy.estimates_s
        return self._background.create(AlignmentEstimates, self._rig, after_s, prior)

    def estimate(self) -> None:
        """Use the frame that was returned last to estimate the alignment of the next frames, in the
        background.
        """
        sample, self._sample = self._sample, None
        is_checked = self._check is None or self._finding is not None
        n_allowed = _MAX_PENDING if is_checked else _MAX_PENDING_BEFORE
        if sample is None or len(self._pending) >= n_allowed:
            return
        unaligned = sample.aligned
        if self._calibration.rectifier is not self._unaligned.rectifier:
            unaligned = self._unaligned.rectified(sample.recorded)
        estimate = sample.estimates.call(AlignmentEstimates.add, unaligned)
        self._pending.append(_Pending(sample.estimates, estimate))

    def use_estimates(self) -> None:
        """Align the next frames by the estimates that are ready."""
        while self._pending and self._background.is_ready(self._pending[0].estimate):
            pending = self._pending.popleft()
            estimate = pending.estimate.result()
            # others are of images that have been turned or corrected since then
            if estimate is not None and pending.estimates is self._state:
                self._apply(estimate)

    def _apply(self, estimate: PairEstimate) -> None:
        """Use an estimate; one that measured nothing only if it shows that less is known."""
        measured, before = estimate.alignment.measured, self._calibration.alignment
        now = self._rig.unaligned if before is None else before.of_frames
        if not measured.is_measured and measured.residual_px <= now.residual_px:
            return
        self._calibration = self._plain.with_alignment(estimate.alignment)
        if estimate.is_last:
            self._state = None

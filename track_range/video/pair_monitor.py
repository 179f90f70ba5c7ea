"""What is looked at while pairs pass: are left and right swapped, do their rows agree, are they of one instant?"""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Generator, Iterable, Iterator
from contextlib import closing

from track_range.foundation.arrays import Image
from track_range.stereo.alignment.swap_check import PairCheck, check_pair
from track_range.stereo.alignment.sync_check import Step, check_step
from track_range.stereo.geometry.frames import Frame, whole_image
from track_range.stereo.geometry.rig import RigError

MAX_CHECKED_PAIRS = 10
"""So many pairs are looked at until one shows enough to tell left from right."""

_MAX_ROW_OFFSET_PX = 1.5
"""A larger offset is told; features lie on whole pixels, so a single pair does not tell a smaller one."""

_UNMATCHED = (
    f"In the first {MAX_CHECKED_PAIRS} pairs left and right share too few points in equal rows to check the rig by: "
    "do the two videos and the rig belong together?"
)

_STEP_EVERY = 5
"""In every fifth frame the eyes' step is looked at, until three looks agree or twelve have been taken."""

_MAX_STEP_LOOKS = 12
_ENOUGH_STEPS = 3


def checked_pair(frame: Frame) -> PairCheck | None:
    """What the pair's features say; None without a right image.

    Raises:
        RigError: left and right are swapped.
    """
    if frame.right is None:
        return None
    check = check_pair(frame.left, whole_image(frame.right))
    if check.is_swapped:
        raise RigError(
            f"left and right are swapped: {100 * check.negative_share:.0f} % of {check.n_matches} matched points "
            "lie further right in the right image; hand the videos over the other way round."
        )
    return check


def order_checked(frames: Iterable[Frame]) -> Iterator[Frame]:
    """The same frames; the first ones are looked at until one tells left from right.

    Raises:
        RigError: left and right are swapped.
    """
    n_looks_left = MAX_CHECKED_PAIRS
    for frame in frames:
        if n_looks_left > 0:
            check = checked_pair(frame)
            n_looks_left = 0 if check is not None and check.is_conclusive else n_looks_left - 1
        yield frame


class PairWatch:
    """Looks at frames as they pass, in the thread that reads them.

    Attributes:
        notes: what the user should know so far.
    """

    def __init__(self) -> None:
        self.notes: tuple[str, ...] = ()
        self._is_settled = False
        self._steps = _StepWatch()

    def watched(self, frames: Generator[Frame, None, None]) -> Generator[Frame, None, None]:
        """The same frames.

        Raises:
            RigError: left and right are swapped.
        """
        with closing(frames):
            for number, frame in enumerate(frames):
                if not self._is_settled and number <= MAX_CHECKED_PAIRS:
                    self._look(frame, number)
                self.notes += self._steps.notes_on(frame)
                yield frame

    def _look(self, frame: Frame, number: int) -> None:
        if number == MAX_CHECKED_PAIRS:
            self.notes += (_UNMATCHED,)
            return
        check = checked_pair(frame)
        if check is None or not check.is_conclusive:
            return
        self._is_settled = True
        if abs(check.row_offset_px) > _MAX_ROW_OFFSET_PX:
            self.notes += (
                f"Rows of left and right are {check.row_offset_px:+.1f} px apart: the rig does not fit these videos "
                "well, and stereo distances will suffer; calibrate anew.",
            )


class _StepWatch:
    """Finds that one eye is a frame late, once the vehicle moves."""

    def __init__(self) -> None:
        self._last: deque[Frame] = deque(maxlen=3)
        self._votes: Counter[Step] = Counter()
        self._n_seen = self._n_looks = 0

    def notes_on(self, frame: Frame) -> tuple[str, ...]:
        """The note, with the frame that settles it."""
        self._n_seen += 1
        if self._n_looks == _MAX_STEP_LOOKS or self._is_settled:
            self._last.clear()
            return ()
        self._last.append(frame)
        if len(self._last) < 3 or self._n_seen % _STEP_EVERY:
            return ()
        self._look()
        return _step_notes(self._votes) if self._is_settled else ()

    @property
    def _is_settled(self) -> bool:
        return bool(self._votes) and max(self._votes.values()) >= _ENOUGH_STEPS

    def _look(self) -> None:
        self._n_looks += 1
        rights: list[Image] = [whole_image(frame.right) for frame in self._last if frame.right is not None]
        if len(rights) < 3:
            return
        step = check_step(self._last[1].left, rights)
        if step != "unknown":
            self._votes[step] += 1


def _step_notes(votes: Counter[Step]) -> tuple[str, ...]:
    """What to do where the eyes are out of step."""
    step = votes.most_common(1)[0][0]
    if step == "same":
        return ()
    late = "right" if step == "right late" else "left"
    return (
        f"Left and right are out of step: the {late} video is a frame late, by the rows of matched points while the "
        f"vehicle moves, so stereo distances are wrong; cut the first frame off the {late} video.",
    )

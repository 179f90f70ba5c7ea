"""Order and times of the files of one recording, which dashcams cut every few minutes.

time stamps that continue from file to file (exact)  >  creation times of the headers, or times in the names (1 s)
>  the given order, or the natural order of the names (no gaps can be seen)

start of file i+1 = end of file i        unless the times of the headers or names show a gap or an overlap, or the first
                                         frames of file i+1 are the last ones of file i
"""

import itertools
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from track_range.foundation.files.input_files import counted
from track_range.recording.video.file_names import recording_key, recording_of_chapter
from track_range.recording.video.frame import VideoError
from track_range.recording.video.utc import STAMP_RESOLUTION_S, Stamp, UtcStart, start_of

# gap that times with a resolution of 1 s prove, with the error of durations
_TOLERANCE_S = 1.5 * STAMP_RESOLUTION_S
_NOTED_GAP_S = 0.25  # smallest gap between two files, s, that is reported
_CONTINUOUS_S = 1.0  # largest overlap, s, of two files with continuing time stamps
# largest difference between the durations of left and right with different cuts
_EQUAL_DURATION_S = 1.0
# largest difference, s, between the start times of the left and right file of a pair
_PARTNER_S = 2.0


@dataclass(frozen=True, slots=True)
class SegmentFacts:
    """Properties of one file that determine its place in the recording."""

    path: Path
    first_s: float  # time stamp of the first frame
    duration_s: float  # as the header states it, or by the packets
    in_header: Stamp | None  # date and time in the header; None = none
    in_name: Stamp | None  # the same in the name


# files with the dates of their starts, sorted by them
_Dated = list[tuple[SegmentFacts, Stamp]]
# overlap of a file and the next one in s; 0 = none
Repeated = Callable[[SegmentFacts, SegmentFacts], float]


@dataclass(frozen=True, slots=True)
class SegmentPlan:
    """Files in the order of time."""

    facts: tuple[SegmentFacts, ...]
    # times of their first frames; the first file has the time of its time stamps
    starts_s: tuple[float, ...]
    clock_s: tuple[float, ...] = ()  # the same as seconds since 1970; empty = unknown
    utc: UtcStart | None = None  # UTC of the first frame; None = unknown
    notes: tuple[str, ...] = ()


def arranged(
    files: Sequence[SegmentFacts],
    *,
    is_given_order: bool,
    repeated_s: Repeated = lambda _before, _after: 0.0,
) -> SegmentPlan:
    """The files, at least one, in the order of time; raises VideoError for files of several
    cameras.

    An order that the user chose (`is_given_order`) is used if no times are known. `repeated_s` is
    the overlap from the content, used where times with a resolution of 1 s leave it open.
    """
    _check_one_camera([file.path for file in files])
    by_name = _chapters(sorted(files, key=lambda file: recording_key(file.path.name)))
    place = {file.path: file for file in by_name}
    files = [place[file.path] for file in files]
    clock, notes = _clock(by_name)
    continuing = _continuing(by_name)
    if continuing is not None and clock is not None and [file for file, _ in clock] != continuing:
        continuing = None
        notes.append(
            f"{_first_name(by_name)}: the time stamps in the files contradict the dates of the "
            "files, which are used."
        )
    if continuing is not None:
        plan, gaps_s = _by_time_stamps(continuing)
    elif clock is None:
        order = "given order" if is_given_order else "order of their names"
        notes.append(
            f"{counted(len(files), 'file')} without usable dates are joined in the {order}, "
            "without gaps between them."
        )
        plan, gaps_s = _joined(list(files) if is_given_order else by_name, repeated_s)
    else:
        plan, gaps_s = _by_dates(clock, repeated_s)
        if is_given_order and plan.facts != tuple(files):
            notes.append(
                f"{_first_name(files)}: the order of the given files differs from the order of "
                "their times, which is used."
            )
    return replace(plan, notes=(*notes, *_cut_notes(plan.facts, gaps_s)))


def _chapters(files: Sequence[SegmentFacts]) -> list[SegmentFacts]:
    """The files, in the order of their names, of which chapters with the date of their recording
    follow each other.
    """
    chapters: list[SegmentFacts] = []
    ends_s: dict[tuple[str, Stamp], float] = {}
    for file in files:
        number, stamp = recording_of_chapter(file.path.name), file.in_header
        dated = file
        if number is not None and stamp is not None:
            start_s = ends_s.get((number, stamp), stamp.time_s)
            ends_s[number, stamp] = start_s + file.duration_s
            dated = replace(file, in_header=replace(stamp, time_s=start_s))
        chapters.append(dated)
    return chapters


def _by_time_stamps(ordered: Sequence[SegmentFacts]) -> tuple[SegmentPlan, Sequence[float]]:
    """Files whose time stamps continue from file to file, and the gaps after them, s."""
    first, pairs = ordered[0], itertools.pairwise(ordered)
    gaps_s = [after.first_s - before.first_s - before.duration_s for before, after in pairs]
    utc = start_of(first.in_header, first.in_name, first.duration_s)
    return SegmentPlan(tuple(ordered), tuple(file.first_s for file in ordered), utc=utc), gaps_s


def _joined(
    ordered: Sequence[SegmentFacts], repeated_s: Repeated
) -> tuple[SegmentPlan, Sequence[float]]:
    """Files without times, each of which follows the one before, and the gaps after them, s."""
    first = ordered[0]
    gaps_s = [-repeated_s(one, other) for one, other in itertools.pairwise(ordered)]
    steps_s = (file.duration_s + gap_s for file, gap_s in zip(ordered, gaps_s, strict=False))
    starts_s = tuple(itertools.accumulate(steps_s, initial=first.first_s))
    # equal dates come from a copy or an editor, after the recording
    utc = start_of(first.in_header, first.in_name, sum(file.duration_s for file in ordered))
    return SegmentPlan(tuple(ordered), starts_s, utc=utc), gaps_s


def _by_dates(clock: _Dated, repeated_s: Repeated) -> tuple[SegmentPlan, Sequence[float]]:
    """Files in the order of their dates, and the gaps after them, s."""
    ordered = [file for file, _ in clock]
    stamps_s = tuple(stamp.time_s for _, stamp in clock)
    starts_s, gaps_s = _dated_starts_s(ordered, stamps_s, repeated_s)
    stamp, named = clock[0][1], ordered[0].in_name
    utc = start_of(None if stamp is named else stamp, named, ordered[0].duration_s)
    return SegmentPlan(tuple(ordered), starts_s, stamps_s, utc), gaps_s


def paired_starts_s(plan: SegmentPlan, left: SegmentPlan) -> tuple[float, ...]:
    """Start times of the right files of a pair on the time axis of the left files.

    Files of a pair that start within 2 s are assumed to start together, since their dates have a
    resolution of 1 s. Raises VideoError if the files have no dates, and one side lacks files of the
    other side.
    """
    has_equal_clocks = (
        plan.utc is not None and left.utc is not None and plan.utc.is_local == left.utc.is_local
    )
    if plan.clock_s and left.clock_s and has_equal_clocks:
        return _starts_by_clock_s(plan, left)
    continues = _continuing(plan.facts) is not None
    if len(plan.facts) == len(left.facts):
        if continues:
            return plan.starts_s
        firsts_s = zip(plan.facts, left.facts, left.starts_s, strict=True)
        return tuple(start_s + file.first_s - other.first_s for file, other, start_s in firsts_s)
    if not continues or _continuing(left.facts) is None:
        _check_equal_durations(plan, left)
    return plan.starts_s


def _starts_by_clock_s(plan: SegmentPlan, left: SegmentPlan) -> tuple[float, ...]:
    """Starts of the files by the dates of both sides."""
    starts_s = []
    for file, clock_s in zip(plan.facts, plan.clock_s, strict=True):
        distances_s = [abs(left_s - clock_s) for left_s in left.clock_s]
        nearest = distances_s.index(min(distances_s))
        later_s = clock_s - left.clock_s[nearest]
        if abs(later_s) <= _PARTNER_S:  # they start together, but for their time stamps
            is_stamped = abs(file.first_s) < _PARTNER_S
            later_s = file.first_s - left.facts[nearest].first_s if is_stamped else 0.0
        starts_s.append(left.starts_s[nearest] + later_s)
    return tuple(starts_s)


def _check_equal_durations(plan: SegmentPlan, left: SegmentPlan) -> None:
    """VideoError: one side lacks a file."""
    durations_s = [sum(file.duration_s for file in side.facts) for side in (left, plan)]
    shortest_s = min(file.duration_s for side in (left, plan) for file in side.facts)
    if abs(durations_s[0] - durations_s[1]) > min(_EQUAL_DURATION_S, shortest_s / 2):
        raise VideoError(
            f"{plan.facts[0].path.parent}: expected {counted(len(left.facts), 'file')} as in "
            f"{left.facts[0].path.parent}, found {len(plan.facts)}, and not all have dates in "
            "their names or headers; give the files that belong together, as in --stereo L1 R1 "
            "--stereo L2 R2."
        )


def _dated_starts_s(
    files: Sequence[SegmentFacts], stamps_s: Sequence[float], repeated_s: Repeated
) -> tuple[tuple[float, ...], list[float]]:
    """Start times of dated files, and gaps after them, which exist only where dates or equal frames
    prove a jump.
    """
    starts_s, gaps_s = [files[0].first_s], list[float]()
    for number, (before, after) in enumerate(itertools.pairwise(files)):
        end_s = starts_s[-1] + before.duration_s
        dated_s = files[0].first_s + stamps_s[number + 1] - stamps_s[0]
        missing_s = stamps_s[number + 1] - stamps_s[number] - before.duration_s
        if missing_s < -_TOLERANCE_S:
            if -missing_s > min(before.duration_s, after.duration_s) / 2:
                raise _several_cameras(before.path, after.path)
            gap_s = -repeated_s(before, after) or missing_s
        elif missing_s <= _TOLERANCE_S and (overlap_s := repeated_s(before, after)):
            gap_s = -overlap_s
        elif dated_s - end_s > _TOLERANCE_S:
            gap_s = dated_s - end_s
        else:
            gap_s = max(0.0, dated_s - STAMP_RESOLUTION_S - end_s)
        starts_s.append(end_s + gap_s)
        gaps_s.append(gap_s)
    return tuple(starts_s), gaps_s


def _cut_notes(files: Sequence[SegmentFacts], gaps_s: Sequence[float]) -> list[str]:
    named = [(gap_s, file.path.name) for gap_s, file in zip(gaps_s, files, strict=False)]
    gaps = [(gap_s, name) for gap_s, name in named if gap_s >= _NOTED_GAP_S]
    overlaps = [(-gap_s, name) for gap_s, name in named if gap_s <= -_NOTED_GAP_S]
    notes = []
    if gaps:
        longest_s, name = max(gaps)
        notes.append(
            f"{counted(len(gaps), 'gap')} between the files, {sum(gap_s for gap_s, _ in gaps):.1f} "
            f"s in all, the longest {longest_s:.1f} s after {name}: nothing was recorded there."
        )
    if overlaps:
        longest_s, name = max(overlaps)
        notes.append(
            f"{counted(len(overlaps), 'overlap')} between the files, the longest {longest_s:.1f} s "
            f"after {name}: frames that were recorded twice are skipped."
        )
    return notes


def _continuing(files: Sequence[SegmentFacts]) -> list[SegmentFacts] | None:
    """The files by their time stamps if these continue from file to file; None = they start again
    in every file.
    """
    ordered = sorted(files, key=lambda file: file.first_s)
    is_continuing = all(
        after.first_s
        >= before.first_s + before.duration_s - min(_CONTINUOUS_S, before.duration_s / 2)
        and after.first_s > before.first_s
        for before, after in itertools.pairwise(ordered)
    )
    return ordered if is_continuing else None


def _clock(files: Sequence[SegmentFacts]) -> tuple[_Dated | None, list[str]]:
    """The files with their dates (None = not all have different dates), and notes."""
    headers, names = _header_starts(files), _dated(files, [file.in_name for file in files])
    if headers is None or names is None:
        return headers or names, []
    if [file for file, _ in headers] == [file for file, _ in names]:
        return (
            headers
            if _overlap_s(headers) <= _overlap_s(names) + _TOLERANCE_S * len(files)
            else names
        ), []
    is_by_header = _overlap_s(headers) <= _overlap_s(names)
    note = (
        f"{_first_name(files)}: the creation times in the headers contradict the times in the "
        f"names of the files; the times in the {'headers' if is_by_header else 'names'} are used, "
        "since the files then overlap less."
    )
    return (headers if is_by_header else names), [note]


def _header_starts(files: Sequence[SegmentFacts]) -> _Dated | None:
    """The files with the creation times of their headers; times of the ends are converted to times
    of the starts.
    """
    stamps = [file.in_header for file in files]
    dated = _dated(files, stamps)
    if dated is None or dated[0][1].is_start:
        return dated
    as_starts = [
        Stamp(stamp.time_s - file.duration_s, stamp.source)
        for file, stamp in zip(files, stamps, strict=True)
        if stamp
    ]
    by_end = _dated(files, as_starts)
    is_end = by_end is not None and _overlap_s(dated) > _TOLERANCE_S >= _overlap_s(by_end)
    return by_end if is_end else dated


def _dated(files: Sequence[SegmentFacts], stamps: Sequence[Stamp | None]) -> _Dated | None:
    """The files with the given dates, sorted by date; None = a date is missing, or two are
    equal.
    """
    dated = [(file, stamp) for file, stamp in zip(files, stamps, strict=True) if stamp is not None]
    is_usable = len(dated) == len(files) == len({stamp.time_s for _, stamp in dated})
    return sorted(dated, key=lambda item: item[1].time_s) if is_usable else None


def _overlap_s(dated: _Dated) -> float:
    """Sum of the overlaps of consecutive files beyond the tolerance, s."""
    return sum(
        max(0.0, before[0].duration_s - (after[1].time_s - before[1].time_s) - _TOLERANCE_S)
        for before, after in itertools.pairwise(dated)
    )


def _check_one_camera(paths: Sequence[Path]) -> None:
    """Check that no two names have equal numbers and different words, as in 20260131_142530_F.mp4
    and _R.mp4.
    """
    by_number: dict[tuple[str, ...], Path] = {}
    for path in paths:
        numbers = tuple(re.findall(r"\d+", path.stem))
        other = by_number.setdefault(numbers, path)
        if numbers and other.stem != path.stem:
            raise _several_cameras(other, path)


def _several_cameras(one: Path, other: Path) -> VideoError:
    """The error with a pattern for the camera of `one`: the end of its name if the ends differ,
    else the beginning.
    """
    ends = [re.split(r"\d", path.stem)[-1] for path in (one, other)]
    if ends[0] != ends[1]:
        pattern = f"*{ends[0]}{one.suffix}"
    else:
        n_common = next(
            (n for n, (a, b) in enumerate(zip(one.name, other.name, strict=False)) if a != b), 0
        )
        word = re.match(r"[A-Za-z0-9]*", one.name[n_common:])
        pattern = f"{one.name[:n_common]}{word.group() if word else ''}*"
    return VideoError(
        f"{one.parent}: expected the files of one camera, found {one.name} and {other.name}, which "
        f"were recorded at the same time; select one camera, as in --mono '{one.parent / pattern}'."
    )


def _first_name(files: Sequence[SegmentFacts]) -> str:
    return f"{files[0].path.name} and {counted(len(files) - 1, 'other file')}"

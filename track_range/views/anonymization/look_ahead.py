"""Stage of a run that anonymizes the images of its results before they are shown or written.

    pipeline -> results, held back -> regions from earlier and later frames -> blurred image -> overlay, writers

A region does not flicker: boxes that a track lacks are interpolated between the detections before and after, and
extrapolated to the frames before its first and after its last box. Detections that are not part of a track, including
low scores, are covered in their frame and its neighbours.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Generator, Iterable, Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from track_range.detection.boxes import iou
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray
from track_range.pipeline.frame_result import FrameResult
from track_range.views.anonymization.blur import blurred
from track_range.views.anonymization.regions import Boxes, Regions, regions_of

# time for which a track is extrapolated after its last box, and after which boxes are forgotten
PAST_S = 0.5
# growth of the uncertainty of a box with the time to the nearest detection, of its smaller side
GROWTH_PER_S = 0.6
SPEED_FRACTION = 0.5  # uncertainty of the speed of an extrapolated box, as a fraction of its speed
SPEED_TIME_S = 0.35  # longest time over which the speed of a box is measured
NEIGHBOUR_S = 0.15  # longest time by which detections without a track are covered earlier and later
# of boxes of one object in neighbouring frames; of boxes with nearly equal regions
SAME_IOU, EQUAL_IOU = 0.3, 0.9


@dataclass(frozen=True, slots=True, kw_only=True)
class LookAhead:
    """Time for which results are held back, so that later frames can be used."""

    time_s: float  # longest time; 0 = only the past is used
    max_frames: int  # largest number of results held back, which limits the memory


OFFLINE = LookAhead(time_s=0.5, max_frames=16)  # look-ahead for files
LIVE = LookAhead(time_s=0.0, max_frames=0)  # look-ahead for cameras and streams: none


def anonymized_results(
    results: Iterable[FrameResult], look_ahead: LookAhead
) -> Generator[FrameResult, None, None]:
    """Results in order with `frame.left` anonymized, and without `frame.right` and `candidates`.

    The regions come from the tracks, and from `candidates` where there are any. If `results`
    raises, results that are held back are returned before the error.
    """
    rng = np.random.default_rng()  # seeded by the operating system
    for result, regions in with_regions(results, look_ahead):
        image = blurred(result.frame.left, regions, rng)
        image.flags.writeable = False
        yield replace(
            result, frame=replace(result.frame, left=image, recorded=None), candidates=None
        )


def with_regions(
    results: Iterable[FrameResult], look_ahead: LookAhead
) -> Iterator[tuple[FrameResult, Regions]]:
    """Results in order, without the right images, held back for the look-ahead, with the regions to
    cover.
    """
    held: deque[FrameResult] = deque()
    history = _History()

    def first_held() -> tuple[FrameResult, Regions]:
        result = held.popleft()
        history.forget_before(result.time_s - PAST_S)
        return result, regions_of(history.boxes_at(result.time_s))

    error: BaseException | None = None
    try:
        for result in results:
            history.add(result)
            frame = replace(result.frame, right=None, recorded=None)  # whose memory is not needed
            held.append(replace(result, frame=frame))
            while held and (
                len(held) > look_ahead.max_frames
                or result.time_s - held[0].time_s >= look_ahead.time_s
            ):
                yield first_held()
    # every error is raised after the results before it
    except (Exception, KeyboardInterrupt) as raised:
        error = raised
    while held:
        yield first_held()
    if error is not None:
        raise error


class _Box(NamedTuple):
    time_s: float
    xyxy_px: FloatArray
    class_id: int
    is_observed: bool


@dataclass(slots=True)
class _History:
    tracks: dict[int, deque[_Box]] = field(default_factory=dict)  # by track id, in order of time
    # time, detections without identity
    candidates: deque[tuple[float, Detections]] = field(default_factory=deque)

    def add(self, result: FrameResult) -> None:
        tracks, time_s = result.tracks, result.time_s
        for row, track_id in enumerate(tracks.track_id.tolist()):
            box = _Box(
                time_s, tracks.xyxy_px[row], int(tracks.class_id[row]), bool(tracks.observed[row])
            )
            self.tracks.setdefault(track_id, deque()).append(box)
        if result.candidates is not None:
            self.candidates.append((time_s, result.candidates))

    def forget_before(self, time_s: float) -> None:
        while self.candidates and self.candidates[0][0] < time_s:
            self.candidates.popleft()
        for track_id, boxes in list(self.tracks.items()):
            while boxes and boxes[0].time_s < time_s:
                boxes.popleft()
            if not boxes:
                del self.tracks[track_id]

    def boxes_at(self, time_s: float) -> Boxes:
        rows = [row for boxes in self.tracks.values() for row in _track_boxes(boxes, time_s)]
        boxes = Boxes(
            np.array([box for box, _, _ in rows], np.float64).reshape(-1, 4),
            np.array([class_id for _, class_id, _ in rows], np.int64),
            np.array([margin_px for _, _, margin_px in rows], np.float64),
        )
        near = [(abs(at_s - time_s), candidates) for at_s, candidates in self.candidates]
        for after_s, candidates in sorted(near, key=lambda item: item[0]):
            if after_s > NEIGHBOUR_S:
                break
            overlap = iou(candidates.xyxy_px, boxes.xyxy_px) >= (
                SAME_IOU if after_s > 0 else EQUAL_IOU
            )
            is_covered = ((candidates.class_id[:, None] == boxes.class_id) & overlap).any(axis=1)
            new = candidates.select(~is_covered)
            margin_px = GROWTH_PER_S * after_s * _sides_px(new.xyxy_px)
            boxes = Boxes(
                np.concatenate([boxes.xyxy_px, new.xyxy_px]),
                np.concatenate([boxes.class_id, new.class_id]),
                np.concatenate([boxes.margin_px, margin_px]),
            )
        return boxes


def _track_boxes(boxes: Sequence[_Box], time_s: float) -> Iterator[tuple[FloatArray, int, float]]:
    """Box, class and uncertainty in px of a track in the frame at a time: none, one, or two (one
    predicted).
    """
    now = next((box for box in boxes if box.time_s == time_s), None)
    if now is not None and now.is_observed:
        yield now.xyxy_px, now.class_id, 0.0
        return
    before = [box for box in boxes if box.time_s < time_s and box.is_observed]
    after = [box for box in boxes if box.time_s > time_s and box.is_observed]
    nearest_s = min(
        [abs(box.time_s - time_s) for box in (*before[-1:], *after[:1])], default=PAST_S
    )

    def margin_px(xyxy_px: FloatArray) -> float:
        return GROWTH_PER_S * nearest_s * float(_sides_px(xyxy_px[None])[0])

    if now is not None:
        yield now.xyxy_px, now.class_id, margin_px(now.xyxy_px)
    if before and after:
        start, end = before[-1], after[0]
        fraction = (time_s - start.time_s) / (end.time_s - start.time_s)
        box = (1 - fraction) * start.xyxy_px + fraction * end.xyxy_px
        yield box, start.class_id, margin_px(box)
    elif before or after:
        nearest = before[-1] if before else after[0]
        moved = (time_s - nearest.time_s) * _speed(before if before else after[::-1])
        growth_px = SPEED_FRACTION * float(np.abs(moved).max())
        yield nearest.xyxy_px + moved, nearest.class_id, margin_px(nearest.xyxy_px) + growth_px


def _speed(boxes: Sequence[_Box]) -> FloatArray:
    """(4,) speed of the edges in px/s at the last of the given boxes, which are in order of time or
    reversed.
    """
    last = boxes[-1]
    first = next(box for box in boxes if abs(box.time_s - last.time_s) <= SPEED_TIME_S)
    span_s = last.time_s - first.time_s
    return np.zeros(4) if span_s == 0 else (last.xyxy_px - first.xyxy_px) / span_s


def _sides_px(xyxy_px: FloatArray) -> FloatArray:
    """(N,) smaller sides of boxes (N, 4)."""
    return np.asarray((xyxy_px[:, 2:] - xyxy_px[:, :2]).min(axis=1, initial=np.inf))

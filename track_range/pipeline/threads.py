r"""Results of many frames, with reading, inference and the rest of the pipeline in overlapping threads.

reading thread --> detection thread -> lanes thread -> caller's thread ----> FrameResult
decode,            network, boxes      lane lines      FramePipeline.step
network's input \---> background work of rangers ------/
"""

from collections.abc import Generator, Iterable, Iterator
from contextlib import ExitStack, closing
from dataclasses import dataclass
from threading import Semaphore
from typing import TypeVar

from track_range.foundation.prefetch import prefetch
from track_range.pipeline.detecting import Detected, Prepared
from track_range.pipeline.frame_pipeline import FramePipeline
from track_range.pipeline.frame_result import FrameResult
from track_range.stereo.geometry.frames import Frame

_T = TypeVar("_T")
_UNLIMITED = 1000  # number of frames that are never in progress


@dataclass(frozen=True, slots=True)
class QueueDepths:
    """Number of frames by which each thread may run ahead of the next thread."""

    read: int = 4  # frames in the network's input that wait for the network
    detected: int = 2  # frames with boxes that wait for the lane detector, or the caller
    lanes: int = 2  # frames with lane lines that wait for the caller
    in_progress: int = _UNLIMITED  # frames between reading and their result


# For cameras, to reduce latency: one frame is with the network, and one with the caller or on its
# way to the network.
LIVE_DEPTHS = QueueDepths(read=1, detected=1, lanes=1, in_progress=2)


def run_in_threads(
    pipeline: FramePipeline, frames: Iterable[Frame], depths: QueueDepths | None = None
) -> Generator[FrameResult, None, None]:
    """Results of the frames in order; closing the generator ends the threads and the pipeline."""
    depths = depths or QueueDepths()
    slots = Semaphore(depths.in_progress)
    frames = _admitted(frames, slots)
    with ExitStack() as stack:
        # closed in reverse order: the last thread first, so that no thread reads from a closed
        # video; rangers last
        stack.callback(pipeline.close)

        def in_thread(
            items: Iterable[_T], depth: int, name: str, *, low_priority: bool
        ) -> Iterable[_T]:
            thread = prefetch(items, depth=depth, low_priority=low_priority, name=name)
            return stack.enter_context(closing(thread))

        prepared = in_thread(_prepared(pipeline, frames), depths.read, "read", low_priority=True)
        results = in_thread(
            _detected(pipeline, prepared), depths.detected, "detect", low_priority=False
        )
        if pipeline.detection.lane_finder is not None:
            lines = _with_lanes(pipeline, results)
            results = in_thread(lines, depths.lanes, "lanes", low_priority=False)
        # first at the end, so that no thread waits for a slot
        stack.callback(slots.release, _UNLIMITED)
        for detected in results:
            result = pipeline.step(detected)
            slots.release()
            yield result


def _admitted(frames: Iterable[Frame], slots: Semaphore) -> Iterator[Frame]:
    """The frames, each of which is read when a slot is free."""
    slots.acquire()
    for frame in frames:
        yield frame
        slots.acquire()


def _prepared(pipeline: FramePipeline, frames: Iterable[Frame]) -> Iterator[Prepared]:
    for frame in frames:
        yield pipeline.detection.prepared(frame, pipeline.clock)


def _detected(pipeline: FramePipeline, frames: Iterable[Prepared]) -> Iterator[Detected]:
    """Frames with their boxes; rangers that work in the background are started before the
    detector.
    """
    for prepared in frames:
        pipeline.ranging.start(prepared.frame)
        yield pipeline.detection.detected(prepared, pipeline.clock)


def _with_lanes(pipeline: FramePipeline, frames: Iterable[Detected]) -> Iterator[Detected]:
    for detected in frames:
        yield pipeline.detection.with_lanes(detected, pipeline.clock)

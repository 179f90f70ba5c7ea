"""Processing of the frames of a run: in threads, at the pace of a camera if requested."""

from collections.abc import Generator
from contextlib import ExitStack, closing, contextmanager

from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.threads import LIVE_DEPTHS, run_in_threads
from track_range.pipeline.throughput import PacedFrames
from track_range.recording.recording import Recording
from track_range.run.opening import OpenedRun
from track_range.run.options.settings import RunSettings


def paced_frames(settings: RunSettings, recording: Recording) -> PacedFrames | None:
    """The frames at the pace of a camera, if the settings ask for it."""
    if not settings.realtime or recording.live is not None:
        return None
    return PacedFrames(recording.frames, 1 / recording.fps)


@contextmanager
def processed_results(
    opened: OpenedRun, paced: PacedFrames | None
) -> Generator[Generator[FrameResult, None, None], None, None]:
    """Context with the results of all frames, anonymized if requested; its end stops the threads.

    `paced` are the frames of the recording at the pace of a camera, None = as fast as possible.
    """
    frames = opened.recording.frames
    is_live = opened.recording.live is not None or paced is not None
    depths = LIVE_DEPTHS if is_live else None
    with ExitStack() as stack:
        results = run_in_threads(opened.pipeline, frames if paced is None else iter(paced), depths)
        stack.enter_context(closing(results))
        if paced is not None:
            stack.callback(paced.stop)
        if not opened.settings.anonymize:
            yield results
            return
        from track_range.views.anonymization.look_ahead import LIVE, OFFLINE, anonymized_results

        with closing(anonymized_results(results, LIVE if is_live else OFFLINE)) as anonymized:
            yield anonymized

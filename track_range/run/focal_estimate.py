"""Focal length of a recording without a calibration, from the boxes in its first seconds, before the run."""

from __future__ import annotations

from dataclasses import replace

from track_range.calibration.road.from_road import focal_from_video
from track_range.foundation.progress import StepProgress, no_progress
from track_range.ranging.size_models.size_model import SizeModel
from track_range.recording.names import BagTopic
from track_range.recording.recording import Recording
from track_range.run.box_source import BoxSource
from track_range.run.settings import RunSettings


def with_focal_length(
    recording: Recording,
    settings: RunSettings,
    box_source: BoxSource,
    size_model: SizeModel,
    progress: StepProgress = no_progress,
) -> Recording:
    """The recording with an estimate of its focal length; unchanged if it is known, or the recording is live.

    Raises:
        VideoError: the video cannot be read.
    """
    guesses = recording.calibration.guesses
    if not guesses or recording.live is not None:
        return recording
    video = settings.left
    if settings.topics and not isinstance(video, BagTopic):
        return recording
    with progress("estimating the focal length") as advance:
        posterior = focal_from_video(
            video,
            guesses,
            box_source.detect,
            size_model,
            span_s=(settings.start_s, settings.duration_s),
            folder_fps=settings.folder_fps,
            advance=advance,
        )
    calibration = recording.calibration.with_focal_length(posterior.as_guess(guesses))
    return replace(recording, calibration=calibration)

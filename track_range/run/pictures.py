"""Pictures of a run, for its videos and the live view: overlay, overlay with disparities, disparities."""

from __future__ import annotations

from track_range.recording.recording import Recording
from track_range.run.settings import RunSettings
from track_range.views.overlay.annotator import Overlay, Status
from track_range.views.overlay.disparity_view import DisparityPicture, StackedPicture
from track_range.views.overlay.result_video import Draw, VideoFormat


def pictures(settings: RunSettings, source: Recording, status: Status = tuple) -> dict[str, Draw]:
    """Drawing functions of the videos of a run, by file name without suffix; `status`: see `Overlay`."""
    drawn: dict[str, Draw] = {}
    if settings.overlay:
        drawn["overlay"] = overlay_picture(settings, source, status)
    if settings.disparity and source.rig is not None:
        drawn["disparity"] = DisparityPicture(source.rig).draw
    return drawn


def missing_outputs(settings: RunSettings, source: Recording) -> tuple[str, ...]:
    """Messages about requested videos that are not possible because the recording has no rig."""
    lens = (
        ("--overlay-recorded: the calibration has no wide lens, so the overlay shows the rectified images.",)
        if settings.overlay_recorded and not source.calibration.has_wide_lens
        else ()
    )
    if source.rig is not None:
        return lens
    disparity = ("No disparity.mp4: dense stereo requires a calibrated pair.",) if settings.disparity else ()
    below = (
        ("No disparities below the overlay: dense stereo requires a calibrated pair.",)
        if settings.overlay_disparity
        else ()
    )
    return (*lens, *disparity, *below)


def overlay_picture(settings: RunSettings, source: Recording, status: Status = tuple) -> Draw:
    """Drawing function of a new overlay, with the disparities below it if requested and possible."""
    warning = "uncalibrated" if source.calibration.kind == "estimated" else ""
    recorded = source.calibration.recorded_view if settings.overlay_recorded else None
    overlay = Overlay(camera=source.camera, status=status, warning=warning, recorded=recorded)
    if settings.overlay_disparity and source.rig is not None:
        return StackedPicture(overlay, source.rig).draw
    return overlay.draw


def video_format(name: str, settings: RunSettings, source: Recording) -> VideoFormat:
    """Size and frame rate of one of `pictures`."""
    recorded = source.calibration.recorded_view if settings.overlay_recorded and name == "overlay" else None
    width_px, height_px = source.size_px if recorded is None else recorded.size_px
    is_double = name == "overlay" and settings.overlay_disparity and source.rig is not None
    return VideoFormat((width_px, 2 * height_px if is_double else height_px), source.fps)

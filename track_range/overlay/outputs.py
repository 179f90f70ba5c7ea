"""What a run shows: overlay, overlay beside disparities, disparities; filmed, or looked at while the run goes on."""

from __future__ import annotations

from track_range.overlay.annotator import Overlay, Status
from track_range.overlay.disparity_view import DisparityPicture, SidePicture
from track_range.overlay.result_video import Draw, VideoFormat
from track_range.run.settings import RunSettings
from track_range.video.recording import Recording


def pictures(settings: RunSettings, source: Recording, status: Status = tuple) -> dict[str, Draw]:
    """What is filmed, by the name of its file without the ending; `status`: see `Overlay`."""
    wanted: dict[str, Draw] = {}
    if settings.overlay:
        wanted["overlay"] = overlay_picture(settings, source, status)
    if settings.disparity and source.rig is not None:
        wanted["disparity"] = DisparityPicture(source.rig).draw
    return wanted


def missing_outputs(settings: RunSettings, source: Recording) -> tuple[str, ...]:
    """Sentences for the user on pictures that the settings ask for and a recording without a rig cannot give."""
    if source.rig is not None:
        return ()
    disparity = ("No disparity.mp4: dense stereo needs a rig.",) if settings.disparity else ()
    side = ("No disparities below the overlay: dense stereo needs a rig.",) if settings.overlay_disparity else ()
    return (*disparity, *side)


def overlay_picture(settings: RunSettings, source: Recording, status: Status = tuple) -> Draw:
    """A new overlay, with the disparities below it where the settings want them and the source has them."""
    warning = "uncalibrated" if source.calibration.kind == "estimated" else ""
    overlay = Overlay(camera=source.camera, status=status, warning=warning)
    if settings.overlay_disparity and source.rig is not None:
        return SidePicture(overlay, source.rig).draw
    return overlay.draw


def video_format(name: str, settings: RunSettings, source: Recording) -> VideoFormat:
    """Size and rate of one of `pictures`."""
    width_px, height_px = source.size_px
    is_double = name == "overlay" and settings.overlay_disparity and source.rig is not None
    return VideoFormat((width_px, 2 * height_px if is_double else height_px), source.fps)

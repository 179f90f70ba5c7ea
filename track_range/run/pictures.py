"""Pictures of a run, for its videos and the live view: overlay, overlay with disparities,
disparities.
"""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.recording.recording import Recording
from track_range.results.counts.counter import anchors_of
from track_range.results.counts.places import parsed_places
from track_range.run.build import road_plane_of
from track_range.run.options.settings import RunSettings
from track_range.views.overlay.annotator import DensePicture, Overlay, StackedPicture, Status
from track_range.views.overlay.counted_places import CountedPlaces
from track_range.views.videos.result_video import Draw


def pictures(
    settings: RunSettings, recording: Recording, status: Status
) -> dict[str, tuple[Draw, tuple[int, int]]]:
    """Drawing function and (width, height) of the videos of a run by their names; `status`: see
    `Overlay`.
    """
    drawn: dict[str, tuple[Draw, tuple[int, int]]] = {}
    size_px = recording.size_px
    if settings.overlay:
        recorded = recording.calibration.recorded_view if settings.overlay_recorded else None
        width_px, height_px = size_px if recorded is None else recorded.recorded_size_px
        height_px *= 2 if settings.overlay_disparity and has_dense_maps(settings, recording) else 1
        drawn["overlay"] = overlay_picture(settings, recording, status), (width_px, height_px)
    if settings.disparity and has_dense_maps(settings, recording):
        drawn["disparity"] = DensePicture().draw, size_px
    return drawn


def has_dense_maps(settings: RunSettings, recording: Recording) -> bool:
    """Whether a method measures all pixels: of a calibrated pair, or by a network of one camera."""
    return recording.calibrated_rig is not None or bool(settings.depth_model)


def overlay_picture(settings: RunSettings, recording: Recording, status: Status) -> Draw:
    """Drawing function of a new overlay, with the disparities below it if requested and
    possible.
    """
    warning = "uncalibrated" if recording.calibration.kind == "estimated" else ""
    recorded = recording.calibration.recorded_view if settings.overlay_recorded else None
    overlay = Overlay(
        camera=recording.camera,
        status=status,
        warning=warning,
        recorded=recorded,
        counted=_counted_places(settings, recording) if settings.static_camera else None,
        has_cuboids=settings.overlay_cuboids,
    )
    if settings.overlay_disparity and has_dense_maps(settings, recording):
        return StackedPicture(overlay).draw
    return overlay.draw


def _counted_places(settings: RunSettings, recording: Recording) -> CountedPlaces:
    """The lines and zones of a camera that stands still."""
    calibration, is_recorded = recording.calibration, settings.overlay_recorded
    rectifier = calibration.rectifier
    anchors = anchors_of(road_plane_of(settings, calibration), rectifier.recorded_points)

    def shown(xy_px: FloatArray) -> FloatArray:
        if is_recorded and calibration.recorded_view is not None:
            return xy_px
        return rectifier.left_boxes(np.concatenate([xy_px, xy_px], axis=1))[:, :2]

    return CountedPlaces(parsed_places(settings.count_line, settings.zone), anchors, shown)

"""The mounting of one camera as the first images of its recording show it, before a run."""

import math
from collections.abc import Callable
from contextlib import closing
from dataclasses import replace

from track_range.calibration.drive.drive_video import every_step
from track_range.recording.recording import Recording
from track_range.stereo.geometry.mounting import AHEAD_DEG, Mounting
from track_range.stereo.self_calibration.mounting_search import MIN_ASIDE_S, PAIR_S, MountingSearch

_REAR_DEG = 135.0  # angle from which a camera looks to the rear, or a direction is the opposite one
_SURE_SIGMAS = 3.0  # difference from which the images contradict a mounting
_SEARCHED_S = 30.0  # longest part of a recording in which its mounting is searched


def with_mounting(
    recording: Recording, given: Mounting | None, reopen: Callable[[], Recording]
) -> Recording:
    """The recording of one camera of unknown mounting with the one that its first images show, if
    it does not look along the drive; a note, if they contradict the mounting that is `given` or in
    its calibration. `reopen` opens the recording once more, from its start.
    """
    calibration, n_frames = recording.calibration, recording.n_frames
    known, view_deg = calibration.view_mounting(given), calibration.view.yaw_deg
    is_short = n_frames is not None and n_frames < MIN_ASIDE_S * recording.fps
    if is_short or recording.pair is not None or recording.live is not None:
        return recording
    shown = _shown_mounting(recording, reopen)
    if shown is None or (shown.is_ahead if known is None else not _contradicts(shown, known)):
        return recording
    apart_deg = shown.apart_deg(known or Mounting())
    cause = " (or the vehicle reverses)" if apart_deg > _REAR_DEG else ""
    doubt = ""
    if known is not None:
        doubt = (
            f" Its mounting, which is used, states {direction_text(known)}: check it, and its sign "
            "(yaw is positive to the left)."
        )
    yaw_deg = round(shown.turned(-view_deg).yaw_deg)
    note = (
        f"The motion of the images shows that the camera looks {direction_text(shown)}{cause}; "
        f"--mount yaw={180 if yaw_deg == -180 else yaw_deg} states it.{doubt}"
    )
    opened = recording.opened
    if known is None:
        opened = replace(opened, mounting=shown, mounting_source="images")
    return replace(recording, opened=replace(opened, file_notes=(*opened.file_notes, note)))


def _shown_mounting(recording: Recording, reopen: Callable[[], Recording]) -> Mounting | None:
    """The mounting of the view that the first images of a recording show; None = none."""
    search = MountingSearch(recording.camera, recording.calibration.focal_sigma)
    with closing(reopen()) as again:
        for frame in every_step(PAIR_S, again.frames):
            search.add(frame.left, frame.time_s)
            if search.mounting is not None or frame.time_s > _SEARCHED_S:
                break
    return search.mounting


def _contradicts(shown: Mounting, known: Mounting) -> bool:
    """Whether a mounting is surely and clearly another."""
    return shown.apart_deg(known) > max(
        _SURE_SIGMAS * math.hypot(shown.sigma_deg, known.sigma_deg), AHEAD_DEG
    )


def direction_text(mounting: Mounting) -> str:
    """Where a camera looks, with the standard deviation, for notes."""
    degrees, side = abs(round(mounting.yaw_deg)), "left" if mounting.yaw_deg > 0 else "right"
    if degrees == 180:
        return f"to the rear (± {mounting.sigma_deg:.0f} degrees)"
    return f"{degrees} ± {mounting.sigma_deg:.0f} degrees to the {side} of the direction of travel"

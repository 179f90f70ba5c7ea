"""RecordingOptions: how a recording is opened, and which part of it is read."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Self, TypedDict

from track_range.recording.video.layouts import Bayer, LayoutOption
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.rig import StereoRig


@dataclass(frozen=True, slots=True, kw_only=True)
class RecordingOptions:
    """How a recording is opened, and which part of it is read.

    Attributes:
        rig: calibration file (rig.yaml, or the file of a camera or a script), or the models of two
            cameras, of which one video uses the left one; None = a file next to the left video, if
            any.
        camera: names of the camera, or of the left and the right one, in a calibration file of
            several; empty = by the size of the images, or the left and the right one.
        focal_px: focal length of cameras without a calibration file.
        fov_deg: horizontal field of view, 20 to 120 degrees, to which the images of wide lenses are
            undistorted; None = the lens's, up to 120 degrees.
        lens_fov_deg: field of view of the lens of cameras without a calibration, as on its box:
            "140d" diagonal, "120h" horizontal, "70v" vertical degrees.
        camera_model: model of cameras without a calibration, such as "comma EON".
        yaw_deg: direction of the axis of the undistorted images of one camera with a wide lens, to
            the right of the lens axis.
        align: disparity correction of a calibrated pair: "auto" = estimated from its first frames
            (at most 8 s), "off", an alignment file, or an alignment.
        start_s: start of the part to read, in seconds after the left video's first frame.
        duration_s: length of the part to read; None = to the end.
        every: N = every N-th frame is read; the checks of a recorded pair use all frames.
        fps: frame rate of images without times: folders without timestamps.txt, and streams without
            a container; None = as stated, else assumed, with a note. Also `folder_fps`.
        has_checks: whether calibrated pairs are checked for swapped, misaligned or unsynchronised
            videos, and frames that lag are re-paired.
        start_utc: UTC of the left video's first frame, in ISO 8601; None = from the video.
        topics: topics of the images of the left and right camera, if the videos are MCAP files or
            ROS bags.
        stereo_layout: layout of the images of two cameras in one recording: "side-by-side",
            "right-left", "top-bottom", "bottom-top", "tracks" (two video tracks), or "auto" =
            detected; None = one camera, or two videos.
        track: video track of the files, counted from 0; None = the largest track.
        bayer: Bayer filter of images in folders: "rggb", "bggr", "gbrg" or "grbg".
    """

    rig: str | Path | StereoRig | None = None
    camera: str | Sequence[str] = ()
    focal_px: float | None = None
    fov_deg: float | None = None
    lens_fov_deg: str | None = None
    camera_model: str | None = None
    yaw_deg: float = 0.0
    align: str | Path | Alignment = "auto"
    start_s: float = 0.0
    duration_s: float | None = None
    every: int = 1
    fps: float | None = None
    has_checks: bool = True
    start_utc: str | None = None
    topics: Sequence[str] = ()
    stereo_layout: LayoutOption | None = None
    track: int | None = None
    bayer: Bayer | None = None

    def replaced(self, keywords: RecordingKeywords) -> Self:
        """The options with others by keyword."""
        given: dict[str, Any] = dict(keywords)
        if "folder_fps" in given:
            given.setdefault("fps", given.pop("folder_fps"))
        return replace(self, **given)


class RecordingKeywords(TypedDict, total=False):
    """The fields of `RecordingOptions` by keyword."""

    rig: str | Path | StereoRig | None
    camera: str | Sequence[str]
    focal_px: float | None
    fov_deg: float | None
    lens_fov_deg: str | None
    camera_model: str | None
    yaw_deg: float
    align: str | Path | Alignment
    start_s: float
    duration_s: float | None
    every: int
    fps: float | None
    folder_fps: float | None  # earlier name of `fps`
    has_checks: bool
    start_utc: str | None
    topics: Sequence[str]
    stereo_layout: LayoutOption | None
    track: int | None
    bayer: Bayer | None


DEFAULTS = RecordingOptions()

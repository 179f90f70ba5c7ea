"""find_layout: how the images of a recording contain the images of two cameras.

given -> stated by the file (frame packing of H.264 and HEVC, StereoMode, st3d, vexu) -> two video tracks of equal size
      -> stated by the name (drive_SBS.mp4) -> halves that match as left and right do
"""

import math
import re
from collections.abc import Sequence
from contextlib import closing, suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from track_range.foundation.arrays import Image
from track_range.recording.sources.names import source_of
from track_range.recording.sources.video_half import image_half
from track_range.recording.telemetry.containers.mp4_boxes import read_movie
from track_range.recording.video.frame import VideoError
from track_range.recording.video.layouts import LayoutOption, StereoLayout
from track_range.recording.video.video import Video
from track_range.stereo.alignment.pair_evidence import PairEvidence, PairFigures
from track_range.stereo.alignment.pair_finding import Fault, find_fault
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

_IN_NAMES: dict[str, StereoLayout] = {  # by parts of file names, as players of 3-D videos read them
    **dict.fromkeys(("sbs", "hsbs", "halfsbs", "lr", "3dh"), "side-by-side"),
    **dict.fromkeys(("rl", "sbsrl"), "right-left"),
    **dict.fromkeys(("tab", "tb", "htab", "ou", "hou", "3dv"), "top-bottom"),
    **dict.fromkeys(("bt",), "bottom-top"),
}
_SHOWN: dict[StereoLayout, str] = {
    "side-by-side": "beside each other, the left camera's on the left",
    "right-left": "beside each other, the left camera's on the right",
    "top-bottom": "below each other, the left camera's at the top",
    "bottom-top": "below each other, the left camera's at the bottom",
    "tracks": "in two video tracks, the left camera's in the first track",
}
_SWAPPED: dict[StereoLayout, StereoLayout] = {
    "side-by-side": "right-left",
    "top-bottom": "bottom-top",
}

_THUMBNAIL_PX = 32, 18  # size of the images that are compared first
_MAX_SHIFT_PX = 4  # largest displacement of these, a disparity of an eighth of the width
_MIN_CORRELATION = 0.7  # smallest one of left and right images
_N_FRAMES, _FRAME_STEP = 3, 10  # number of frames that are matched, and from one to the next
_FOCAL_PER_WIDTH, _BASELINE_M = 0.8, 0.12  # of the camera that is assumed for matching
_MIN_PARALLAX_PX = 3.0  # smallest median disparity of a pair whose order it shows
_MIN_MATCHES = 60  # smallest number of matches per frame in equal rows of left and right


@dataclass(frozen=True, slots=True)
class FoundLayout:
    """A layout, and the source that states it."""

    layout: StereoLayout
    source: str

    def sentence(self, name: str) -> str:
        """Note for the user on the layout of the video `name`, and the option for another one."""
        shown = f"{_SHOWN[self.layout]} ({self.source})"
        return (
            f"{name}: the images of the two cameras are {shown}; --stereo-layout chooses another "
            "layout."
        )


def find_layout(video: Video, given: LayoutOption) -> FoundLayout:
    """The layout of a recording of two cameras; raises VideoError if it is not known."""
    if given == "tracks" and len(stereo_tracks(video)) < 2:
        raise VideoError(
            f"{video.path}: expected two video tracks of equal size, found {_listed(video)}; "
            "choose another --stereo-layout (Python: stereo_layout)."
        )
    if given != "auto":
        return FoundLayout(given, "as given")
    if video.stated_layout is not None:
        return FoundLayout(video.stated_layout, "as the file states")
    if len(stereo_tracks(video)) > 1:
        return FoundLayout("tracks", f"the file has {_listed(video)}")
    for path in source_of(video.path).files[:1]:
        parts = re.split(r"[^a-z0-9]+", path.stem.lower().replace("half-sbs", "hsbs"))
        if named := [_IN_NAMES[part] for part in parts if part in _IN_NAMES]:
            return FoundLayout(named[-1], "as the file name states")
    if matched := matching_halves(_first_images(video)):
        return matched
    if any(has_second_view(path) for path in source_of(video.path).files[:1]):
        raise VideoError(
            f"{video.path}: expected the images of two cameras in one image, found spatial video "
            "(MV-HEVC), of which only the first view can be decoded; convert it to images beside "
            "each other, or use --mono."
        )
    raise VideoError(
        f"{video.path}: expected the images of two cameras in this recording, which was given "
        "alone or as both videos, found no two halves that "
        "match; give the right video as well, or --stereo-layout side-by-side, right-left, "
        "top-bottom, bottom-top or tracks (Python: stereo_layout), or use --mono."
    )


def mono_notes(video: Video) -> tuple[str, ...]:
    """A note if the images of one camera seem to contain two cameras."""
    stated, images = video.stated_layout, [] if video.first_image is None else [video.first_image]
    layout = FoundLayout(stated, "as the file states") if stated else matching_halves(images)
    if layout is None:
        return ()
    return (
        f"{video.path}: each image seems to contain the images of two cameras, "
        f"{_SHOWN[layout.layout]} ({layout.source}), so that road users are counted twice and "
        f"distances are wrong; use --stereo {video.path} --stereo-layout {layout.layout} (Python: "
        "stereo_layout).",
    )


def has_second_view(path: Path) -> bool:
    """Whether an MP4 file states a second view in the layers of its HEVC stream (box `lhvC`,
    ISO/IEC 14496-15).
    """
    with suppress(OSError), path.open("rb") as file:
        movie = read_movie(file)
        return movie is not None and movie.video is not None and b"lhvC" in movie.video.description
    return False


def stereo_tracks(video: Video) -> tuple[int, ...]:
    """Numbers of the video tracks of a file that are as large as the largest track of images."""
    tracks_px = {
        number: size_px
        for number, size_px in enumerate(video.tracks_px)
        if number not in video.depth_tracks
    }
    largest = max(tracks_px.values(), key=math.prod, default=None)
    return tuple(number for number, size_px in tracks_px.items() if size_px == largest)


def matching_halves(images: Sequence[Image]) -> FoundLayout | None:
    """The layout of images whose halves are as similar as left and right images; None = images of
    one camera.
    """
    for layout in _SWAPPED if images else ():
        halves = [
            (
                image_half(layout, image, is_right=False),
                image_half(layout, image, is_right=True),
            )
            for image in images
        ]
        if min(halves[0][0].shape[:2]) < 2 * _THUMBNAIL_PX[1] or not _are_alike(*halves[0]):
            continue
        if matched := _matched(layout, halves):
            return matched
    return None


def _matched(layout: StereoLayout, halves: Sequence[tuple[Image, Image]]) -> FoundLayout | None:
    """The layout of halves, or that with the halves exchanged; None = they are not those of a
    pair.
    """
    height_px, width_px = halves[0][0].shape[:2]
    camera = PinholeCamera.of_focal_length(_FOCAL_PER_WIDTH * width_px, (width_px, height_px))
    evidence = PairEvidence(camera)
    for left, right in halves:
        evidence.add(left, right)
    figures = evidence.figures()
    n_agreeing = len(figures.left_px)
    if n_agreeing < _MIN_MATCHES * len(halves):
        return None
    fault = find_fault(figures, StereoRig.rectified(camera, _BASELINE_M)).fault
    if fault == "refused" and figures.arrangement == "equal":
        fault = _order_by_parallax(figures)
    if fault not in ("fits", "verged", "swapped"):
        return None
    source = f"{n_agreeing} of {figures.n_matches} matching points of both halves are in equal rows"
    return FoundLayout(_SWAPPED[layout] if fault == "swapped" else layout, source)


def _order_by_parallax(figures: PairFigures) -> Fault:
    """Whether halves whose order is in doubt are exchanged, by the sign of most disparities."""
    median_px = float(np.median(figures.disparity_px))
    if abs(median_px) < _MIN_PARALLAX_PX:
        return "unknown"
    return "swapped" if median_px < 0 else "fits"


def _are_alike(first: Image, second: Image) -> bool:
    """Whether small images of the halves are correlated at some displacement."""
    a, b = (
        cv2.resize(image, _THUMBNAIL_PX, interpolation=cv2.INTER_AREA)
        .mean(axis=2)
        .astype(np.float32)
        for image in (first, second)
    )
    shift = _MAX_SHIFT_PX
    return (
        float(cv2.matchTemplate(b, a[:, shift:-shift], cv2.TM_CCOEFF_NORMED).max())
        >= _MIN_CORRELATION
    )


def _first_images(video: Video) -> list[Image]:
    if video.is_live:
        return [] if video.first_image is None else [video.first_image]
    with closing(iter(video)) as frames:
        return [frame.image for frame in islice(frames, 0, _N_FRAMES * _FRAME_STEP, _FRAME_STEP)]


def _listed(video: Video) -> str:
    return (
        " and ".join(f"{width_px}x{height_px} px" for width_px, height_px in video.tracks_px)
        or "none"
    )

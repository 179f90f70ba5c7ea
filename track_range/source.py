"""From files to frames: videos opened, rig found and checked, left and right paired, rectified and looked at."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from detection.detections import FloatArray, Image
from stereo.alignment import check_pair
from stereo.camera import PinholeCamera
from stereo.frames import Frame
from stereo.rectification import Rectifier, Undistorter
from stereo.rig import RigError, StereoRig
from stereo.rig_checks import check_camera
from stereo.rig_files import find_rig, left_from_reference_m, load_camera, load_rig
from track_range.config import RunSettings
from track_range.pairing import StereoVideo
from track_range.video import VideoError, VideoFrame, VideoReader

_CODEC_CROP_PX = 2  # video codecs want even sizes, so one eye may have lost a row or a column
_MAX_CHECKED_PAIRS = 10  # so many pairs are looked at until one shows enough to tell left from right
_MAX_ROW_OFFSET_PX = 1.5
_UNMATCHED = (
    f"In the first {_MAX_CHECKED_PAIRS} pairs left and right share too few points in equal rows to check the rig by: "
    "do the two videos and the rig belong together?"
)


@dataclass(slots=True)
class Source:
    """An opened input.

    Attributes:
        frames: rectified (one camera: undistorted) frames; can be run through once.
        camera: the left camera that they seem to come from.
        rig: the pair; None = one camera.
        rectified_boxes: boxes (N, 4) of the left video's own pixels -> of the frames' pixels.
        left_from_reference_m: (3,) shift that takes labels of the rig's reference camera into the left one's frame.
        rig_path: where the geometry comes from; None = `--focal-px`.
        n_frames: how many to expect; None = unknown.
        fps: nominal frame rate.
        size_px: width and height of the frames.
        opening_notes: sentences for the user on the rig.
        readers: one per eye.
        watchers: pairing and checks whose notes, like the readers', are complete only after the last frame.
    """

    frames: Generator[Frame, None, None]
    camera: PinholeCamera
    rig: StereoRig | None
    rectified_boxes: Callable[[FloatArray], FloatArray]
    left_from_reference_m: FloatArray
    rig_path: Path | None
    n_frames: int | None
    fps: float
    size_px: tuple[int, int]
    opening_notes: tuple[str, ...]
    readers: tuple[VideoReader, ...]
    watchers: tuple[_Noting, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth telling so far."""
        watched = itertools.chain.from_iterable(one.notes for one in (*self.readers, *self.watchers))
        return (*self.opening_notes, *watched)

    @property
    def busy_s(self) -> float:
        """Time spent reading and decoding so far, both eyes added."""
        return sum(reader.busy_s for reader in self.readers)


class _Noting(Protocol):
    """Whatever collects sentences for the user while frames pass."""

    @property
    def notes(self) -> Sequence[str]: ...


def open_source(settings: RunSettings) -> Source:
    """Open what the settings name.

    Raises:
        VideoError: a video cannot be used, or the two do not fit each other.
        RigError: no geometry, or one that does not fit the images, or left and right are swapped.
    """
    return _open_pair(settings, *settings.stereo) if settings.stereo else _open_single(settings)


def _reader(settings: RunSettings, path: Path, *, origin_s: float | None = None) -> VideoReader:
    return VideoReader(
        path,
        folder_fps=settings.folder_fps,
        start_s=settings.start_s,
        duration_s=settings.duration_s,
        origin_s=origin_s,
    )


def _open_single(settings: RunSettings) -> Source:
    reader = _reader(settings, settings.left)
    size_px = (reader.width_px, reader.height_px)
    rig_path, found = _rig_path(settings)
    notes: tuple[str, ...] = ()
    if settings.focal_px is not None:
        camera = _camera_of_focal_length(settings.focal_px, size_px)
        check_camera(camera, "--focal-px")
    elif rig_path is not None:
        camera, notes = load_camera(rig_path, size_px=size_px, is_grey=reader.is_grey)
    else:
        raise RigError(
            f"{settings.left}: no focal length, so no metres: give --focal-px F or --rig FILE "
            "(or put a rig.yaml or calib.txt beside the video)."
        )
    undistorter = Undistorter(camera)
    frames = (_frame(reader, left, undistorter.undistort(left.image), None) for left in reader)
    shift_m = np.zeros(3) if rig_path is None else left_from_reference_m(rig_path, is_grey=reader.is_grey)
    return Source(
        frames=frames,
        camera=undistorter.camera,
        rig=None,
        rectified_boxes=undistorter.boxes,
        left_from_reference_m=shift_m,
        rig_path=rig_path,
        n_frames=reader.n_frames,
        fps=reader.fps,
        size_px=size_px,
        opening_notes=(*found, *notes),
        readers=(reader,),
    )


def _open_pair(settings: RunSettings, left_path: Path, right_path: Path) -> Source:
    left = _reader(settings, left_path)
    right = _reader(settings, right_path, origin_s=left.first_time_s)
    size_px = _common_size_px(left, right)
    rig_path, found = _rig_path(settings)
    if rig_path is None:
        raise RigError(
            f"{left_path}: no rig, so no metres: give --rig FILE (rig.yaml, KITTI's calib.txt or OpenCV's stereo "
            "calibration), or put a rig.yaml or calib.txt beside the left video."
        )
    rig, notes = load_rig(rig_path, size_px=size_px, is_grey=left.is_grey)
    rectifier = Rectifier(rig)
    video = StereoVideo(left, right)
    alignment = _AlignmentWatch()
    frames = alignment.watched(_rectified_pairs(video, rectifier, size_px))
    first = next(frames, None)  # swapped eyes are found before anything is written
    return Source(
        frames=_first_and_rest(first, frames),
        camera=rectifier.rig.left,
        rig=rectifier.rig,
        rectified_boxes=rectifier.left_boxes,
        left_from_reference_m=left_from_reference_m(rig_path, is_grey=left.is_grey),
        rig_path=rig_path,
        n_frames=left.n_frames,
        fps=left.fps,
        size_px=size_px,
        opening_notes=(*found, *notes),
        readers=(left, right),
        watchers=(video, alignment),
    )


def _first_and_rest(first: Frame | None, rest: Generator[Frame, None, None]) -> Generator[Frame, None, None]:
    """Both in order; closing this closes the rest, and with it the videos."""
    with closing(rest):
        if first is not None:
            yield first
            yield from rest


def _rig_path(settings: RunSettings) -> tuple[Path | None, tuple[str, ...]]:
    if settings.rig is not None or settings.focal_px is not None:
        return settings.rig, ()
    found = find_rig(settings.left)
    return found, (() if found is None else (f"No --rig given: {found} beside the left video is used.",))


def _camera_of_focal_length(focal_px: float, size_px: tuple[int, int]) -> PinholeCamera:
    width_px, height_px = size_px
    return PinholeCamera(focal_px, focal_px, (width_px - 1) / 2, (height_px - 1) / 2, width_px, height_px)


def _common_size_px(left: VideoReader, right: VideoReader) -> tuple[int, int]:
    sizes = [(reader.width_px, reader.height_px) for reader in (left, right)]
    if any(abs(a - b) > _CODEC_CROP_PX for a, b in zip(*sizes, strict=True)):
        (lw, lh), (rw, rh) = sizes
        raise VideoError(f"{left.path} is {lw}x{lh} but {right.path} {rw}x{rh}: left and right must have one size.")
    return min(w for w, _ in sizes), min(h for _, h in sizes)


def _rectified_pairs(
    video: StereoVideo, rectifier: Rectifier, size_px: tuple[int, int]
) -> Generator[Frame, None, None]:
    width_px, height_px = size_px
    with closing(iter(video)) as pairs:
        for left, right in pairs:
            images = (eye.image[:height_px, :width_px] for eye in (left, right))
            left_image, right_image = rectifier.rectify(*images)
            yield _frame(video.left, left, left_image, right_image)


def _frame(reader: VideoReader, left: VideoFrame, left_image: Image, right_image: Image | None) -> Frame:
    return Frame(left.index, left.time_s - reader.first_time_s, left_image, right_image)


class _AlignmentWatch:
    """Looks at the first pairs until one tells whether the eyes are swapped or their rows apart."""

    def __init__(self) -> None:
        self.notes: tuple[str, ...] = ()
        self._is_settled = False

    def watched(self, frames: Generator[Frame, None, None]) -> Generator[Frame, None, None]:
        with closing(frames):
            for number, frame in enumerate(frames):
                if not self._is_settled and number < _MAX_CHECKED_PAIRS:
                    self._look(frame)
                if not self._is_settled and number == _MAX_CHECKED_PAIRS:
                    self.notes = (_UNMATCHED,)
                yield frame

    def _look(self, frame: Frame) -> None:
        if frame.right is None:
            return
        check = check_pair(frame.left, frame.right)
        if check.is_swapped:
            raise RigError(
                f"left and right are swapped: {100 * check.negative_share:.0f} % of {check.n_matches} matched points "
                "lie further right in the right image; hand the videos over the other way round."
            )
        self._is_settled = check.is_conclusive
        if self._is_settled and abs(check.row_offset_px) > _MAX_ROW_OFFSET_PX:
            self.notes = (
                f"Rows of left and right are {check.row_offset_px:+.1f} px apart: the rig does not fit these videos "
                "well, and stereo distances will suffer; calibrate anew.",
            )

"""From files to frames: videos opened, rig found and checked, left and right paired, rectified and looked at."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.run.settings import RunSettings, VideoName
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rectification import Rectifier, Undistorter
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import check_camera
from track_range.stereo.rig_formats.reading import find_rig, left_from_reference_m, load_camera, load_rig
from track_range.video.auto_alignment import FoundAlignment, Progress, find_alignment
from track_range.video.live.address import LiveAddress
from track_range.video.live.reader import LiveReader
from track_range.video.pair_monitor import PairWatch
from track_range.video.stereo_frames import Reader, StereoFrames, eye_reader
from track_range.video.uncalibrated import ASSUMED_BASELINE_M, UncalibratedPair, camera_of_focal_length

CalibrationKind = Literal["rig", "focal length", "estimated"]
"""Where metres come from: a file, --focal-px, or the sizes of road users."""


_NO_DISPARITY = ("No disparity.mp4: dense stereo needs a rig.",)
_NO_SIDE = ("No disparities below the overlay: dense stereo needs a rig.",)


@dataclass(slots=True)
class Source:
    """An opened input.

    Attributes:
        frames: rectified (one camera: undistorted) frames; can be run through once.
        camera: the left camera that they seem to come from.
        rig: the pair; None = one camera, or a pair that nobody has calibrated.
        rectified_boxes: boxes (N, 4) of the left video's own pixels -> of the frames' pixels.
        left_from_reference_m: (3,) shift that takes labels of the rig's reference camera into the left one's frame.
        rig_path: where the geometry comes from; None = `--focal-px`.
        n_frames: how many to expect; None = unknown.
        fps: nominal frame rate.
        size_px: width and height of the frames.
        calibration: where metres come from.
        opening_notes: sentences for the user on the rig.
        readers: one per eye.
        watchers: pairing and checks whose notes, like the readers', are complete only after the last frame.
        alignment: what the disparities of a calibrated pair are corrected by.
        uncalibrated: what is taken for granted of a pair without a rig.
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
    calibration: CalibrationKind
    opening_notes: tuple[str, ...]
    readers: tuple[Reader, ...]
    watchers: tuple[_Noting, ...] = ()
    alignment: FoundAlignment | None = None
    uncalibrated: UncalibratedPair | None = None

    @property
    def notes(self) -> tuple[str, ...]:
        """What is worth telling so far."""
        watched = itertools.chain.from_iterable(one.notes for one in (*self.readers, *self.watchers))
        return (*self.opening_notes, *watched)

    @property
    def live(self) -> LiveReader | None:
        """The left eye, where it is a camera or a stream."""
        left = self.readers[0]
        return left if isinstance(left, LiveReader) else None

    @property
    def busy_s(self) -> float:
        """Time spent reading and decoding so far, both eyes added."""
        return sum(reader.busy_s for reader in self.readers)


class _Noting(Protocol):
    """Whatever collects sentences for the user while frames pass."""

    @property
    def notes(self) -> Sequence[str]: ...


def open_source(settings: RunSettings, progress: Progress | None = None) -> Source:
    """Open what the settings name; `progress` is told of a look through the first frames.

    Raises:
        VideoError: a video cannot be used, or the two do not fit each other.
        RigError: no geometry, or one that does not fit the images, or left and right are swapped.
    """
    if settings.stereo is None:
        return _open_single(settings)
    rig_path, found = _rig_path(settings)
    if rig_path is None:
        return _open_uncalibrated(settings, settings.stereo)
    return _open_pair(settings, settings.stereo, rig_path, found=found, progress=progress)


def _open_single(settings: RunSettings) -> Source:
    reader = eye_reader(settings, settings.left)
    size_px = (reader.width_px, reader.height_px)
    rig_path, found = _rig_path(settings)
    notes: tuple[str, ...] = ()
    if settings.focal_px is not None:
        camera = camera_of_focal_length(settings.focal_px, size_px)
        check_camera(camera, "--focal-px")
    elif rig_path is not None:
        camera, notes = load_camera(rig_path, size_px=size_px, is_grey=reader.is_grey)
    else:
        raise RigError(
            f"{settings.left}: no focal length, so no metres: give --focal-px F or --rig FILE "
            "(or put a rig.yaml or calib.txt beside the video)."
        )
    undistorter = Undistorter(camera)
    frames = (
        Frame(left.index, left.time_s - reader.first_time_s, undistorter.undistort(left.image), None) for left in reader
    )
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
        calibration="focal length" if rig_path is None else "rig",
        opening_notes=(*found, *notes),
        readers=(reader,),
    )


def _open_pair(
    settings: RunSettings,
    stereo: tuple[VideoName, VideoName],
    rig_path: Path,
    *,
    found: tuple[str, ...],
    progress: Progress | None,
) -> Source:
    pair = StereoFrames.open(settings, stereo)
    rig, notes = load_rig(rig_path, size_px=pair.size_px, is_grey=pair.left.is_grey)
    rectifier = Rectifier(rig)
    alignment = find_alignment(
        settings.align,
        rectifier.rig,
        lambda: pair.to_look_at().rectified(rectifier),
        progress,
    )
    if alignment.measured.rows_to_move_px:
        rectifier = Rectifier(rig, row_offset_px=alignment.measured.rows_to_move_px)
    frames, watch = _watched(pair.rectified(rectifier))
    return Source(
        frames=frames,
        camera=rectifier.rig.left,
        rig=rectifier.rig,
        rectified_boxes=rectifier.left_boxes,
        left_from_reference_m=left_from_reference_m(rig_path, is_grey=pair.left.is_grey),
        rig_path=rig_path,
        n_frames=pair.left.n_frames,
        fps=pair.left.fps,
        size_px=pair.size_px,
        calibration="rig",
        opening_notes=(*found, *notes, *alignment.notes),
        readers=(pair.left, pair.video.right),
        watchers=(pair.video, watch),
        alignment=alignment,
    )


def _open_uncalibrated(settings: RunSettings, stereo: tuple[VideoName, VideoName]) -> Source:
    pair = StereoFrames.open(settings, stereo)
    taken = UncalibratedPair.of(pair.size_px, settings.focal_px)
    check_camera(taken.camera, "--focal-px")
    guessed = StereoRig.rectified(
        taken.camera, ASSUMED_BASELINE_M
    )  # rectifying needs a baseline, and makes no use of it
    with closing(pair.to_look_at().rectified(Rectifier(guessed))) as first_frames:
        taken = taken.looked_at(first_frames)
    frames, watch = _watched(pair.rectified(Rectifier(guessed, row_offset_px=taken.row_offset_px)))
    return Source(
        frames=frames,
        camera=taken.camera,
        rig=None,
        rectified_boxes=lambda xyxy_px: xyxy_px,
        left_from_reference_m=np.zeros(3),
        rig_path=None,
        n_frames=pair.left.n_frames,
        fps=pair.left.fps,
        size_px=pair.size_px,
        calibration="estimated",
        opening_notes=(
            *taken.notes,
            *(_NO_DISPARITY if settings.disparity else ()),
            *(_NO_SIDE if settings.overlay_side else ()),
        ),
        readers=(pair.left, pair.video.right),
        watchers=(pair.video, watch) if taken.has_equal_rows else (pair.video,),
        uncalibrated=taken,
    )


def _watched(frames: Generator[Frame, None, None]) -> tuple[Generator[Frame, None, None], PairWatch]:
    """The same frames, and what looks at them: at the first one now, before anything is written."""
    watch = PairWatch()
    watched = watch.watched(frames)
    return _first_and_rest(next(watched, None), watched), watch


def _first_and_rest(first: Frame | None, rest: Generator[Frame, None, None]) -> Generator[Frame, None, None]:
    """Both in order; closing this closes the rest, and with it the videos."""
    with closing(rest):
        if first is not None:
            yield first
            yield from rest


def _rig_path(settings: RunSettings) -> tuple[Path | None, tuple[str, ...]]:
    if settings.rig is not None or settings.focal_px is not None:
        return settings.rig, ()
    found = None if isinstance(settings.left, LiveAddress) else find_rig(settings.left)
    return found, (() if found is None else (f"No --rig given: {found} beside the left video is used.",))

"""ImageFolder: a folder of numbered images as a video.

The number in a file name is the frame number, and time = number / fps: a missing number is a
dropped frame, and left and right of a pair stay synchronised. Times in the names, or in a file of
times beside the images, are used instead (`image_names`).
"""

import stat
from collections.abc import Generator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import Image
from track_range.foundation.files.images import read_image
from track_range.foundation.files.input_files import check_regular, counted
from track_range.recording.sources.files.image_names import is_epoch, named_images, usual_step
from track_range.recording.video.clock import assumed_rate_note
from track_range.recording.video.frame import (
    TIME_EPSILON_S,
    VideoError,
    VideoFrame,
    is_neutral,
    strictly_later,
)
from track_range.recording.video.layouts import Bayer
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.recording.video.utc import ZONE_SPAN_S, UtcStart

_ASSUMED_RATE_HZ = 10.0  # as of KITTI
_DARK = 257  # smaller largest values belong to dark images with 16 bits


class UnreadableImageError(VideoError):
    """An image of a folder that cannot be decoded; it is skipped unless no image can be decoded."""


class ImageFolder(RecordedVideo):
    """Numbered images in one folder, in the order of their numbers; unreadable images are skipped.

    `fps` is the argument, or the median rate of times in names or beside them, which may be seconds
    since 1970; without both it is assumed, with a note. Raises VideoError if there are no numbered
    images, two have the same number, one is no regular file, or none is readable.
    """

    path: Path
    n_total: int

    def __init__(self, path: Path, *, fps: float | None = None, bayer: Bayer | None = None) -> None:
        self.path = path
        self._images, times_s, self._folder_notes, self._clock, self._is_local = named_images(path)
        self._states = [_state(image) for _, image in self._images]
        self.n_total = len(self._images)
        rate_hz = fps or _ASSUMED_RATE_HZ
        if times_s is None and len(self._images) > 1:
            rate_hz *= self._numbers_per_image(fps)
        self._has_stamps = times_s is not None and is_epoch(float(times_s[0]))
        steps_s = np.diff([] if times_s is None else times_s)
        steps_s = steps_s[steps_s > TIME_EPSILON_S]
        self.fps = float(1 / np.median(steps_s)) if steps_s.size else rate_hz
        self._times_s = (
            [number / rate_hz for number, _ in self._images]
            if times_s is None
            else times_s.tolist()
        )
        self._shift, self._bayer = 0, bayer
        # errors of unreadable images before the first readable one
        self._leading: list[VideoError] = []
        number, image = self._first_readable()
        self.first_time_s = self._times_s[number]
        self.height_px, self.width_px = image.shape[:2]
        self.is_grey, self.first_image = is_neutral(image), image
        self._n_backward = 0
        self._unreadable = self._leading

    def _numbers_per_image(self, fps: float | None) -> int:
        """How much the numbers in the names increase from image to image; notes on the rate."""
        step = usual_step([number for number, _ in self._images])
        if step == 1:
            if fps is None:
                self._folder_notes.append(assumed_rate_note(self.path, _ASSUMED_RATE_HZ))
            return 1
        growth = f"{self.path}: the numbers in the names increase by {step} from image to image"
        if fps is not None:
            self._folder_notes.append(
                f"{growth}, so that {fps:g} frames/s is the rate of the images, and not of the "
                "numbers."
            )
            return step
        self.time_question = (
            f"{growth}, as milliseconds do ({1000 / step:.3g} images/s), or numbers of frames of "
            "which the others were left out; give the rate of these images with --fps."
        )
        return 1

    @property
    def utc(self) -> UtcStart | None:
        """See `RecordedVideo`."""
        if not self._has_stamps:
            return None
        return UtcStart(
            self.first_time_s,
            self._clock,
            ZONE_SPAN_S if self._is_local else None,
            is_local=self._is_local,
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """See `RecordedVideo`."""
        notes, n_unreadable = list(self._folder_notes), len(self._unreadable)
        if n_unreadable:
            notes.append(
                f"{self.path}: skipped {counted(n_unreadable, 'unreadable image')}: "
                f"{self._unreadable[0]}"
            )
        if self._n_backward:
            skipped = (
                f"skipped {counted(self._n_backward, 'image')} with a repeated or backward "
                "timestamp."
            )
            notes.append(f"{self.path}: {skipped}")
        return tuple(notes)

    def frames(self, from_s: float, until_s: float) -> Generator[VideoFrame, None, None]:
        """See `RecordedVideo`."""
        self._n_backward, last_s, first_number = 0, None, self._images[0][0]
        self._unreadable = list(self._leading)
        for (number, path), stamp_s in zip(self._images, self._times_s, strict=True):
            time_s = strictly_later(stamp_s, last_s, interval_s=1 / self.fps)
            if time_s is None:
                self._n_backward += 1
                continue
            last_s = time_s
            if from_s - TIME_EPSILON_S <= time_s < until_s - TIME_EPSILON_S:
                try:
                    image = self._image(path)
                except UnreadableImageError as error:
                    self._unreadable.append(error)
                    continue
                yield VideoFrame(number - first_number, time_s, image)

    def check_unchanged(self) -> None:
        """See `RecordedVideo.check_unchanged`; an image that was still being written may have
        grown.
        """
        for (_, path), (n_bytes, modified_ns) in zip(self._images, self._states, strict=True):
            try:
                status = path.stat()
            except OSError:
                continue
            if status.st_size < n_bytes or (
                status.st_size == n_bytes and status.st_mtime_ns != modified_ns
            ):
                raise VideoError(
                    f"{path}: the image was overwritten while the folder was read; repeat the run."
                )

    def _first_readable(self) -> tuple[int, Image]:
        """The first image that can be read, and its place in the list; raises the first error if
        none can.
        """
        for number, (_, path) in enumerate(self._images):
            try:
                stored = _stored(path, self._bayer)
                self._shift = _shift_of(stored)
                if self._shift not in (0, 8):
                    self._folder_notes.append(
                        f"{self.path}: images have {8 + self._shift} bits per channel, judging by "
                        "their largest value; their upper 8 bits are used."
                    )
                return number, _reduced(stored, self._shift, self._bayer)
            except UnreadableImageError as error:
                self._leading.append(error)
        raise self._leading[0]

    def _image(self, path: Path) -> Image:
        if not path.exists():
            raise VideoError(
                f"{path}: the image was deleted or moved while the folder was read; repeat the run."
            )
        image = _reduced(_stored(path, self._bayer), self._shift, self._bayer)
        advice = "a folder must contain the images of one camera"
        self.check_size(image.shape[1::-1], " like the first image", advice, path)
        return image


def _stored(path: Path, bayer: Bayer | None) -> npt.NDArray[Any]:
    """The pixels of a file, uint8 or uint16: (H, W, 3) BGR, upright by EXIF, or (H, W) behind a
    Bayer filter.
    """
    flags = cv2.IMREAD_COLOR if bayer is None else cv2.IMREAD_GRAYSCALE
    image = read_image(
        path, UnreadableImageError, "an image of the folder", flags=flags | cv2.IMREAD_ANYDEPTH
    )
    if image.dtype not in (np.uint8, np.uint16):
        raise VideoError(
            f"{path}: expected 8- or 16-bit pixels, got {image.dtype}; convert the images."
        )
    return image


def _shift_of(image: npt.NDArray[Any]) -> int:
    """Number of lowest bits to drop: of cameras with 10, 12 or 14 bits, the upper bits of 16 are
    zero.
    """
    if image.dtype == np.uint8:
        return 0
    largest = int(image.max())
    return next((n_bits - 8 for n_bits in (10, 12, 14) if _DARK <= largest < 1 << n_bits), 8)


def _reduced(image: npt.NDArray[Any], shift: int, bayer: Bayer | None) -> Image:
    """The image as (H, W, 3) uint8 BGR."""
    reduced = (
        np.minimum(image >> shift, 255).astype(np.uint8) if image.dtype == np.uint16 else image
    )
    colours = (
        reduced
        if bayer is None
        else cv2.cvtColor(reduced, getattr(cv2, f"COLOR_Bayer{bayer.upper()}2BGR"))
    )
    return np.asarray(colours, np.uint8)


def _state(path: Path) -> tuple[int, int]:
    """Size in bytes and time of the last change in ns of an image; raises VideoError if it is not a
    regular file.
    """
    try:
        status = path.stat()
    except OSError:
        status = None
    if status is None or not stat.S_ISREG(status.st_mode):
        check_regular(path, VideoError, "an image of the folder")
        status = path.stat()
    return status.st_size, status.st_mtime_ns

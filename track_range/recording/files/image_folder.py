"""ImageFolder: a folder of numbered images as a video.

The last number in a file name is the frame number, and time = number / fps: a missing number is a dropped frame, and
left and right of a pair stay synchronised. If the folder or its parent contains KITTI's timestamps.txt, with one line
such as `2011-09-26 13:10:51.168593664` per image, the times are read from it instead.
"""

from __future__ import annotations

import itertools
import re
import stat
from collections.abc import Generator
from pathlib import Path

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.files.atomic_files import describe
from track_range.foundation.files.images import IMAGE_SUFFIXES, read_image
from track_range.foundation.files.input_files import check_regular, counted, read_bytes
from track_range.recording.frame import TIME_EPSILON_S, VideoError, VideoFrame, is_neutral, strictly_later
from track_range.recording.recorded_video import RecordedVideo
from track_range.recording.utc import ZONE_SPAN_S, UtcStart

_MAX_NUMBER = 2**63 - 1  # largest frame number, an int64 like those of results; times in nanoseconds since 1970 fit
_MAX_STAMP_BYTES = 200  # of a line of timestamps.txt
_TIMESTAMPS_NAME = "timestamps.txt"
_TIMESTAMP = re.compile(r"((?:19|20|21)\d\d-\d\d-\d\d)[ T](\d\d:\d\d:\d\d(?:\.\d{1,9})?)")


class UnreadableImageError(VideoError):
    """An image of a folder that cannot be decoded; it is skipped unless it is one of all."""


class ImageFolder(RecordedVideo):
    """Numbered images in one folder, in the order of their numbers; those that cannot be read are skipped.

    `fps` is the argument, or the median rate of timestamps.txt, with which times are seconds since 1970. Raises
    VideoError for no numbered images, two of one number, one that is no regular file, or no readable one.
    """

    path: Path
    n_total: int

    def __init__(self, path: Path, *, fps: float) -> None:
        self.path = path
        self._images = _numbered_images(path)
        self._states = [_state(image) for _, image in self._images]
        self.n_total = len(self._images)
        first, last = self._images[0][0], self._images[-1][0]
        stamps_s, self._folder_notes = _stamps_of(path, self.n_total)
        self._has_stamps = stamps_s is not None
        steps_s = np.diff([] if stamps_s is None else stamps_s)
        steps_s = steps_s[steps_s > TIME_EPSILON_S]
        self.fps = float(1 / np.median(steps_s)) if steps_s.size else fps
        self._times_s = [number / fps for number, _ in self._images] if stamps_s is None else stamps_s.tolist()
        if n_missing := last - first + 1 - self.n_total:
            self._folder_notes.append(
                f"{path}: {counted(n_missing, 'number is', 'numbers are')} missing between "
                f"{self._images[0][1].name} and {self._images[-1][1].name}; treated as dropped frames."
            )
        self._leading: list[VideoError] = []  # errors of unreadable images before the first readable one
        number, image = self._first_readable()
        self.first_time_s = self._times_s[number]
        self.height_px, self.width_px = image.shape[:2]
        self.is_grey, self.first_image = is_neutral(image), image
        self._n_backward = 0
        self._unreadable = self._leading

    @property
    def utc(self) -> UtcStart | None:
        """See `RecordedVideo`."""
        if not self._has_stamps:
            return None
        return UtcStart(self.first_time_s, "timestamps.txt", ZONE_SPAN_S, is_local=True)

    @property
    def notes(self) -> tuple[str, ...]:
        """See `RecordedVideo`."""
        notes, n_unreadable = list(self._folder_notes), len(self._unreadable)
        if n_unreadable:
            notes.append(f"{self.path}: {counted(n_unreadable, 'unreadable image')} skipped: {self._unreadable[0]}")
        if self._n_backward:
            skipped = f"{counted(self._n_backward, 'image')} with a repeated or backward timestamp skipped."
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
        """See `RecordedVideo.check_unchanged`; an image that was still being written may have grown."""
        for (_, path), (n_bytes, modified_ns) in zip(self._images, self._states, strict=True):
            try:
                status = path.stat()
            except OSError:
                continue
            if status.st_size < n_bytes or (status.st_size == n_bytes and status.st_mtime_ns != modified_ns):
                raise VideoError(f"{path}: the image was overwritten while the folder was read; repeat the run.")

    def _first_readable(self) -> tuple[int, Image]:
        """The first image that can be read, and its place in the list; raises the first error if none can."""
        for number, (_, path) in enumerate(self._images):
            try:
                return number, _decoded(path)
            except UnreadableImageError as error:
                self._leading.append(error)
        raise self._leading[0]

    def _image(self, path: Path) -> Image:
        if not path.exists():
            raise VideoError(f"{path}: the image was deleted or moved while the folder was read; repeat the run.")
        image = _decoded(path)
        advice = "a folder must contain the images of one camera"
        self.check_size(image.shape[1::-1], " like the first image", advice, path)
        return image


def _numbered_images(folder: Path) -> list[tuple[int, Path]]:
    """(number, path) of a folder's images, sorted by number; the number is the last one in the file name."""
    try:
        names = list(folder.iterdir())
    except OSError as error:
        raise VideoError(f"{folder}: the folder cannot be read ({describe(error)}); check its permissions.") from error
    entries = [entry for entry in names if entry.suffix.lower() in IMAGE_SUFFIXES and entry.name[0] != "."]
    numbers = ((re.findall(r"\d+", entry.stem), entry) for entry in entries)
    images = sorted((int(digits[-1]), entry) for digits, entry in numbers if digits)
    if not images:
        raise VideoError(
            f"{folder}: expected numbered images (000000.png, 000001.png, ...) or videos, found none; give the "
            "folder that contains them, or a video file."
        )
    if images[-1][0] > _MAX_NUMBER:
        raise VideoError(f"{images[-1][1]}: expected a frame number of at most 19 digits; rename the images.")
    for (number, path), (next_number, next_path) in itertools.pairwise(images):
        if number == next_number:
            raise VideoError(
                f"{folder}: {path.name} and {next_path.name} have the same number {number}; put the images of each "
                "camera in a separate folder."
            )
    return images


def _decoded(path: Path) -> Image:
    """The image of a file as (H, W, 3) uint8 BGR, upright by EXIF; 16-bit images are reduced to their upper 8 bits."""
    image = read_image(
        path, UnreadableImageError, "an image of the folder", flags=cv2.IMREAD_COLOR | cv2.IMREAD_ANYDEPTH
    )
    if image.dtype not in (np.uint8, np.uint16):
        raise VideoError(f"{path}: expected 8- or 16-bit pixels, got {image.dtype}; convert the images.")
    return (image >> 8 if image.dtype == np.uint16 else image).astype(np.uint8, copy=False)


def _state(path: Path) -> tuple[int, int]:
    """Size in bytes and time of the last change in ns of an image; raises VideoError if it is no regular file."""
    try:
        status = path.stat()
    except OSError:
        status = None
    if status is None or not stat.S_ISREG(status.st_mode):
        check_regular(path, VideoError, "an image of the folder")
        status = path.stat()
    return status.st_size, status.st_mtime_ns


def _stamps_of(folder: Path, n_images: int) -> tuple[FloatArray | None, list[str]]:
    """(n_images,) seconds since 1970 from timestamps.txt, None if there is no usable one; and notes for the user."""
    candidates = (parent / _TIMESTAMPS_NAME for parent in (folder, folder.absolute().parent))
    file = next((candidate for candidate in candidates if candidate.is_file()), None)
    if file is None:
        return None, []
    content = read_bytes(file, VideoError, "a date and time per image", max_bytes=_MAX_STAMP_BYTES * (n_images + 1))
    lines = content.decode(errors="replace").split("\n")
    stamps = [line.strip() for line in lines if line.strip()]
    if len(stamps) != n_images:
        n_lines = counted(len(stamps), "line")
        return None, [f"{file}: ignored; it has {n_lines} for {counted(n_images, 'image')}."]
    try:
        dates = [_TIMESTAMP.sub(r"\1T\2", stamp) if _TIMESTAMP.fullmatch(stamp) else "invalid" for stamp in stamps]
        stamps_s = np.array(dates, "datetime64[ns]").astype(np.int64) / 1e9
    except ValueError:
        return None, [f"{file}: ignored; expected a date and time on every line."]
    return stamps_s, [f"{file}: used for the frame times of {folder}."]

"""BoardImages: where the images of a calibration come from: a pattern of files, a folder, a film; of one eye or of two.

'left*.jpg' 'right*.jpg'     partners by what the stars stand for
left/ right/                 partners by name, else by the last number in it, else by order
left.mp4 right.mp4           partners by time; a few frames per second are looked at
"""

from __future__ import annotations

import glob
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from pathlib import Path

from track_range.detection.formats.labelled_images import IMAGE_SUFFIXES, ImageFileError, images_in, read_image
from track_range.foundation.arrays import Image
from track_range.stereo.calibration.board_views import RejectedView
from track_range.video.frame import TIME_EPSILON_S
from track_range.video.pairing import StereoVideo
from track_range.video.reader import VideoReader

_LOOKS_PER_FILM = 300
_SHORTEST_STEP_S = 0.2
"""Between frames that are looked at: a board held by hand hardly moves in less."""

_WILD = re.compile(r"[*?\[]")

Key = Callable[[Path], str]


@dataclass(frozen=True, slots=True)
class Shot:
    """What one eye, or both at one instant, saw.

    Attributes:
        names: of the images, one per eye.
        images: one per eye; None where it cannot be read.
    """

    names: tuple[str, ...]
    images: tuple[Image | None, ...]


@dataclass(frozen=True, slots=True)
class Photographs:
    """Files of images, one tuple of paths per shot."""

    paths: tuple[tuple[Path, ...], ...]
    left_out: tuple[RejectedView, ...] = ()
    is_film: bool = field(default=False, init=False)

    @property
    def n_shots(self) -> int:
        """How many there are."""
        return len(self.paths)

    @property
    def files(self) -> tuple[Path, ...]:
        """What is read."""
        return tuple(chain.from_iterable(self.paths))

    def __iter__(self) -> Iterator[Shot]:
        """Each shot as it is read; images that cannot be are None."""
        for paths in self.paths:
            alike = len({path.name for path in paths}) < len(paths)
            yield Shot(
                tuple(_name(path, with_folder=alike) for path in paths), tuple(_readable(path) for path in paths)
            )


class Film:
    """Every so many frames of a video, or of two in step.

    Attributes:
        files: what is read.
        n_shots: how many frames will be looked at; None = unknown.
        is_film: that they are frames, most of which may show no board.
        left_out: none, before they are looked at.

    Raises:
        VideoError: a video cannot be read.
    """

    def __init__(self, paths: Sequence[Path]) -> None:
        self.files = tuple(paths)
        self._readers = [VideoReader(path) for path in paths]
        first = self._readers[0]
        length_s = (first.n_frames or 0) / first.fps
        self._step_s = max(_SHORTEST_STEP_S, length_s / _LOOKS_PER_FILM)
        self.n_shots: int | None = int(length_s / self._step_s) + 1 if first.n_frames else None
        self.is_film = True
        self.left_out: tuple[RejectedView, ...] = ()

    def __iter__(self) -> Iterator[Shot]:
        """Frames at least a step apart, named by their times."""
        next_s = -float("inf")
        for time_s, images in self._frames():
            if time_s >= next_s - TIME_EPSILON_S:
                next_s = time_s + self._step_s
                yield Shot(tuple(f"{reader.path.name} at {time_s:.2f} s" for reader in self._readers), images)

    def _frames(self) -> Iterator[tuple[float, tuple[Image, ...]]]:
        if len(self._readers) == 1:
            for frame in self._readers[0]:
                yield frame.time_s, (frame.image,)
            return
        for left, right in StereoVideo(self._readers[0], self._readers[1]):
            yield left.time_s, (left.image, right.image)


BoardImages = Photographs | Film
"""Shots to look for boards in, again and again."""


def board_images(sources: Sequence[str]) -> BoardImages:
    """The images of one source, or of two of which each has one eye's.

    Raises:
        ImageFileError: a pattern or folder without images, one source of each kind, or no way to tell partners.
        VideoError: a film cannot be read.
    """
    films = [_is_film(source) for source in sources]
    if all(films):
        return Film([Path(source) for source in sources])
    if any(films):
        raise ImageFileError(f"{sources[0]} and {sources[1]}: give two videos, or two sets of images.")
    found = [_files(source) for source in sources]
    if len(found) == 1:
        return Photographs(tuple((path,) for path in found[0]))
    return _partners(sources, found)


def _is_film(source: str) -> bool:
    path = Path(source)
    return path.is_file() and path.suffix.lower() not in IMAGE_SUFFIXES


def _files(source: str) -> list[Path]:
    """The images that a pattern or a folder means, by the numbers in their names."""
    path = Path(source)
    if path.is_dir():
        return sorted(images_in(path), key=_natural)
    if path.is_file():
        raise ImageFileError(
            f"{source}: one image is no set; give a pattern such as 'boards/*.jpg' in quotes, or a folder."
        )
    found = [Path(name) for name in glob.glob(source, recursive=True)]
    images = [each for each in found if each.is_file() and each.suffix.lower() in IMAGE_SUFFIXES]
    if not images:
        why = "no image has such a name" if _WILD.search(source) else "there is no such file or folder"
        raise ImageFileError(f"{source}: {why}; give a pattern such as 'boards/*.jpg' in quotes, a folder or a video.")
    return sorted(images, key=_natural)


def _natural(path: Path) -> list[tuple[int, str]]:
    """Sorts img2 before img10."""
    return [(int(part), "") if part.isdecimal() else (-1, part) for part in re.split(r"(\d+)", str(path))]


def _partners(sources: Sequence[str], found: Sequence[list[Path]]) -> Photographs:
    """Left and right images of one instant, told by their names; those without a partner are left out."""
    for keys in _ways_to_pair(sources):
        named = [{key(path): path for path in paths} for key, paths in zip(keys, found, strict=True)]
        common = [key for key in named[0] if key in named[1]]
        is_unique = all(len(each) == len(paths) for each, paths in zip(named, found, strict=True))
        if is_unique and common:
            alone = [path for eye in (0, 1) for key, path in named[eye].items() if key not in named[1 - eye]]
            alike = any(named[0][key].name == named[1][key].name for key in common)
            reason = "the other eye's image is missing"
            left_out = tuple(RejectedView(_name(path, with_folder=alike), reason) for path in alone)
            return Photographs(tuple((named[0][key], named[1][key]) for key in common), left_out)
    if len(found[0]) != len(found[1]):
        raise ImageFileError(
            f"{sources[0]} has {len(found[0])} images and {sources[1]} {len(found[1])}, and their names do not tell "
            "which belong together; number both alike."
        )
    return Photographs(tuple(zip(found[0], found[1], strict=True)))


def _ways_to_pair(sources: Sequence[str]) -> list[tuple[Key, Key]]:
    ways: list[tuple[Key, Key]] = []
    if all(_WILD.search(source) for source in sources):
        ways.append((_wildcard_key(sources[0]), _wildcard_key(sources[1])))
    return [*ways, (_stem, _stem), (_last_number, _last_number)]


def _wildcard_key(pattern: str) -> Key:
    """What the pattern's stars and marks stand for in a path."""
    parts = re.split(r"(\*\*/|\*|\?|\[[^\]]*\])", str(Path(pattern)))
    meaning = {"**/": "(.*)", "*": "([^/]*)", "?": "(.)"}
    form = re.compile("".join(meaning.get(part, f"({part})" if part[:1] == "[" else re.escape(part)) for part in parts))

    def key(path: Path) -> str:
        match = form.fullmatch(str(path))
        return str(path) if match is None else "|".join(match.groups())

    return key


def _stem(path: Path) -> str:
    return path.stem


def _last_number(path: Path) -> str:
    digits = re.findall(r"\d+", path.stem)
    return str(int(digits[-1])) if digits else path.stem


def _name(path: Path, *, with_folder: bool) -> str:
    """For the user; with its folder where left and right are called alike."""
    return f"{path.parent.name}/{path.name}" if with_folder else path.name


def _readable(path: Path) -> Image | None:
    try:
        return read_image(path)
    except ImageFileError:
        return None

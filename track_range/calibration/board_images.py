"""BoardImages: the images for a calibration, from a pattern of file names, a folder or a video, of
one or two cameras.

Left and right images are paired as follows:

'left*.jpg' 'right*.jpg'     by the text that the wildcards match
left/ right/                 by name, else by the last number in the name, else by order
left.mp4 right.mp4           by time; a few frames per second are used
"""

import glob
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, ClassVar

from track_range.detection.formats.image_labels.labelled_images import (
    ImageFileError,
    images_in,
    read_image,
)
from track_range.foundation.arrays import Image
from track_range.foundation.files.images import IMAGE_SUFFIXES
from track_range.recording.pairs.packed_pair import PackedPair, pair_in
from track_range.recording.pairs.recorded_pair import RecordedPair
from track_range.recording.pairs.stereo_layout import find_layout, matching_halves
from track_range.recording.sources.names import source_of
from track_range.recording.sources.open_video import open_video
from track_range.recording.sources.video_half import image_half
from track_range.recording.video.file_names import natural_key
from track_range.recording.video.frame import TIME_EPSILON_S, VideoFrame
from track_range.recording.video.layouts import LayoutOption, StereoLayout
from track_range.stereo.calibration.board_views import RejectedView

_MAX_VIDEO_SHOTS = 300  # largest number of frames of a video that are searched for boards
# minimum time between these frames, s; a hand-held board hardly moves in a shorter time
_SHORTEST_STEP_S = 0.2

_N_COMPARED = 5  # number of images whose halves are compared, until two match
_MIN_ASPECT = 2.4  # width / height of images that can only be two beside each other

_WILDCARD = re.compile(r"[*?\[]")

# function that returns the same text for the paths of the left and right image of a pair
Key = Callable[[Path], str]


@dataclass(frozen=True, slots=True)
class Shot:
    """The image of one camera, or the images of both at the same time."""

    names: tuple[str, ...]  # names of the images, one per camera
    images: tuple[Image | None, ...]  # the images, one per camera; None = unreadable


@dataclass(frozen=True, slots=True)
class ImageFiles:
    """Shots from image files."""

    paths: tuple[tuple[Path, ...], ...]  # one tuple of paths per shot, with one path per camera
    unpaired: tuple[RejectedView, ...] = ()  # images without a counterpart from the other camera
    # of the images of two cameras in each file; None = one camera per file
    layout: StereoLayout | None = None
    is_video: ClassVar[bool] = False

    @property
    def n_shots(self) -> int:
        """Number of shots."""
        return len(self.paths)

    @property
    def files(self) -> tuple[Path, ...]:
        """The files that are read."""
        return tuple(chain.from_iterable(self.paths))

    def __iter__(self) -> Iterator[Shot]:
        """The shots, read one by one."""
        for paths in self.paths:
            is_ambiguous = len({path.name for path in paths}) < len(paths)
            names = tuple(_name(path, with_folder=is_ambiguous) for path in paths)
            images = tuple(_readable(path) for path in paths)
            if (layout := self.layout) is not None:
                halves = [
                    image if image is None else image_half(layout, image, is_right=bool(side))
                    for side, image in enumerate(images * 2)
                ]
                names, images = names * 2, tuple(halves)
            yield Shot(names, images)


class VideoShots:
    """Shots from a video, or from two synchronised videos, at regular intervals; VideoError for an
    unreadable video.
    """

    is_video: ClassVar[bool] = True  # many frames of a video may not show the board
    unpaired: tuple[RejectedView, ...] = ()

    def __init__(self, paths: Sequence[Path], layout: LayoutOption = "auto") -> None:
        self.files = tuple(paths)
        self._pair: PackedPair | RecordedPair | None = None
        self._first = first = open_video(paths[0])
        if len(paths) > 1 and paths[0] == paths[1]:
            self._pair = pair_in(first, source_of(paths[0]), find_layout(first, layout).layout)
        elif len(paths) > 1:
            self._pair = RecordedPair(first, open_video(paths[1], left=first))
        length_s = (first.n_frames or 0) / first.fps
        self._step_s = max(_SHORTEST_STEP_S, length_s / _MAX_VIDEO_SHOTS)
        # estimate
        self.n_shots: int | None = int(length_s / self._step_s) + 1 if first.n_frames else None

    def __iter__(self) -> Iterator[Shot]:
        """Shots at least one step apart, named by their times."""
        next_s = -float("inf")
        shots: Iterable[tuple[VideoFrame, ...]] = (
            zip(self._first) if self._pair is None else self._pair
        )
        for frames in shots:
            time_s = frames[0].time_s
            if time_s >= next_s - TIME_EPSILON_S:
                next_s = time_s + self._step_s
                names = (f"{path.name} at {time_s:.2f} s" for path in self.files)
                yield Shot(tuple(names), tuple(frame.image for frame in frames))


BoardImages = ImageFiles | VideoShots  # source of shots, which can be iterated more than once


def board_images(sources: Sequence[str], layout: LayoutOption = "auto") -> BoardImages:
    """The images of one camera from one source, or of two cameras from two sources (equal if images
    have a `layout`).

    Raises ImageFileError for a pattern or folder without images, sources of different kinds, or
    images that cannot be paired, and VideoError if a video cannot be read.
    """
    are_videos = [_is_video(source) for source in sources]
    if all(are_videos):
        return VideoShots([Path(source) for source in sources], layout)
    if any(are_videos):
        raise ImageFileError(
            f"{sources[0]} and {sources[1]}: expected two videos, or two sets of images."
        )
    files = [_files(source) for source in sources]
    if len(files) == 1:
        return ImageFiles(tuple((path,) for path in files[0]))
    if sources[0] == sources[1]:
        return ImageFiles(
            tuple((path,) for path in files[0]), layout=_layout(sources[0], files[0], layout)
        )
    return _paired(sources, files)


def _layout(source: str, files: Sequence[Path], layout: LayoutOption) -> StereoLayout:
    """The layout of images of two cameras; wide images are taken as side by side, as few points of
    boards match.
    """
    if layout != "auto" and layout != "tracks":
        return layout
    paths = files[:_N_COMPARED] if layout == "auto" else ()
    images = [image for path in paths if (image := _readable(path)) is not None]
    if (
        matched := next(filter(None, (matching_halves([image]) for image in images)), None)
    ) is not None:
        return matched.layout
    if images and images[0].shape[1] >= _MIN_ASPECT * images[0].shape[0]:
        return "side-by-side"
    raise ImageFileError(
        f"{source}: expected images of both cameras in each file, found no two halves that match; "
        "give the images of the right camera as well, or --stereo-layout side-by-side, right-left, "
        "top-bottom or bottom-top (Python: stereo_layout)."
    )


def _is_video(source: str) -> bool:
    path = Path(source)
    return path.exists() and not path.is_dir() and path.suffix.lower() not in IMAGE_SUFFIXES


def _files(source: str) -> list[Path]:
    """The images of a folder or matching a pattern, sorted by the numbers in their names."""
    path = Path(source)
    if path.is_dir():
        return sorted(images_in(path), key=lambda image: natural_key(str(image)))
    if path.is_file():
        raise ImageFileError(
            f"{source}: expected several images, got one; give a pattern such as 'boards/*.jpg' in "
            "quotes, or a folder."
        )
    matches = [Path(name) for name in glob.glob(source, recursive=True)]
    images = [path for path in matches if path.is_file() and path.suffix.lower() in IMAGE_SUFFIXES]
    if not images:
        reason = (
            "no image has a matching name" if _WILDCARD.search(source) else "no such file or folder"
        )
        raise ImageFileError(
            f"{source}: {reason}; give a pattern such as 'boards/*.jpg' in quotes, a folder or a "
            "video."
        )
    return sorted(images, key=lambda image: natural_key(str(image)))


def _paired(sources: Sequence[str], files: Sequence[list[Path]]) -> ImageFiles:
    """Left and right images paired by name, or by order if their names have nothing in common."""
    tried: list[tuple[Key, Key]] = [(lambda path: path.stem,) * 2, (_last_number, _last_number)]
    if all(_WILDCARD.search(source) for source in sources):
        tried.insert(0, (_wildcard_key(sources[0]), _wildcard_key(sources[1])))
    for left_key, right_key in tried:
        left = {left_key(path): path for path in files[0]}
        right = {right_key(path): path for path in files[1]}
        is_unique = len(left) == len(files[0]) and len(right) == len(files[1])
        if is_unique and not left.keys().isdisjoint(right):
            return _paired_by_key(left, right)
    if len(files[0]) != len(files[1]):
        raise ImageFileError(
            f"{sources[0]} has {len(files[0])} images and {sources[1]} {len(files[1])}, and they "
            "cannot be paired by name; give matching images the same number."
        )
    return ImageFiles(tuple(zip(files[0], files[1], strict=True)))


def _paired_by_key(left: Mapping[Any, Path], right: Mapping[Any, Path]) -> ImageFiles:
    """The pairs with a common key, and the images without a partner."""
    common = [key for key in left if key in right]
    alone = [path for key, path in left.items() if key not in right]
    alone += [path for key, path in right.items() if key not in left]
    is_ambiguous = any(left[key].name == right[key].name for key in common)
    reason = "the other camera's image is missing"
    unpaired = [RejectedView(_name(path, with_folder=is_ambiguous), reason) for path in alone]
    return ImageFiles(tuple((left[key], right[key]) for key in common), tuple(unpaired))


def _wildcard_key(pattern: str) -> Key:
    """Function that returns the parts of a path that match the wildcards of `pattern`, joined."""
    parts = re.split(r"(\*\*/|\*|\?|\[[^\]]*\])", str(Path(pattern)))
    groups = {"**/": "(.*)", "*": "([^/]*)", "?": "(.)"}
    regex = re.compile(
        "".join(
            groups.get(part, f"({part})" if part[:1] == "[" else re.escape(part)) for part in parts
        )
    )

    def key(path: Path) -> str:
        match = regex.fullmatch(str(path))
        return str(path) if match is None else "|".join(match.groups())

    return key


def _last_number(path: Path) -> str:
    digits = re.findall(r"\d+", path.stem)
    return str(int(digits[-1])) if digits else path.stem


def _name(path: Path, *, with_folder: bool) -> str:
    """Name of an image for the user, with its folder if left and right have equal names."""
    return f"{path.parent.name}/{path.name}" if with_folder else path.name


def _readable(path: Path) -> Image | None:
    try:
        return read_image(path)
    except ImageFileError:
        return None

"""BoxTable: the boxes of one video with classes, identities and distances, for label files of every
format.

Boxes have track-range's convention: frames from 0, pixel centres at integers, outer edges of the
box. The corner convention of COCO, CVAT and YOLO, where the left edge of the image is 0, is larger
by half a pixel (`boxes.HALF_PIXEL_PX`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any, NamedTuple, TypedDict, Unpack

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASSES, is_region_name, map_to_road_classes
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape


@dataclass(frozen=True, slots=True)
class VideoFacts:
    """Properties of the video that a label file belongs to; None = unknown."""

    name: str = ""  # name of the video or sequence; "" = unknown
    n_frames: int | None = None
    # number of the first frame that has labels if there are any objects in it; for a reader: of the
    # video, if not 0
    first_frame: int = 0
    size_px: tuple[int, int] | None = None  # (width, height) of its images
    fps: float | None = None
    # boxes are in rectified pixels, as in the results of a run, not in those of the video
    is_rectified: bool = False
    # program, model, ..., for metadata of files
    provenance: Mapping[str, str] = field(default_factory=dict)
    # numbers of the frames that a written file lists; None = all
    frames: Sequence[int] | None = None
    # names of class numbers, from 0, where a file has numbers only; () = not given
    names: tuple[str, ...] = ()

    @property
    def pixels(self) -> str:
        """Text for `is_rectified` in written files."""
        return "rectified" if self.is_rectified else "original"

    def completed_by(self, stated: VideoFacts, path: Path) -> VideoFacts:
        """These properties, completed by properties from a file; LabelFileError if its images have
        another size.
        """
        if stated.size_px is not None and self.size_px not in (None, stated.size_px):
            video_size, file_size = (
                "x".join(map(str, size or ())) for size in (self.size_px, stated.size_px)
            )
            raise LabelFileError(
                f"{path}: expected boxes in images of {video_size} px as in the video, found "
                f"{file_size} px."
            )
        return VideoFacts(
            name=self.name or stated.name,
            n_frames=self.n_frames or stated.n_frames,
            first_frame=stated.first_frame,
            size_px=self.size_px or stated.size_px,
            fps=self.fps or stated.fps,
            is_rectified=self.is_rectified or stated.is_rectified,
            provenance=self.provenance,
            names=self.names,
        )


NO_FACTS = VideoFacts()
_MAX_NAME_BYTES = 100  # of a video's name in file names, which have at most 255


def file_name_part(name: str) -> str:
    """A name as part of a file name: letters, digits and "-_." only, so that no name leads to
    another folder.
    """
    safe = "".join(
        character if character.isalnum() or character in "-_." else "_" for character in name
    )
    return safe.lstrip(".").encode()[:_MAX_NAME_BYTES].decode(errors="ignore")


def image_name(video: VideoFacts, frame: int) -> str:
    """File name of a frame's image: NAME_000000.jpg, without a folder."""
    return f"{file_name_part(video.name) or 'frame'}_{frame:06}.jpg"


class Written(NamedTuple):
    """Result of writing a table: the number of boxes in the file, and notes for the user on omitted
    content.
    """

    n_boxes: int
    notes: tuple[str, ...] = ()


class OptionalColumns(TypedDict, total=False):
    """Columns of `BoxTable` that not all formats have."""

    score: npt.ArrayLike  # NaN by default, as the distances
    observed: npt.ArrayLike  # True by default
    distance_m: npt.ArrayLike
    sigma_m: npt.ArrayLike
    location_m: npt.ArrayLike


@dataclass(frozen=True, slots=True)
class BoxTable:
    """The N boxes of one video, sorted by frame, then by identity."""

    frame: IntArray  # (N,) int64 frame number from 0
    track_id: IntArray  # (N,) int64 identity from 0; -1 = no identity
    # (N,) str class in the file, in lower case; "" = the format has no classes
    class_name: npt.NDArray[np.str_]
    # (N,) int64 road class; -1 = not a road class, or a region that is not evaluated
    class_id: IntArray
    xyxy_px: FloatArray  # (N, 4) float64
    score: FloatArray  # (N,) float64 confidence; NaN = unknown
    observed: BoolArray  # (N,) bool, False where the box is predicted or interpolated
    # (N,) float64 z of the visible surface in the camera's frame; NaN = unknown
    distance_m: FloatArray
    sigma_m: FloatArray  # (N,) float64 standard deviation of the distance; NaN = unknown
    # (N, 3) float64 bottom centre of the object in the camera's frame; NaN = unknown
    location_m: FloatArray
    # (N,) bool, regions that are not evaluated: they have neither a road class nor an identity
    is_region: BoolArray
    video: VideoFacts = NO_FACTS
    notes: tuple[str, ...] = ()  # notes for the user about the file

    def __post_init__(self) -> None:
        n = len(self.frame)
        for name in _COLUMNS:
            shape = {"xyxy_px": (n, 4), "location_m": (n, 3)}.get(name, (n,))
            check_shape(name, getattr(self, name), shape)

    def __len__(self) -> int:
        return len(self.frame)

    @classmethod
    def of(
        cls,
        frame: npt.ArrayLike,
        track_id: npt.ArrayLike,
        class_name: Sequence[str],
        xyxy_px: npt.ArrayLike,
        *,
        is_region: npt.ArrayLike = False,
        video: VideoFacts = NO_FACTS,
        notes: Sequence[str] = (),
        **columns: Unpack[OptionalColumns],
    ) -> BoxTable:
        """A table from arrays or lists with rows in any order, or from one value for all rows.

        Rows of `is_region` (N,), or of a class such as DontCare, are regions that are not
        evaluated. Distances that are not positive are unknown.
        """
        frames = np.asarray(frame, np.int64).reshape(-1)
        n = len(frames)
        names = [name.strip().lower() for name in class_name]
        is_named = np.array([is_region_name(name) for name in names], np.bool_)
        region = _column(is_region, np.bool_, n) | is_named
        distance_m = _column(columns.get("distance_m", np.nan), np.float64, n)
        table = cls(
            frame=frames,
            track_id=np.where(region, -1, np.asarray(track_id, np.int64).reshape(-1)),
            class_name=np.array(names, np.str_) if names else np.zeros(0, np.str_),
            class_id=np.where(region, -1, map_to_road_classes(names)),
            xyxy_px=np.asarray(xyxy_px, np.float64).reshape(-1, 4),
            score=_column(columns.get("score", np.nan), np.float64, n),
            observed=_column(columns.get("observed", True), np.bool_, n),
            distance_m=np.where(distance_m > 0, distance_m, np.nan),
            sigma_m=_column(columns.get("sigma_m", np.nan), np.float64, n),
            location_m=_column(columns.get("location_m", np.nan), np.float64, n, 3),
            is_region=region,
            video=video,
            notes=tuple(notes),
        )
        return table.select(np.lexsort((table.track_id, table.frame)))

    @property
    def label(self) -> list[str]:
        """(N,) class name for formats in which each box has one: "object" if it is unknown."""
        return [str(name) or "object" for name in self.class_name]

    @property
    def all_labels(self) -> list[str]:
        """Names of the classes in written files, in the order of their numbers: the road classes,
        then other names.
        """
        return list(dict.fromkeys((*ROAD_CLASSES, *sorted(set(self.label)))))

    def select(self, rows: BoolArray | IntArray) -> BoxTable:
        """The rows that a mask or an index array selects, in its order."""
        columns: dict[str, Any] = {name: getattr(self, name)[rows] for name in _COLUMNS}
        return replace(self, **columns)

    def with_class(self, class_id: int) -> BoxTable:
        """The table with a road class for the rows without a class name."""
        is_empty = self.class_name == ""
        names = np.where(is_empty, ROAD_CLASSES[class_id], self.class_name)
        return replace(self, class_name=names, class_id=np.where(is_empty, class_id, self.class_id))


_COLUMNS = tuple(
    column.name for column in fields(BoxTable) if column.name not in ("video", "notes")
)


def _column(values: npt.ArrayLike, dtype: type, *shape: int) -> npt.NDArray[Any]:
    array: npt.NDArray[Any] = np.asarray(values, dtype)
    return array.reshape(shape) if array.ndim else np.full(shape, array)


def frames_listed(table: BoxTable) -> Sequence[int]:
    """Numbers of the frames that a written file lists, by default from the first labelled frame to
    the last frame.
    """
    if table.video.frames is not None:
        return table.video.frames
    n_frames = max(table.video.n_frames or 0, int(table.frame.max(initial=-1)) + 1)
    return range(min([table.video.first_frame, *table.frame[:1].tolist()]), n_frames)

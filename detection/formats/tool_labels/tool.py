"""Tool: the names that an annotation tool gives to the values of a box, and their units.

A name is a path in the object of a box and in what encloses it, which the tool's `objects` lists:
`shape.label` is the label of the shape. Where a tool has several names for a value, they are
separated by spaces, and the first that is present counts.
"""

import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from typing import Any, NamedTuple

import numpy as np

from track_range.detection.formats.tables.errors import LabelFileError

Object = Mapping[str, Any]  # of a file; or the object of a box, and what encloses it, by name
EdgesOf = Callable[[Object], Sequence[float]]  # left, top, right, bottom of an object

MAX_BOXES = 2_000_000  # of a file or folder, also of interpolated boxes
_MAX_TEXT = 200  # characters of a label


class ToolBox(NamedTuple):
    """One box in a file."""

    image: int | str  # frame number from 0, or the name of an image; "" = the file's image
    label: str
    edges: Sequence[float]  # left, top, right, bottom in pixels, corner convention
    identity: object = None
    score: object = None
    is_region: bool = False
    size_px: tuple[object, ...] = ()  # width and height of the image
    rotation: object = None  # of a box that is not upright
    video: object = None  # name of its video or camera
    shape: str = "box"  # or what has no width and height, such as a point
    distance_m: object = None  # of its visible surface
    sigma_m: object = None
    is_predicted: bool = False  # without a detection in its frame


@dataclass(frozen=True, slots=True, kw_only=True)
class Tool:
    """An annotation tool or data set: how its files are recognised, and how they name values."""

    name: str  # on the command line
    title: str  # for messages
    mark: re.Pattern[str]  # what the first 64 kB of a file match
    # the objects of all boxes in the content of a file, each with what encloses it
    objects: Callable[[Any], Iterable[Object]]
    label: str
    edges: EdgesOf
    is_per_cent: bool = False  # whether edges are in per cent of the image's size, not in pixels
    frame: str = ""  # number of the frame
    first_frame: int = 0  # number of the first frame
    image: str = ""  # name of the image, if there is no frame number; none = the file's name
    identity: str = ""
    score: str = ""
    is_region: str = ""  # of a flag of regions that are not evaluated
    size_px: tuple[str, str] | None = None  # width and height of the image
    rotation: str = ""  # angle of a box about its centre or a corner
    video: str = ""  # name of the video of a frame, of which a file may have several
    is_folder: bool = False  # whether a folder with one file for each image is read, too

    def box(self, item: Object) -> ToolBox:
        """The box of an object, of size 0 for a shape that is none, whose kind is `no_box`.

        LookupError, TypeError or ValueError without valid values.
        """
        size_px = tuple(value_at(item, name) for name in self.size_px or ())
        edges = (0.0,) * 4 if "no_box" in item else self.edges(item)
        if self.is_per_cent:
            edges = _in_pixels(edges, size_px)
        return ToolBox(
            self._image(item),
            _label(required_at(item, self.label)),
            edges,
            value_at(item, self.identity),
            value_at(item, self.score),
            value_at(item, self.is_region) is True,
            size_px,
            value_at(item, self.rotation),
            value_at(item, self.video),
            str(item.get("no_box", "box"))[:_MAX_TEXT],
        )

    def _image(self, item: Object) -> int | str:
        frame = value_at(item, self.frame)
        if frame is not None:
            return whole(frame) - self.first_frame
        image = value_at(item, self.image)
        if not isinstance(image, str | None):
            raise TypeError(type(image).__name__)
        return image or ""


@cache
def _paths(names: str) -> tuple[tuple[str, ...], ...]:
    return tuple(tuple(name.split(".")) for name in names.split())


def _values_at(item: Object, names: str) -> Iterator[Any]:
    """The value of each name that is present."""
    for path in _paths(names):
        value: Any = item
        for key in path:
            if isinstance(value, list):  # of elements of XML, of which the first counts
                value = next(iter(value), None)
            if not isinstance(value, Mapping) or key not in value:
                break
            value = value[key]
        else:
            yield value


def value_at(item: Object, names: str) -> Any:
    """The value of the first name that is present; None if there is none."""
    return next(_values_at(item, names), None)


def required_at(item: Object, names: str) -> Any:
    """The value of the first name that is present; KeyError if there is none."""
    for value in _values_at(item, names):
        return value
    raise KeyError(names)


def whole(value: Any) -> int:
    """An integer from a number or text; ValueError for other values."""
    if isinstance(value, bool) or not float(value).is_integer():
        raise ValueError(value)
    return int(float(value))


def _label(value: object) -> str:
    """A label, which may be a choice such as {"car": true, "bus": false}."""
    if isinstance(value, Mapping):
        value = next((key for key, is_chosen in value.items() if is_chosen), "")
    return str(value)[:_MAX_TEXT]


def _in_pixels(edges: Sequence[float], size_px: Sequence[Any]) -> list[float]:
    if None in size_px:
        raise LabelFileError("expected original_width and original_height, found none")
    width, height = (float(side) / 100 for side in size_px)
    return [edge * side for edge, side in zip(edges, (width, height) * 2, strict=True)]


# -- edges


def _numbers(item: Object, parent: str, names: str) -> list[float]:
    return [float(required_at(item, f"{parent}.{name}".lstrip("."))) for name in names.split()]


def corners(parent: str, names: str = "xmin ymin xmax ymax") -> EdgesOf:
    """Edges given as left, top, right, bottom."""
    return lambda item: _numbers(item, parent, names)


def sized(parent: str, names: str = "x y width height") -> EdgesOf:
    """Edges of a box given as left, top, width, height."""

    def edges(item: Object) -> list[float]:
        left, top, width, height = _numbers(item, parent, names)
        return [left, top, left + width, top + height]

    return edges


def centred(parent: str, names: str = "x y width height") -> EdgesOf:
    """Edges of a box given as centre, width, height."""

    def edges(item: Object) -> list[float]:
        x, y, width, height = _numbers(item, parent, names)
        return [x - width / 2, y - height / 2, x + width / 2, y + height / 2]

    return edges


def around(names: str, *, border_px: float = 0.0) -> EdgesOf:
    """Edges around points (N, 2); `border_px` is 1 if the last pixel is stated instead of the edge
    behind it.
    """

    def edges(item: Object) -> list[float]:
        points = np.array(required_at(item, names), np.float64).reshape(-1, 2)
        return [*points.min(axis=0).tolist(), *(points.max(axis=0) + border_px).tolist()]

    return edges


def one_of(**edges: EdgesOf) -> EdgesOf:
    """Edges by the first of these values that an object has."""
    return lambda item: next(edges_of(item) for name, edges_of in edges.items() if name in item)

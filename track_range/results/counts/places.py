"""Lines and zones in the image at which road users are counted, from texts such as north=300,520,980,540."""

from collections import Counter as Tally
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted


@dataclass(frozen=True, slots=True)
class Place:
    """A line (two points) or a zone (a polygon) in px of the video."""

    name: str
    xy_px: FloatArray  # (2, 2) ends of a line; (M, 2) corners of a zone
    is_zone: bool

    def inside_px(self, at_px: FloatArray) -> FloatArray:
        """(N,) distances in px of points (N, 2) from the border of a zone, positive = inside, or
        from a line, positive = to the right of the way from its first to its second end; NaN for
        NaN.
        """
        if not self.is_zone:
            along = self.xy_px[1] - self.xy_px[0]
            away = at_px - self.xy_px[0]
            cross = along[0] * away[:, 1] - along[1] * away[:, 0]
            return np.asarray(cross / np.linalg.norm(along))
        start, end = self.xy_px, np.roll(self.xy_px, -1, axis=0)
        edge, away = end - start, at_px[:, None] - start
        share = np.clip((away * edge).sum(axis=2) / (edge**2).sum(axis=1), 0.0, 1.0)
        distance = np.linalg.norm(away - share[:, :, None] * edge, axis=2).min(axis=1)
        y = at_px[:, 1:]
        spans = (start[:, 1] > y) != (end[:, 1] > y)
        rise = np.where(edge[:, 1] == 0, 1.0, edge[:, 1])
        x = start[:, 0] + (y - start[:, 1]) / rise * edge[:, 0]
        is_inside = (spans & (at_px[:, :1] < x)).sum(axis=1) % 2 == 1
        return np.asarray(np.where(is_inside, distance, -distance))

    def crosses(self, from_px: FloatArray, to_px: FloatArray) -> bool:
        """Whether the way between two points (2,) meets a line between its ends; every way meets
        the border of a zone that it enters or leaves.
        """
        if self.is_zone:
            return True
        first, second = self.inside_px(np.array([from_px, to_px])).tolist()
        meets_px = from_px + (to_px - from_px) * first / (first - second)
        along = self.xy_px[1] - self.xy_px[0]
        return bool(0.0 <= (meets_px - self.xy_px[0]) @ along <= along @ along)

    def direction(self, is_right: bool) -> str:
        """Direction of a crossing in the image: up, down, left or right, whichever is nearest."""
        x, y = (self.xy_px[1] - self.xy_px[0]).tolist()
        across = (-y, x) if is_right else (y, -x)
        if abs(across[0]) > abs(across[1]):
            return "right" if across[0] > 0 else "left"
        return "down" if across[1] > 0 else "up"


def check_inside(places: Sequence[Place], size_px: tuple[int, int]) -> None:
    """UsageError for lines and zones outside of a video of this size, which would count nothing or
    elsewhere.
    """
    for place in places:
        if ((place.xy_px < -1) | (place.xy_px > size_px)).any():
            width, height = size_px
            raise UsageError(
                f"line or zone {place.name}: expected pixels inside the video of {width}x{height} px, "
                "found others."
            )


def parsed_places(lines: Sequence[str], zones: Sequence[str]) -> tuple[Place, ...]:
    """Lines and zones of the options --count-line and --zone; ValueError for other texts."""
    places = [_line(text) for text in lines] + [_zone(text) for text in zones]
    for name, n in Tally(place.name for place in places).items():
        if n > 1:
            raise ValueError(f"expected different names of lines and zones, found {name} twice")
    return tuple(places)


def _line(text: str) -> Place:
    name, xy_px = _numbers(text)
    if not name or len(xy_px) != 2 or not np.ptp(xy_px, axis=0).any():
        raise ValueError(
            f"--count-line {quoted(text)}: expected NAME=X1,Y1,X2,Y2 in px of the video"
        )
    return Place(name, xy_px, is_zone=False)


def _zone(text: str) -> Place:
    name, xy_px = _numbers(text)
    if not name or len(xy_px) < 3 or not np.ptp(xy_px, axis=0).all():
        raise ValueError(
            f"--zone {quoted(text)}: expected NAME=X1,Y1,X2,Y2,X3,Y3,... in px of the video"
        )
    return Place(name, xy_px, is_zone=True)


def _numbers(text: str) -> tuple[str, FloatArray]:
    """The name and the points (N, 2) of a text; none of a text with other values."""
    name, _, numbers = text.partition("=")
    try:
        values = np.array([float(part) for part in numbers.split(",")])
    except ValueError:
        values = np.zeros(0)
    if len(values) % 2 or not np.isfinite(values).all():
        values = np.zeros(0)
    return name.strip(), values.reshape(-1, 2)

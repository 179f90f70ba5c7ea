"""RangingMethod: everything the program knows of one way to measure distance, and the registry of all of them.

A method is one file with a `Ranger` and one `RangingMethod` that describes it. The pipeline, the columns of the
results, fusion, filters, overlay, tables, report and `evaluate ranges` iterate over the registry; none of them names a
method.
Packages outside of track-range register theirs through the entry point group `track_range.ranging_methods`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

SourceName = Literal["size", "box_height", "contact_point", "horizon", "baseline", "lane_width", "own"]
"""What a distance error comes from.

size: the object is taller or shorter than its class; box_height: the height of the box in the image; contact_point: the
row where the box meets the ground; horizon: pitch of the camera and slope of the road; baseline: the rig's geometry;
lane_width: the width of the lane; own: what no other method has any part of.
"""

Requirement = Literal["rig", "right_image", "dense_disparity", "lane_lines", "camera_height"]
"""What a method cannot do without."""


@dataclass(frozen=True, slots=True)
class ErrorSource:
    """One part of a method's variance.

    Attributes:
        name: where the error comes from; two methods that declare the same source share it.
        systematic: part of the variance, 0..1, that a track keeps from frame to frame.
        independent: part of the variance, 0..1, that is drawn anew in every frame.
    """

    name: SourceName
    systematic: float = 0.0
    independent: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RangingMethod:
    """One way to measure distance.

    Attributes:
        name: prefix of its columns: `NAME_m`, `NAME_sigma_m`.
        title: a short noun phrase for tables, the report and the legend of the overlay.
        letter: one letter for the small figures of the overlay.
        colour: "#rrggbb" in charts and in the overlay.
        create: makes the method's `Ranger` for a run; None where this run cannot have it.
        needs: what it cannot do without.
        reads: methods whose ranges of the same frame it uses; they are measured first.
        error_sources: the parts of its variance; together they are 1.
        fallback_for: a method that makes this one superfluous where both have measured a track (it is in fusion only
            where the other one has no value), since it shares nearly all of its errors or has taught it.
        is_scale_reference: whether its scale is taken as the true one: fusion reckons with its systematic error but
            does not estimate it from differences to other methods.
        is_filtered: whether it also gets a filter over time (`NAME_kf_m`).
    """

    name: str
    title: str
    letter: str
    colour: str
    create: Callable[[Any], Any]
    error_sources: tuple[ErrorSource, ...]
    needs: frozenset[Requirement] = frozenset()
    reads: tuple[str, ...] = ()
    fallback_for: str | None = None
    is_scale_reference: bool = False
    is_filtered: bool = False

    def __post_init__(self) -> None:
        if not re.fullmatch(r"[a-z][a-z0-9_]*", self.name) or self.name.endswith("_kf"):
            raise ValueError(f"{self.name!r}: expected a lower-case name for columns, without _kf at its end")
        total = sum(source.systematic + source.independent for source in self.error_sources)
        if not math.isclose(total, 1.0, abs_tol=1e-6):
            raise ValueError(f"{self.name}: expected error sources that add up to 1, got {total:.4f}")

    @property
    def noise_share(self) -> float:
        """Part of sigma (not of the variance) that is independent from frame to frame, 0..1."""
        return math.sqrt(sum(source.independent for source in self.error_sources))

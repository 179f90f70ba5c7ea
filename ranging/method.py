"""RangingMethod: everything the program knows of one way to measure distance.

A method is one file with a `Ranger` and one `RangingMethod` that describes it, registered in `ranging.registry`.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal, get_args

import numpy as np

from track_range.foundation.errors import UserError
from track_range.ranging.ranger import Ranger
from track_range.ranging.ranges import Ranges
from track_range.ranging.size_models.size_model import SizeModel
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.tracking.tracks import Tracks

if TYPE_CHECKING:  # onnxruntime takes long to import, and reports do without it
    from track_range.detection.models.onnx_session import Runtime

SourceName = Literal["size", "box_height", "contact_point", "horizon", "baseline", "lane_width", "own"]
"""What a distance error comes from.

size: the object is taller or shorter than its class; box_height: the height of the box in the image; contact_point: the
row where the box meets the ground; horizon: pitch of the camera and slope of the road; baseline: the rig's geometry;
lane_width: the width of the lane; own: what no other method has any part of.
"""

Requirement = Literal["image", "rig", "right_image", "dense_disparity", "lane_lines", "camera_height"]
"""What a method cannot do without.

image: pixels of the left image, not only boxes; rig: a calibrated stereo pair; right_image: a pair whose rows agree,
calibrated or not; dense_disparity: dense stereo is switched on; lane_lines: a lane finder runs; camera_height: the
height of the camera above the road was given.
"""

RESERVED_NAMES = ("fused", "fuse", "read", "lanes", "detect", "track", "write", "x", "y", "truth", "scored_truth")
"""Names of columns and stages that are no method's."""


class MethodError(UserError):
    """A ranging method that cannot be used; the message names it and the reason."""


@dataclass(slots=True, kw_only=True)
class MethodContext:
    """What a run, or an evaluation of boxes, gives to the methods it creates.

    Attributes:
        camera: the (left) camera, undistorted.
        rig: the calibrated, rectified pair; None = one camera, or an uncalibrated pair.
        assumed_rig: an uncalibrated pair whose rows agree, with an assumed baseline; None = there is none.
        alignment: correction of the rig's disparities.
        focal_sigma: relative standard deviation of the focal length, which all methods share; 0 = calibrated.
        size_model: sizes of road users; None = the packaged model.
        box_sigma_px: standard deviation of one edge of the boxes; None = a detector's boxes.
        camera_height_m: of the camera above the road; None = unknown.
        lane_width_m: between the middles of the lane's lines, as given or assumed.
        has_images: whether frames have pixels; False where boxes alone are evaluated.
        has_lane_lines: whether a lane finder runs.
        has_dense_disparity: whether dense stereo is switched on.
        sgbm_options: parameters of dense stereo chosen by the user.
        runtime: threads and device for networks; None = the defaults.
        rangers: those created so far, by method; `RangingMethod.reads` are created first.
    """

    camera: PinholeCamera
    rig: StereoRig | None = None
    assumed_rig: StereoRig | None = None
    alignment: Alignment = field(default_factory=Alignment)
    focal_sigma: float = 0.0
    size_model: SizeModel | None = None
    box_sigma_px: float | None = None
    camera_height_m: float | None = None
    lane_width_m: float = 3.5
    has_images: bool = True
    has_lane_lines: bool = False
    has_dense_disparity: bool = False
    sgbm_options: Mapping[str, Any] = field(default_factory=dict)
    runtime: Runtime | None = None
    rangers: dict[str, Ranger] = field(default_factory=dict)

    @property
    def available(self) -> frozenset[Requirement]:
        """The requirements that are met."""
        is_met: dict[Requirement, bool] = {
            "image": self.has_images,
            "rig": self.rig is not None,
            "right_image": self.rig is not None or self.assumed_rig is not None,
            "dense_disparity": self.has_dense_disparity,
            "lane_lines": self.has_lane_lines,
            "camera_height": self.camera_height_m is not None,
        }
        return frozenset(name for name, met in is_met.items() if met)


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
        title: a short noun phrase for the legend of the overlay.
        letter: one letter for the small figures of the overlay.
        colour: "#rrggbb" in charts and in the overlay.
        create: makes the method's `Ranger` for a run; None where this run cannot have it.
        needs: what it cannot do without; where that is missing `create` is not called.
        reads: methods whose ranges of the same frame it uses where they are there; they are measured first. A method
            that does not exist is none that is there: it may be one of a package that is not installed.
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
    create: Callable[[MethodContext], Ranger | None]
    error_sources: tuple[ErrorSource, ...]
    needs: frozenset[Requirement] = frozenset()
    reads: tuple[str, ...] = ()
    fallback_for: str | None = None
    is_scale_reference: bool = False
    is_filtered: bool = False

    def __post_init__(self) -> None:
        for field_name, names in (("needs", self.needs), ("reads", self.reads)):
            is_list = isinstance(names, Collection) and not isinstance(names, str)
            if not is_list or not all(isinstance(name, str) for name in names):
                raise MethodError(
                    f"ranging method {self.name!r}: expected {field_name} as a tuple of names, got {names!r}"
                )
        object.__setattr__(self, "needs", frozenset(self.needs))
        object.__setattr__(self, "reads", tuple(self.reads))
        sources, needs = get_args(SourceName), get_args(Requirement)
        parts = [part for source in self.error_sources for part in (source.systematic, source.independent)]
        checks = (
            (re.fullmatch(r"[a-z][a-z0-9_]*", self.name), "expected a lower-case name for columns"),
            (not self.name.endswith(("_kf", "_sigma")), "expected a name without _kf or _sigma at its end"),
            (self.name not in RESERVED_NAMES, f"expected another name than {', '.join(RESERVED_NAMES)}"),
            (len(self.letter) == 1 and self.letter.isprintable(), f"expected one letter, got {self.letter!r}"),
            (re.fullmatch(r"#[0-9a-f]{6}", self.colour), f"expected a colour as #rrggbb, got {self.colour!r}"),
            (self.name not in (*self.reads, self.fallback_for), "expected other methods in reads and fallback_for"),
            (self.needs <= set(needs), f"expected needs of {', '.join(needs)}, got {', '.join(self.needs)}"),
            (
                {source.name for source in self.error_sources} <= set(sources),
                f"expected error sources of {', '.join(sources)}",
            ),
            (
                math.isclose(sum(parts), 1.0, abs_tol=1e-6) and min(parts) >= 0,
                f"expected error sources that are parts of 1, got {sum(parts):.4f}",
            ),
        )
        for is_met, expected in checks:
            if not is_met:
                raise MethodError(f"ranging method {self.name!r}: {expected}")

    @property
    def uses_size_model(self) -> bool:
        """Whether sizes of road users are among its error sources: `evaluate ranges` refits the model for it."""
        return any(source.name == "size" for source in self.error_sources)

    @property
    def noise_share(self) -> float:
        """Part of sigma (not of the variance) that is independent from frame to frame, 0..1."""
        return math.sqrt(sum(source.independent for source in self.error_sources))


def checked_ranges(method: str, found: Any, tracks: Tracks) -> Ranges:
    """What a ranger has returned for these tracks, fit for fusion and filters.

    A distance or sigma that is not finite and positive makes the track not measured: both become NaN.

    Args:
        method: name of the ranger's method.
        found: what it returned.
        tracks: N tracks that were handed to it.

    Raises:
        MethodError: it is no `Ranges`, or of other tracks.
    """
    if not isinstance(found, Ranges):
        raise MethodError(f"ranging method {method!r}: expected Ranges, got {type(found).__name__}")
    if len(found) != len(tracks):
        raise MethodError(f"ranging method {method!r}: expected {len(tracks)} ranges, got {len(found)}")
    if not np.array_equal(found.track_id, tracks.track_id):
        raise MethodError(f"ranging method {method!r}: expected the track_id of the tracks in their order, got others")
    distance_m, sigma_m, systematic_m = found.distance_m, found.sigma_m, found.sigma_systematic_m
    is_measured = (distance_m > 0) & (distance_m < np.inf) & (sigma_m > 0) & (sigma_m < np.inf)
    if systematic_m is not None:
        is_measured &= (systematic_m >= 0) & (systematic_m < np.inf)
    if np.all(is_measured | (np.isnan(distance_m) & np.isnan(sigma_m))):
        return found
    return Ranges(
        found.track_id,
        np.where(is_measured, distance_m, np.nan),
        np.where(is_measured, sigma_m, np.nan),
        None if systematic_m is None else np.where(is_measured, systematic_m, np.nan),
    )

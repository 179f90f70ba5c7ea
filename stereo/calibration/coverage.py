"""Coverage: what part of the image a set of board views has seen, in x, y, size and skew, and what is missing.

    x, y   share of the image's width and height that the corners span       size  side of the board over the image's
    skew   tilt of the board's plane against the image plane, degrees

Lens terms are extrapolated where no corner was, and a board that is never tilted leaves the focal length open.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.calibration.board_views import BoardView

_THIRDS = (("left", "middle", "right"), ("top", "middle", "bottom"))

_MIN_SHARE_OF_THIRD = 0.03
"""A third of the image with fewer of all the corners counts as not seen."""

_EDGE_SHARE = 0.15
"""Corners should come as near to each edge of the image."""

_SAME_TILT_RAD = math.radians(6.0)
"""Boards whose planes differ by no more are parallel."""

_TILTED_DEG = 15.0
_MIN_TILTED_SHARE = 0.25
_MIN_SIZE_RATIO = 1.3
_MIN_LARGEST_SIZE = 0.25
_FEW_VIEWS = 10

_SAME_PLACE_PX = 5.0
"""Mean motion of the corners between any two views below which the board stands still."""


@dataclass(frozen=True, slots=True)
class Coverage:
    """What was seen.

    Attributes:
        x_span: (first, last) corner as a share of the image's width.
        y_span: the same of the height.
        size_range: (smallest, largest) board: square root of the share of the image that it fills.
        tilt_range_deg: (smallest, largest) angle between a board's plane and the image plane.
        is_parallel: all boards have the same tilt, in the same direction.
        warnings: sentences on what is missing.
    """

    x_span: tuple[float, float]
    y_span: tuple[float, float]
    size_range: tuple[float, float]
    tilt_range_deg: tuple[float, float]
    is_parallel: bool
    warnings: tuple[str, ...]


def coverage_of(views: Sequence[BoardView], board_to_camera: FloatArray) -> Coverage:
    """Coverage by these views, whose boards have the poses (V, 4, 4)."""
    share = _shares(views)
    sizes = np.array([view_shape(view)[2] for view in views])
    normals = board_to_camera[:, :3, 2]
    tilts_deg = np.degrees(np.arccos(np.clip(np.abs(normals[:, 2]), 0, 1)))
    apart_rad = np.arccos(np.clip(np.abs(normals @ normals.T), 0, 1))
    warnings = [
        *_few_views(len(views)),
        *_unseen_parts(share),
        *_sizes_missing(sizes),
        *_tilts_missing(tilts_deg, normals),
    ]
    return Coverage(
        _range(share[:, 0]),
        _range(share[:, 1]),
        _range(sizes),
        _range(tilts_deg),
        bool(apart_rad.max() < _SAME_TILT_RAD),
        tuple(warnings),
    )


def view_shape(view: BoardView) -> FloatArray:
    """(4,) where and how a board stands in an image: x and y of its middle, its size and its skew, each about 0 .. 1.

    Skew is how far the corner of the board's outline is from a right angle, or its sides from being equal.
    """
    size_px = np.array(view.size_px)
    x, y = view.xy_px.mean(axis=0) / size_px
    hull = cv2.convexHull(view.xy_px.astype(np.float32))
    size = math.sqrt(float(cv2.contourArea(hull)) / float(size_px.prod()))
    square = cv2.findHomography(view.xyz_m[:, :2] / np.ptp(view.xyz_m[:, :2]), view.xy_px)[0]
    skew = 0.0 if square is None else _skew(np.asarray(square, np.float64), view)
    return np.array([x, y, size, skew])


def varied(views: Sequence[BoardView], n_wanted: int) -> list[int]:
    """Indices, ascending, of `n_wanted` views that differ most: each next one is farthest from all before."""
    if len(views) <= n_wanted:
        return list(range(len(views)))
    shapes = np.stack([view_shape(view) for view in views])
    chosen = [int(np.argmin([view.edge_px for view in views]))]
    far = np.abs(shapes - shapes[chosen[0]]).sum(axis=1)
    while len(chosen) < n_wanted:
        chosen.append(int(far.argmax()))
        far = np.minimum(far, np.abs(shapes - shapes[chosen[-1]]).sum(axis=1))
    return sorted(chosen)


def lack_of_motion(views: Sequence[BoardView]) -> bool:
    """Whether the board stands at the same place of the image in all views."""
    first = views[0]
    for view in views[1:]:
        both = np.intersect1d(first.corner_id, view.corner_id)
        if not len(both):
            return False
        steps = first.of_corners(both).xy_px - view.of_corners(both).xy_px
        if np.linalg.norm(steps, axis=1).mean() > _SAME_PLACE_PX:
            return False
    return True


def _skew(homography: FloatArray, view: BoardView) -> float:
    """Unlikeness of the board's two directions in the image: of their lengths, and to a right angle."""
    x, y = (view.xyz_m[:, :2] / np.ptp(view.xyz_m[:, :2])).mean(axis=0)
    point = homography @ np.array([x, y, 1.0])
    along = [(homography[:2, i] - point[:2] / point[2] * homography[2, i]) / point[2] for i in (0, 1)]
    lengths = [float(np.linalg.norm(each)) for each in along]
    cosine = abs(float(along[0] @ along[1])) / max(lengths[0] * lengths[1], 1e-12)
    return cosine + 1 - min(lengths) / max(*lengths, 1e-12)


def _shares(views: Sequence[BoardView]) -> FloatArray:
    """(N, 2) all corners as shares of the image's width and height."""
    return np.concatenate([view.xy_px / np.array(view.size_px) for view in views])


def _range(values: FloatArray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _few_views(n_views: int) -> list[str]:
    return [f"only {n_views} views: 15 to 30 are good."] if n_views < _FEW_VIEWS else []


def _unseen_parts(share: FloatArray) -> list[str]:
    """Thirds of the image that hardly any corner was in, and edges that none came near."""
    said = []
    for axis, names in enumerate(_THIRDS):
        counts = np.histogram(share[:, axis], bins=3, range=(0, 1))[0] / len(share)
        missing = [name for name, count in zip(names, counts, strict=True) if count < _MIN_SHARE_OF_THIRD]
        said += [f"hardly any corners in the {name} third of the image: show the board there." for name in missing]
        first, last = _range(share[:, axis])
        edges = ((names[0], first > _EDGE_SHARE), (names[2], last < 1 - _EDGE_SHARE))
        said += [
            f"no corners near the {name} edge of the image: the lens terms are a guess there."
            for name, is_far in edges
            if is_far and name not in missing
        ]
    return said


def _sizes_missing(sizes: FloatArray) -> list[str]:
    smallest, largest = _range(sizes)
    if largest < _MIN_LARGEST_SIZE:
        return [f"the board is small in all views ({100 * largest:.0f} % of the image's side at most): come nearer."]
    if largest < _MIN_SIZE_RATIO * smallest:
        return ["the board has the same size in all views: take some from nearer and some from farther away."]
    return []


def _tilts_missing(tilts_deg: FloatArray, normals: FloatArray) -> list[str]:
    """Frontal boards alone, or boards tilted about one axis alone."""
    tilted = tilts_deg > _TILTED_DEG
    if tilted.mean() < _MIN_TILTED_SHARE:
        return [
            f"the board is tilted by more than {_TILTED_DEG:.0f} degrees in {int(tilted.sum())} of {len(tilted)} "
            "views only: tilt it by 20 to 45 degrees more often."
        ]
    facing = normals * np.sign(normals[:, 2:])
    spread_deg = np.degrees(np.ptp(facing[:, :2], axis=0))
    axes = (("left and right", spread_deg[0]), ("forward and backward", spread_deg[1]))
    return [f"the board is hardly ever tilted {name}: do so." for name, spread in axes if spread < _TILTED_DEG]

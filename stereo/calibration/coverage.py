"""Coverage of the image by a set of board views, in position, size and tilt, and the missing views.

    x, y   fraction of the image width and height spanned by the corners
    size   side of the board / side of the image
    tilt   angle between the board's plane and the image plane, degrees

The lens distortion is extrapolated where there are no corners, and views without tilt do not
determine the focal length.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.calibration.board_views import BoardView

# names of the thirds of the image, by axis
_THIRDS = (("left", "middle", "right"), ("top", "middle", "bottom"))
_MIN_FRACTION_OF_THIRD = 0.03  # minimum fraction of all corners in a third of the image
_EDGE_FRACTION = 0.15  # largest distance of the outermost corners from the image's edges / its side
_SAME_TILT_RAD = math.radians(6.0)  # largest angle between parallel boards
_TILTED_DEG = 15.0  # minimum tilt of a board that counts as tilted
_MIN_TILTED_FRACTION = 0.25  # minimum fraction of views with a tilted board
_MIN_SIZE_RATIO = 1.3  # minimum ratio of the largest to the smallest board in the images
_MIN_LARGEST_SIZE = 0.25  # minimum size of the largest board, as a fraction of the image's side
_FEW_VIEWS = 10  # number of views below which a warning asks for more
_SAME_PLACE_PX = 5.0  # mean motion of the corners between two views below which the board is static


@dataclass(frozen=True, slots=True)
class Coverage:
    """Coverage of the image by board views."""

    x_span: tuple[float, float]  # (first, last) corner as a fraction of the image width
    y_span: tuple[float, float]  # (first, last) corner as a fraction of the image height
    # (smallest, largest) board: square root of the fraction of the image area
    size_range: tuple[float, float]
    # (smallest, largest) angle between a board's plane and the image plane
    tilt_range_deg: tuple[float, float]
    is_parallel: bool  # whether all boards are parallel
    warnings: tuple[str, ...]  # messages for the user on missing views


def coverage_of(views: Sequence[BoardView], board_to_camera: FloatArray) -> Coverage:
    """Coverage by V views with board poses (V, 4, 4)."""
    fraction = np.concatenate([view.xy_px / np.array(view.size_px) for view in views])
    sizes = np.array([view_shape(view)[2] for view in views])
    normals = board_to_camera[:, :3, 2]
    tilts_deg = np.degrees(np.arccos(np.clip(np.abs(normals[:, 2]), 0, 1)))
    angle_rad = np.arccos(np.clip(np.abs(normals @ normals.T), 0, 1))
    few = [f"only {len(views)} views: 15 to 30 are recommended."] if len(views) < _FEW_VIEWS else []
    return Coverage(
        _range(fraction[:, 0]),
        _range(fraction[:, 1]),
        _range(sizes),
        _range(tilts_deg),
        bool(angle_rad.max() < _SAME_TILT_RAD),
        (
            *few,
            *_uncovered_parts(fraction),
            *_sizes_missing(sizes),
            *_tilts_missing(tilts_deg, normals),
        ),
    )


def view_shape(view: BoardView) -> FloatArray:
    """(4,) x, y of the board's centre, size, and skew (from right angles and equal sides), each
    about 0 .. 1.
    """
    size_px, on_board = np.array(view.size_px), view.xyz_m[:, :2] / np.ptp(view.xyz_m[:, :2])
    x, y = view.xy_px.mean(axis=0) / size_px
    hull = cv2.convexHull(view.xy_px.astype(np.float32))
    size = math.sqrt(float(cv2.contourArea(hull)) / float(size_px.prod()))
    homography = cv2.findHomography(on_board, view.xy_px)[0]
    if homography is None:
        return np.array([x, y, size, 0.0])
    # |cos| of the angle between the board's axes in the image, plus 1 - the ratio of their lengths
    point = homography @ np.array([*on_board.mean(axis=0), 1.0])
    axes = [
        (homography[:2, i] - point[:2] / point[2] * homography[2, i]) / point[2] for i in (0, 1)
    ]
    lengths = [float(np.linalg.norm(axis)) for axis in axes]
    cosine = abs(float(axes[0] @ axes[1])) / max(lengths[0] * lengths[1], 1e-12)
    return np.array([x, y, size, cosine + 1 - min(lengths) / max(*lengths, 1e-12)])


def most_different(views: Sequence[BoardView], n_views: int) -> list[int]:
    """Ascending indices of `n_views` different views, by farthest-point sampling from the sharpest
    view.
    """
    if len(views) <= n_views:
        return list(range(len(views)))
    shapes = np.stack([view_shape(view) for view in views])
    chosen = [int(np.argmin([view.edge_px for view in views]))]
    distance = np.abs(shapes - shapes[chosen[0]]).sum(axis=1)
    while len(chosen) < n_views:
        chosen.append(int(distance.argmax()))
        distance = np.minimum(distance, np.abs(shapes - shapes[chosen[-1]]).sum(axis=1))
    return sorted(chosen)


def is_static(views: Sequence[BoardView]) -> bool:
    """Whether the board is at the same position in the images of all views."""
    first = views[0]
    for view in views[1:]:
        common = np.intersect1d(first.corner_id, view.corner_id)
        if not len(common):
            return False
        steps = first.of_corners(common).xy_px - view.of_corners(common).xy_px
        if np.linalg.norm(steps, axis=1).mean() > _SAME_PLACE_PX:
            return False
    return True


def _range(values: FloatArray) -> tuple[float, float]:
    return float(values.min()), float(values.max())


def _uncovered_parts(fraction: FloatArray) -> list[str]:
    warnings = []
    for axis, names in enumerate(_THIRDS):
        counts = np.histogram(fraction[:, axis], bins=3, range=(0, 1))[0] / len(fraction)
        missing = [
            name
            for name, count in zip(names, counts, strict=True)
            if count < _MIN_FRACTION_OF_THIRD
        ]
        warnings += [
            f"the {name} third of the image has hardly any corners: show the board there."
            for name in missing
        ]
        first, last = _range(fraction[:, axis])
        edges = ((names[0], first > _EDGE_FRACTION), (names[2], last < 1 - _EDGE_FRACTION))
        warnings += [
            f"there are no corners near the {name} edge of the image: the lens distortion is "
            "extrapolated there."
            for name, is_far in edges
            if is_far and name not in missing
        ]
    return warnings


def _sizes_missing(sizes: FloatArray) -> list[str]:
    smallest, largest = _range(sizes)
    if largest < _MIN_LARGEST_SIZE:
        return [
            f"the board is small in all views (at most {100 * largest:.0f} % of the image's side): "
            "move it nearer to the camera."
        ]
    if largest < _MIN_SIZE_RATIO * smallest:
        return [
            "the board has the same size in all views: add views from nearer and from farther away."
        ]
    return []


def _tilts_missing(tilts_deg: FloatArray, normals: FloatArray) -> list[str]:
    is_tilted = tilts_deg > _TILTED_DEG
    if is_tilted.mean() < _MIN_TILTED_FRACTION:
        return [
            f"the board is tilted by more than {_TILTED_DEG:.0f} degrees in only "
            f"{int(is_tilted.sum())} of {len(is_tilted)} views: tilt it by 20 to 45 degrees more "
            "often."
        ]
    facing = normals * np.sign(normals[:, 2:])
    spread_deg = np.degrees(np.ptp(facing[:, :2], axis=0))
    axes = (("left and right", spread_deg[0]), ("forward and backward", spread_deg[1]))
    missing = [name for name, spread in axes if spread < _TILTED_DEG]
    return [f"hardly any view has the board tilted {name}: add such views." for name in missing]

r"""run.xodr: ASAM OpenDRIVE 1.7 with one road along the path of the camera, in the frame `map`.

The reference line is the path: a cubic spline with continuous curvature that is at most
`_MAX_DEVIATION_M` from the poses, extended by straight lines before and after the drive. The ego
lane is around it, with the width of the run or the usual one; further lanes are where moving
vehicles were seen. Road marks and the plane z = 0 are assumed. What is uncertain is in `userData`.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
from scipy.interpolate import PPoly, splev, splprep
from scipy.spatial import cKDTree

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.results.formats.adas.trajectories import Trajectories
from track_range.results.formats.adas.xml_nodes import node, write_nodes

ROAD_FILE = "run.xodr"
_STEP_M = 1.0  # between points of the path; nearer ones are of a vehicle that stands
_MIN_PATH_M = 10.0  # shorter paths show no curve
_DEVIATION_M = 0.05  # of the poses from the reference line, 1 sigma
_MAX_DEVIATION_M = 0.1
_BEFORE_M, _AFTER_M = 50.0, 100.0  # straight parts before and after the path: road users in view
_CENTRED_SIGMA_M = 0.3  # of the path from the middle of its lane; assumed, as for warnings
# most lanes beside the ego lane on a side; farther vehicles are on another road
_MOST_LANES = 2
_NEAR_M = 40.0  # distance up to which the lane of a vehicle is sure
_MIN_ROWS = 5  # frames of a track in a lane that shows the lane
_MIN_MPS = 2.0  # speed of a vehicle that drives
# cosine between its heading and the road's, in the driven part and beyond it, where the road may bend
_MIN_ALONG, _MIN_ALONG_BEYOND = 0.9, 0.996
_BEYOND_M = np.arange(1.0, 31.0)[:, None]  # of the driven part, along the straight lines
_IS_VEHICLE = np.isin(ROAD_CLASSES, ["car", "motorcycle", "bus", "truck"])
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(12)  # of the length of a curve


def write_road(path: Path, drive: Trajectories) -> bool:
    """Write the road of a drive, atomically; False = there is none, as no position is known."""
    if not len(drive.ego):
        return False
    write_nodes(path, _document(drive))
    return True


@dataclass(frozen=True, slots=True)
class _Path:
    """The reference line of a road."""

    geometry: list[ElementTree.Element]
    length_m: float
    samples: FloatArray  # (K, 3) x, y and heading in the driven part
    deviation_m: float  # largest one from the poses


def _document(drive: Trajectories) -> ElementTree.Element:
    path = _path(drive.ego)
    x_m, y_m, _ = path.samples.T
    note = (
        "measured: path of the camera, lanes where vehicles drove; assumed: the path is in the "
        "middle of its lane, road marks, z = 0, straight parts before and after the drive"
    )
    uncertain = {
        "path_end_sigma_m": f"{drive.end_sigma_m:.3f}",
        "path_fit_deviation_m": f"{path.deviation_m:.3f}",
        "lane_width_sigma_m": f"{drive.lane.sigma * drive.lane.width_m:.3f}",
        "lane_offset_sigma_m": f"{_CENTRED_SIGMA_M:.3f}",
        "straight_before_m": f"{_BEFORE_M:g}",
        "straight_after_m": f"{_AFTER_M:g}",
        "note": note,
    }
    data = [node("userData", code=f"track-range:{key}", value=uncertain[key]) for key in uncertain]
    n_left, n_right, offset = _lane_counts(drive, path.samples)
    road = node(
        "road",
        node("planView", *path.geometry),
        node("elevationProfile", node("elevation", s=0, a=0, b=0, c=0, d=0)),
        _lanes(n_left, n_right, offset * drive.lane.width_m, drive.lane.width_m),
        *data,
        name="path of the camera",
        length=_text(path.length_m),
        id=1,
        junction=-1,
        rule="LHT" if offset < 0 else "RHT",
    )
    header = node(
        "header",
        revMajor=1,
        revMinor=7,
        name="road by the path of the camera; x forward, y left of its first pose, m",
        version="1.0",
        date=drive.date,
        north=_text(y_m.max() + _AFTER_M),
        south=_text(y_m.min() - _AFTER_M),
        east=_text(x_m.max() + _AFTER_M),
        west=_text(x_m.min() - _AFTER_M),
        vendor="track-range",
    )
    return node("OpenDRIVE", header, road)


def _text(value: float) -> str:
    return f"{value:.9g}"


def _path(ego: FloatArray) -> _Path:
    """The reference line along the poses; straight along the first one if they show no curve."""
    points = _spaced(ego)
    along_m = np.concatenate([[0.0], np.hypot(*np.diff(points, axis=0).T).cumsum()])
    if along_m[-1] < _MIN_PATH_M:
        heading_rad = float(ego[0, 3])
        end = ego[0, 1:3] + _MIN_PATH_M * np.array([math.cos(heading_rad), math.sin(heading_rad)])
        samples = np.column_stack([[ego[0, 1:3], end], [heading_rad] * 2])
        return _joined([], samples, 0.0)
    smoothing, deviation_m = len(points) * _DEVIATION_M**2, math.inf
    while deviation_m > _MAX_DEVIATION_M:
        spline: Any = splprep(points.T, u=along_m, s=smoothing)[0]
        away = np.stack(splev(along_m, spline), axis=1) - points
        deviation_m, smoothing = float(np.hypot(*away.T).max()), smoothing / 4
    knots, coefficients, degree = spline
    of_axes = [PPoly.from_spline((knots, one, degree)).c for one in coefficients]
    curve = PPoly(np.stack(of_axes, axis=2), knots)
    at = np.append(np.arange(0.0, along_m[-1], _STEP_M), along_m[-1])
    dx, dy = curve(at, 1).T
    samples = np.column_stack([curve(at), np.arctan2(dy, dx)])
    widths = np.diff(curve.x)
    pieces = [(curve.c[::-1, i], float(widths[i])) for i in np.flatnonzero(widths > 0)]
    return _joined(pieces, samples, deviation_m)


def _spaced(ego: FloatArray) -> FloatArray:
    """(K, 2) positions with a step of at least `_STEP_M` forward between them."""
    kept = [ego[0, 1:3]]
    for x_m, y_m, heading_rad in ego[1:, 1:].tolist():
        step = np.array([x_m, y_m]) - kept[-1]
        ahead_m = step[0] * math.cos(heading_rad) + step[1] * math.sin(heading_rad)
        if ahead_m >= _STEP_M:
            kept.append(np.array([x_m, y_m]))
    return np.array(kept)


def _joined(
    pieces: list[tuple[FloatArray, float]], samples: FloatArray, deviation_m: float
) -> _Path:
    """The line before, the cubic pieces (4, 2) with their widths and the line after them; without
    pieces, one line.
    """
    geometry: list[ElementTree.Element] = []
    s_m = 0.0

    def add(
        at_m: FloatArray, heading_rad: float, length_m: float, shape: ElementTree.Element
    ) -> None:
        nonlocal s_m
        x_m, y_m = at_m.tolist()
        place = {"s": s_m, "x": x_m, "y": y_m, "hdg": heading_rad, "length": length_m}
        geometry.append(node("geometry", shape, **{name: _text(place[name]) for name in place}))
        s_m += length_m

    (first, last), (first_rad, last_rad) = samples[[0, -1], :2], samples[[0, -1], 2].tolist()
    start = first - _BEFORE_M * np.array([math.cos(first_rad), math.sin(first_rad)])
    through_m = 0.0 if pieces else float(np.hypot(*(last - first))) + _AFTER_M
    add(start, first_rad, _BEFORE_M + through_m, node("line"))
    for coefficients, width in pieces:
        powers = coefficients * width ** np.arange(4)[:, None]  # of a parameter from 0 to 1
        heading_rad = math.atan2(powers[1, 1], powers[1, 0])
        c, s = math.cos(heading_rad), math.sin(heading_rad)
        local = (powers - [powers[0], *np.zeros((3, 2))]) @ np.array([[c, -s], [s, c]])
        p = (_NODES[:, None] + 1) / 2
        speed = local[1] + 2 * p * local[2] + 3 * p**2 * local[3]
        numbers = {
            f"{letter}{axis}": _text(local[power, column])
            for column, axis in enumerate("UV")
            for power, letter in enumerate("abcd")
        }
        cubic = node("paramPoly3", **numbers, pRange="normalized")
        add(powers[0], heading_rad, float(_WEIGHTS @ np.hypot(*speed.T)) / 2, cubic)
    if pieces:
        add(last, last_rad, _AFTER_M, node("line"))
    return _Path(geometry, s_m, samples, deviation_m)


def _lane_counts(drive: Trajectories, samples: FloatArray) -> tuple[int, int, float]:
    """Numbers of lanes to the left and right of the middle of the road, and how many lane widths
    this is to the left of the path; negative = vehicles that come are on the right.
    """
    is_same = _neighbours(drive, samples)
    left, right = max(*is_same, 0), -min(*is_same, 0)
    comes_right = any(lane < 0 and not same for lane, same in is_same.items())
    comes_left = any(lane > 0 and not same for lane, same in is_same.items())
    if comes_right and not comes_left:
        n_same = next((k for k in range(right) if not is_same.get(-k - 1, False)), right)
        return left + 1 + n_same, right - n_same, -(n_same + 0.5)
    n_same = next((k for k in range(left) if not is_same.get(k + 1, False)), left)
    return left - n_same, right + 1 + n_same, n_same + 0.5


def _neighbours(drive: Trajectories, samples: FloatArray) -> dict[int, bool]:
    """Whether vehicles drive in the direction of the ego vehicle, by lane: 0 = ego lane, positive =
    to the left.
    """
    rows = drive.rows[_IS_VEHICLE[drive.rows[:, 7].astype(int)]]
    x_m, y_m = (np.interp(rows[:, 0], drive.ego[:, 0], drive.ego[:, axis]) for axis in (1, 2))
    first, last = samples[0], samples[-1]
    before = first - _BEYOND_M[::-1] * [math.cos(first[2]), math.sin(first[2]), 0.0]
    after = last + _BEYOND_M * [math.cos(last[2]), math.sin(last[2]), 0.0]
    samples = np.concatenate([before, samples, after])
    _, at = cKDTree(samples[:, :2]).query(rows[:, 1:3])
    heading_rad = samples[at, 2]
    dx_m, dy_m = (rows[:, 1:3] - samples[at, :2]).T
    left_m = np.cos(heading_rad) * dy_m - np.sin(heading_rad) * dx_m
    lane = np.rint(left_m / drive.lane.width_m)
    along = np.cos(rows[:, 3] - heading_rad)
    is_beyond = (at < len(before)) | (at >= len(samples) - len(after))
    drives = np.abs(along) >= np.where(is_beyond, _MIN_ALONG_BEYOND, _MIN_ALONG)
    drives &= (rows[:, 5] == 0) & (rows[:, 10] >= _MIN_MPS)
    drives &= (at > 0) & (at < len(samples) - 1) & (np.abs(lane) <= _MOST_LANES)
    drives &= np.hypot(rows[:, 1] - x_m, rows[:, 2] - y_m) <= _NEAR_M
    lanes = {0: True}
    for number in np.unique(lane[drives]).astype(int).tolist():
        seen = drives & (lane == number)
        n_frames = np.unique(rows[seen, 6], return_counts=True)[1]
        if number and n_frames.max() >= _MIN_ROWS:
            lanes[number] = bool(along[seen].sum() > 0)
    return lanes


def _lanes(n_left: int, n_right: int, offset_m: float, width_m: float) -> ElementTree.Element:
    """One section of lanes, numbered from the middle of the road."""

    def lane(number: int, *, is_edge: bool) -> ElementTree.Element:
        mark = node(
            "roadMark",
            sOffset=0,
            type="solid" if is_edge else "broken",
            weight="standard",
            color="standard",
            width=0.12,
        )
        width = [node("width", sOffset=0, a=_text(width_m), b=0, c=0, d=0)] if number else []
        kind = "driving" if number else "none"
        return node("lane", *width, mark, id=number, type=kind, level="false")

    left = [lane(number, is_edge=number == n_left) for number in range(n_left, 0, -1)]
    right = [lane(-number, is_edge=number == n_right) for number in range(1, n_right + 1)]
    sides = [node("center", lane(0, is_edge=not (left and right)))]
    if left:
        sides.insert(0, node("left", *left))
    if right:
        sides.append(node("right", *right))
    return node(
        "lanes",
        node("laneOffset", s=0, a=_text(offset_m), b=0, c=0, d=0),
        node("laneSection", *sides, s=0),
    )

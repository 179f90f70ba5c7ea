"""run.xodr: valid by ASAM's schema, with a reference line through the poses of the camera."""

import math
import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.support.asam_checkers import issues_of
from track_range.ranging.methods.lane_width import LaneWidth
from track_range.results.formats.adas.opendrive_file import write_road
from track_range.results.formats.adas.openscenario_file import write_scenario
from track_range.results.formats.adas.trajectories import N_VALUES, Trajectories

CAR, PERSON = 2, 0


@pytest.fixture(scope="module")
def schema():
    xmlschema = pytest.importorskip("xmlschema", reason="xmlschema is not installed (extra dev)")
    schemas = pytest.importorskip(
        "schemas", reason="scenariogeneration is not installed (extra dev)"
    )
    return xmlschema.XMLSchema(Path(next(iter(schemas.__path__))) / "opendrive_17_core.xsd")


def path(s_m):
    """(N, 3) x, y and heading of a road that is straight for 40 m and then turns to the left."""
    radius_m = 60.0
    turned = np.maximum(s_m - 40.0, 0.0) / radius_m
    x_m = np.minimum(s_m, 40.0) + radius_m * np.sin(turned)
    return np.stack([x_m, radius_m * (1 - np.cos(turned)), turned], axis=1)


def users(*, left_m, heading_rad=0.0, mps=10.0, class_id=CAR, track_id=3, parked=0.0, ahead_m=30.0):
    """Rows of a road user beside the path, ahead of the ego vehicle in each frame."""
    times_s = np.arange(0.0, 6.0, 0.1)
    at = path(10.0 * times_s + ahead_m)
    rows = np.zeros((len(times_s), N_VALUES))
    rows[:, 0] = times_s
    rows[:, 1] = at[:, 0] - left_m * np.sin(at[:, 2])
    rows[:, 2] = at[:, 1] + left_m * np.cos(at[:, 2])
    rows[:, 3] = at[:, 2] + heading_rad
    rows[:, 5:8] = parked, track_id, class_id
    rows[:, 10] = mps
    return rows


def drive(*rows, noise_m=0.0, times_s=None):
    """A drive of 9 s at 10 m/s."""
    times_s = np.arange(0.0, 9.0, 0.1) if times_s is None else times_s
    noise = noise_m * np.random.default_rng(0).standard_normal((len(times_s), 2))
    ego = np.column_stack([times_s, path(10.0 * times_s) + np.column_stack([noise, 0 * times_s])])
    return Trajectories(
        ego=ego,
        rows=np.concatenate([np.zeros((0, N_VALUES)), *rows]),
        start_utc_s=None,
        end_sigma_m=1.25,
        lane=LaneWidth(3.2, 0.05),
    )


def written(tmp_path, given, schema=None):
    file = tmp_path / "run.xodr"
    assert write_road(file, given)
    if schema is not None:
        schema.validate(file)
    return ElementTree.parse(file).getroot()  # noqa: S314 - a file of this test


def reference_line(root, n=400):
    """(M, 3) points and headings of each geometry, and (K, 2, 3) its ends."""
    points, ends = [], []
    for geometry in root.iter("geometry"):
        place = {name: float(value) for name, value in geometry.attrib.items()}
        p, (shape,) = np.linspace(0.0, 1.0, n), geometry
        if shape.tag == "line":
            u, v, du, dv = place["length"] * p, 0 * p, 1 + 0 * p, 0 * p
        else:
            c = {name: float(shape.get(name)) for name in shape.attrib if name != "pRange"}
            u, v = (
                np.polynomial.Polynomial([c[f"{letter}{axis}"] for letter in "abcd"])
                for axis in "UV"
            )
            assert np.trapezoid(np.hypot(u.deriv()(p), v.deriv()(p)), p) == pytest.approx(
                place["length"], abs=1e-3
            )
            u, v, du, dv = u(p), v(p), u.deriv()(p), v.deriv()(p)
        cosine, sine = math.cos(place["hdg"]), math.sin(place["hdg"])
        line = np.stack(
            [
                place["x"] + cosine * u - sine * v,
                place["y"] + sine * u + cosine * v,
                place["hdg"] + np.arctan2(dv, du),
            ],
            axis=1,
        )
        points.append(line)
        ends.append(line[[0, -1]])
    return np.concatenate(points), ends


def lanes(root):
    """Offset of the middle of the road from the path, and lane ids from left to right."""
    offset = float(root.find(".//laneOffset").get("a"))
    return round(offset / 3.2, 6), [int(lane.get("id")) for lane in root.iter("lane")]


def test_valid_along_the_path_without_gaps(tmp_path, schema):
    given = drive(noise_m=0.03)
    root = written(tmp_path, given, schema)
    line, ends = reference_line(root)
    assert len(ends) < 12
    for before, after in pairwise(ends):
        np.testing.assert_allclose(before[1], after[0], atol=1e-6)
    away_m = [np.hypot(*(line[:, :2] - pose).T).min() for pose in given.ego[:, 1:3]]
    assert max(away_m) < 0.12
    true = path(np.linspace(5.0, 85.0, 50))
    for x_m, y_m, heading_rad in true:
        nearest = line[np.argmin(np.hypot(line[:, 0] - x_m, line[:, 1] - y_m))]
        assert nearest[2] == pytest.approx(heading_rad, abs=math.radians(1.5))
    road = root.find("road")
    lengths = [float(geometry.get("length")) for geometry in root.iter("geometry")]
    assert float(road.get("length")) == pytest.approx(sum(lengths)) == pytest.approx(239, abs=1.1)
    assert {float(width.get("a")) for width in root.iter("width")} == {3.2}
    data = {item.get("code"): item.get("value") for item in road.iter("userData")}
    assert data["track-range:path_end_sigma_m"] == "1.250"
    assert data["track-range:lane_width_sigma_m"] == "0.160"


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([], (0.5, [0, -1])),
        ([users(left_m=3.4, heading_rad=math.pi)], (0.5, [1, 0, -1])),
        ([users(left_m=3.0)], (1.5, [0, -1, -2])),
        ([users(left_m=-3.0)], (0.5, [0, -1, -2])),
        # on the left, vehicles drive beyond a lane that none was seen in
        ([users(left_m=6.2, heading_rad=math.pi)], (0.5, [2, 1, 0, -1])),
        # left-hand traffic
        (
            [users(left_m=-3.4, heading_rad=math.pi), users(left_m=3.0, track_id=4)],
            (-0.5, [2, 1, 0, -1]),
        ),
        ([users(left_m=3.2, parked=1.0)], (0.5, [0, -1])),
        ([users(left_m=-3.2, heading_rad=math.pi, parked=math.nan)], (0.5, [0, -1])),
        ([users(left_m=3.2, class_id=PERSON)], (0.5, [0, -1])),
        ([users(left_m=3.2, heading_rad=math.pi / 2)], (0.5, [0, -1])),
        ([users(left_m=3.2)[:4]], (0.5, [0, -1])),
        ([users(left_m=20.0)], (0.5, [0, -1])),
        # beyond the part that was driven, where the road bends away
        ([users(left_m=-3.5, ahead_m=130.0)], (0.5, [0, -1])),
    ],
)
def test_lanes_are_where_vehicles_drive(tmp_path, schema, rows, expected):
    root = written(tmp_path, drive(*rows), schema)
    assert lanes(root) == expected
    assert root.find("road").get("rule") == ("LHT" if expected[0] < 0 else "RHT")


def test_standing_and_reversing(tmp_path, schema):
    """A vehicle that stands has a straight road; what it reverses is no second road."""
    times_s = np.arange(0.0, 5.0, 0.1)
    standing = replace(drive(times_s=times_s), ego=np.tile([0.0, 4.0, 5.0, 0.5], (50, 1)))
    root = written(tmp_path, standing, schema)
    (line,) = root.iter("geometry")
    passing = users(left_m=0.0)
    turn = np.array([[math.cos(0.5), math.sin(0.5)], [-math.sin(0.5), math.cos(0.5)]])
    passing[:, 1:3] = [4.0, 5.0] + np.column_stack([passing[:, 0] * 10, np.full(60, 3.3)]) @ turn
    passing[:, 3] = 0.5
    assert lanes(written(tmp_path, replace(standing, rows=passing))) == (1.5, [0, -1, -2])
    assert (float(line.get("hdg")), float(line.get("length"))) == (0.5, 160.0)
    there = np.concatenate([np.arange(0.0, 9.0, 0.1), np.arange(9.0, 4.0, -0.1)])
    root = written(tmp_path, drive(times_s=there), schema)
    assert float(root.find("road").get("length")) == pytest.approx(240, abs=0.1)


def test_no_road_without_positions(tmp_path):
    assert not write_road(tmp_path / "run.xodr", replace(drive(), ego=np.zeros((0, 4))))
    assert list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_asams_checkers_find_no_issue(tmp_path):
    given = drive(users(left_m=3.4, heading_rad=math.pi), users(left_m=-3.1, track_id=4))
    rows = given.rows
    rows[:, 12:] = [4.5, 1.8, 1.5, 0.3, 0.1, 0.1]
    written(tmp_path, given)
    write_scenario(tmp_path / "run.xosc", given, road="run.xodr")
    for name in ("run.xodr", "run.xosc"):
        assert issues_of(tmp_path / name, tmp_path) == []
    # a road that is wrong is found
    text = (tmp_path / "run.xodr").read_text()
    (tmp_path / "run.xodr").write_text(re.sub(r'dU="[^"]*+"', 'dU="0.7"', text))
    assert issues_of(tmp_path / "run.xodr", tmp_path) != []

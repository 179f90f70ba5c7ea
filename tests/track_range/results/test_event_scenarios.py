"""A scenario of each event: as measured with its declared parameters, and varied with others."""

import math
import re
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from tests.support.results.events import event
from track_range.results.event_scenarios import write_event_scenarios
from track_range.results.formats.adas.openscenario_file import (
    N_VALUES,
    Trajectories,
    write_scenario,
)

CAR, EGO_MPS, CAR_MPS = 2, 10.0, 8.0
TIMES_S = np.arange(0.0, 20.0, 0.5)
EVENT = event(
    kind="cut_in",
    start_s=8.0,
    peak_s=10.0,
    end_s=11.0,
    track_id=3,
    peak_ttc_s=5.0,
    peak_probability=0.5,
)


@pytest.fixture
def drive():
    """The ego vehicle drives along y, a car ahead is slower; one more car stands."""
    n = len(TIMES_S)
    ego = np.stack([TIMES_S, np.zeros(n), EGO_MPS * TIMES_S, np.full(n, np.pi / 2)], axis=1)
    rows = np.zeros((n, N_VALUES))
    y_m = 30 + CAR_MPS * TIMES_S
    gap_m = y_m - EGO_MPS * TIMES_S - 1.5
    rows[:, :5] = np.stack(
        [TIMES_S, np.full(n, -1.0), y_m, np.full(n, np.pi / 2), np.ones(n)], axis=1
    )
    rows[:, 12:] = [4.5, 1.8, 1.5, 0.3, 0.1, 0.1]
    rows[:, 6:12] = np.column_stack(
        [np.tile([3, CAR], (n, 1)), gap_m, *np.tile([[1.0], [CAR_MPS], [EGO_MPS]], n)]
    )
    other = rows.copy()
    other[:, [1, 5, 6]] = [9.0, 1.0, 4.0]
    return Trajectories(ego=ego, rows=np.concatenate([rows, other]), start_utc_s=None)


def root_of(path):
    return ElementTree.parse(path).getroot()  # noqa: S314 - a file of this test


def declared(root):
    return {node.get("name"): node.get("value") for node in root.iter("ParameterDeclaration")}


def value_of(text, parameters):
    """The value of a number or of an expression, as a simulator has it."""
    given = re.fullmatch(r"\$\{([ \w+\-*/$().,]*)\}", text)
    if given is None:
        return float(text)
    plain = re.sub(r"\$(\w+)", lambda name: f"({parameters[name[1]]})", given[1])
    return eval(plain, {"__builtins__": {}})  # noqa: S307 - an expression of numbers


def trajectory(root, name, **other):
    """(N, 3) time, x and y of an object with the declared parameters, or others."""
    parameters = {**declared(root), **other}
    path = root.find(f".//Trajectory[@name='{name} path']")
    group = root.find(f".//ManeuverGroup[@name='{name}']")
    timing = group.find(".//Timing")
    scale, offset = (value_of(timing.get(key), parameters) for key in ("scale", "offset"))
    rows = []
    for vertex in path.iter("Vertex"):
        place = vertex.find(".//WorldPosition")
        x, y = (value_of(place.get(key), parameters) for key in "xy")
        rows.append([float(vertex.get("time")) * scale + offset, x, y])
    return np.array(rows)


@pytest.fixture
def scenario(drive, tmp_path):
    assert write_event_scenarios(drive, [EVENT], tmp_path) == ["01-cut_in-3.xosc"]
    return tmp_path / "01-cut_in-3.xosc"


def test_valid_by_the_schema(scenario):
    xmlschema = pytest.importorskip("xmlschema", reason="xmlschema is not installed (extra dev)")
    schemas = pytest.importorskip(
        "schemas", reason="scenariogeneration is not installed (extra dev)"
    )
    folder = Path(next(iter(schemas.__path__)))
    xmlschema.XMLSchema(folder / "OpenSCENARIO_1_2.xsd").validate(scenario)


def test_parameters_are_those_of_the_most_critical_frame(scenario):
    assert declared(root_of(scenario)) == {
        "kind": "cut_in",
        "track": "car-3",
        "gap_m": "8.500",  # 30 - 1.5 - 2 * 10
        "lateral_offset_m": "-1.000",  # 1 m to the right
        "ego_mps": "10.000",
        "object_mps": "8.000",
        "ttc_s": "5.000",
        "probability": "0.500",
        "peak_s": "5.000",  # the scenario starts at 5 s
        "start_gap_m": "12.500",
    }


def test_as_measured_with_the_declared_parameters(scenario, drive, tmp_path):
    write_scenario(tmp_path / "plain.xosc", drive.between(5.0, 13.0))
    ours, plain = root_of(scenario), root_of(tmp_path / "plain.xosc")
    assert declared(plain) == {}
    for name in ("ego", "car-3", "car-4"):
        np.testing.assert_allclose(trajectory(ours, name), trajectory(plain, name), atol=1e-9)
    assert trajectory(ours, "ego")[-1].tolist() == [8.0, 0.0, 130.0]


def test_other_parameters_vary_the_scene_around_its_frame(scenario):
    root = root_of(scenario)
    measured, ego = trajectory(root, "car-3"), trajectory(root, "ego")
    nearer = trajectory(root, "car-3", gap_m=5.5, lateral_offset_m=0.0)
    # 3 m nearer along y, and from 1 m on the right to the middle: along -x
    np.testing.assert_allclose(
        nearer - measured, np.tile([0, -1, -3], (len(measured), 1)), atol=1e-3
    )
    fast = trajectory(root, "ego", ego_mps=20.0)
    np.testing.assert_allclose(np.diff(fast[:, 2]) / np.diff(fast[:, 0]), 20.0)
    at_peak = np.flatnonzero(ego[:, 0] == 5.0)[0]
    np.testing.assert_allclose(fast[at_peak], ego[at_peak])
    slow = trajectory(root, "car-3", object_mps=4.0)
    np.testing.assert_allclose(np.diff(slow[:, 2]) / np.diff(slow[:, 0]), 4.0)


def test_events_without_positions_have_no_scenario(drive, tmp_path):
    absent, late = replace(EVENT, track_id=99), replace(EVENT, start_s=90, peak_s=91, end_s=92)
    assert write_event_scenarios(drive, [absent, EVENT, late], tmp_path) == ["02-cut_in-3.xosc"]


def test_unknown_values_and_standing_road_users_are_no_parameters(drive, tmp_path):
    rows = drive.rows.copy()
    rows[:, 8:12] = [math.nan, 1.0, 0.0, math.nan]
    quiet = replace(EVENT, peak_ttc_s=math.nan)
    (name,) = write_event_scenarios(replace(drive, rows=rows), [quiet], tmp_path)
    root = root_of(tmp_path / name)
    assert declared(root).keys().isdisjoint({"gap_m", "ego_mps", "ttc_s", "start_gap_m"})
    moved = trajectory(root, "car-3", object_mps=5.0) - trajectory(root, "car-3")
    assert np.abs(moved).max() == 0

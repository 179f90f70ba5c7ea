"""`track-range evaluate events` against what happens in a recording, as listed by eye."""

import json
import math

import pytest
from hypothesis import given, settings, strategies as st

import track_range as tr
from tests.support.command_line import run_command
from tests.support.results.events import event
from track_range.evaluation.events.occurrences import (
    Occurrence,
    end_of,
    occurrence_scores,
    read_occurrences,
)
from track_range.foundation.errors import UsageError
from track_range.results.events.files import EventFileError, events_text

HEADER = (
    "what,class,own_car,first_visible_frame,conflict_frame,nearest_frame,frame_tolerance,warning,"
    "first_visible_s,conflict_s,nearest_s\n"
)
# 20 frames per second; the tolerance is 0.1 s
TURNS_IN = '"sedan turns in, we swerve",car,near,40,80,120,2,right,2.0,4.0,6.0\n'
SCOOTER = "a scooter passes,motorcycle,no,20,,60,2,tolerated,1.0,,3.0\n"
FAR = "a car far away,car,no,100,,160,2,false,5.0,,8.0\n"
CUT = "cut to the rear,,no,200,,200,2,false,10.0,,10.0\n"


def warning(warning_s, **changes):
    return event(**{"start_s": warning_s, "warning_s": warning_s, "end_s": warning_s, **changes})


@pytest.fixture
def listed(tmp_path):
    path = tmp_path / "1_events.csv"
    path.write_text(HEADER + TURNS_IN + SCOOTER + FAR + CUT)
    return path


def scored(listed, *warnings):
    part_s = (0.0, 10.0)
    return occurrence_scores(warnings, read_occurrences(listed), part_s=part_s, hours=0.01)


def outcomes(scores):
    return [row["outcome"] for row in scores["occurrences"]]


def test_rows_of_a_file(listed):
    turns_in, scooter, _, cut = read_occurrences(listed)
    assert turns_in == Occurrence(
        "sedan turns in, we swerve", "car", 2.0, 4.0, 6.0, pytest.approx(0.1), "right"
    )
    assert math.isnan(scooter.conflict_s)
    assert cut.class_name == ""
    assert end_of([turns_in, cut]) == 10.0
    assert end_of([turns_in]) == math.inf


@pytest.mark.parametrize(
    ("warning_s", "outcome", "lead_s"),
    [
        (1.89, "missed", None),  # before it is seen, by more than the tolerance
        (1.91, "hit", 2.09),
        (4.09, "hit", -0.09),
        (4.11, "late", -0.11),
        (6.09, "late", -2.09),
        (6.11, "missed", None),
    ],
)
def test_a_warning_is_right_from_first_sight_to_the_conflict(tmp_path, warning_s, outcome, lead_s):
    path = tmp_path / "events.csv"
    path.write_text(HEADER + TURNS_IN)
    scores = scored(path, warning(warning_s))
    row = scores["occurrences"][0]
    assert (row["outcome"], row["lead_s"]) == (outcome, lead_s)
    overall = scores["overall"]
    assert overall["hits"] == (outcome == "hit")
    assert overall["misses"] == (outcome != "hit")
    assert overall["late"] == (outcome == "late")
    assert overall["false_alarms"] == (outcome == "missed")
    assert overall["lead_s"] == ([lead_s] if outcome == "hit" else [])


@pytest.mark.parametrize(
    ("one", "outcome"),
    [
        (warning(2.0, class_name="motorcycle"), "tolerated"),
        (warning(2.0, class_name="bicycle"), "tolerated"),
        (warning(2.0, class_name="person", kind="pedestrian_on_path"), "tolerated"),  # the rider
        (warning(7.0), "false_alarm"),
        (warning(2.5, class_name="truck"), "hit"),
        (warning(7.0, class_name="person", kind="pedestrian_on_path"), "false_alarm"),
        (warning(9.0), "false_alarm"),
        (warning(9.95), "false_alarm"),  # at the cut, which is no road user
    ],
)
def test_what_a_warning_is(listed, one, outcome):
    scores = scored(listed, one)
    assert [row["outcome"] for row in scores["warnings"]] == [outcome]
    assert 4 not in scores["warnings"][0]["fits_rows"]
    assert scores["overall"]["false_alarms"] == (outcome == "false_alarm")
    assert scores["overall"]["tolerated"] == (outcome == "tolerated")


def test_nothing_warned(listed):
    scores = scored(listed)
    assert outcomes(scores) == ["missed", "quiet", "quiet", "cut"]
    assert scores["by_kind"]["forward_collision"]["misses"] == 1
    assert scores["overall"]["false_alarms_per_hour_95"] == pytest.approx([0.0, 368.888], abs=0.01)


def test_a_warning_that_fits_two_rows_says_so(listed):
    scores = scored(listed, warning(5.5), warning(5.6))
    assert [row["fits_rows"] for row in scores["warnings"]] == [[1, 3], [1, 3]]
    assert [row["outcome"] for row in scores["warnings"]] == ["late", "repeated"]
    assert scores["overall"]["ambiguous"] == 2
    assert scores["overall"]["repeated"] == 1


def test_two_road_users_at_once(tmp_path):
    """Two warnings that fit two rows belong to one each."""
    path = tmp_path / "events.csv"
    path.write_text(HEADER + TURNS_IN + TURNS_IN)
    scores = scored(path, warning(3.0), warning(3.5))
    assert outcomes(scores) == ["hit", "hit"]
    assert scores["overall"]["lead_s"] == [1.0, 0.5]


def test_rows_outside_of_the_evaluated_part(listed):
    occurrences = read_occurrences(listed)
    scores = occurrence_scores([], occurrences, part_s=(0.0, 3.5), hours=0.01)
    assert outcomes(scores) == ["not_evaluated", "quiet", "not_evaluated", "cut"]
    assert scores["overall"]["misses"] == 0
    scores = occurrence_scores([warning(3.0)], occurrences, part_s=(0.0, 3.5), hours=0.01)
    assert outcomes(scores)[0] == "hit"


@settings(max_examples=40, deadline=None)
@given(
    st.permutations([TURNS_IN, SCOOTER, FAR, CUT]),
    st.lists(
        st.tuples(st.floats(0, 10), st.sampled_from(["car", "person", "motorcycle"])), max_size=5
    ),
)
def test_the_order_of_the_rows_does_not_matter(tmp_path_factory, rows, given_warnings):
    """Unsorted rows give the same counts, and each warning counts once."""
    folder = tmp_path_factory.mktemp("orders")
    (folder / "a.csv").write_text(HEADER + TURNS_IN + SCOOTER + FAR + CUT)
    (folder / "b.csv").write_text(HEADER + "".join(rows))
    warnings = [warning(time_s, class_name=name) for time_s, name in given_warnings]
    first, second = (scored(folder / name, *warnings) for name in ("a.csv", "b.csv"))
    assert first["overall"] == second["overall"]
    counts = [row["outcome"] for row in first["warnings"]]
    assert len(counts) == len(warnings)
    assert counts.count("false_alarm") == first["overall"]["false_alarms"]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (",right,", ",,", "right, tolerated or false for warning"),
        (",right,", ",maybe,", "right, tolerated or false for warning"),
        (",car,near,", ",dragon,near,", "classes person.*dragon"),
        (",car,near,", ",traffic light,near,", "classes person.*traffic light"),
        (",car,near,", ",,near,", "classes person"),
        ("right,2.0,", "right,,", "first_visible_s"),
        ("right,2.0,", "right,-2,", "first_visible_s"),
        ("4.0,6.0", ",6.0", "seconds from first_visible_s for conflict_s, got ''"),
        ("4.0,6.0", "1.5,6.0", "seconds from first_visible_s for conflict_s, got '1.5'"),
        ("4.0,6.0", "4.0,1.0", "seconds from first_visible_s for nearest_s, got '1.0'"),
        ("4.0,6.0", "4.0,", "nearest_s"),
        ("4.0,6.0", "soon,6.0", "conflict_s"),
        (",2,right", ",-2,right", "frame_tolerance"),
        (",2,right", ",two,right", "frame_tolerance"),
        ("40,80,120,2", ",,,2", "frame_tolerance.*'2'"),
    ],
)
def test_faults_of_a_row(tmp_path, old, new, words):
    path = tmp_path / "events.csv"
    assert old in TURNS_IN
    path.write_text(HEADER + TURNS_IN.replace(old, new))
    with pytest.raises(EventFileError, match=rf"events.csv, line 2: expected .*{words}") as error:
        read_occurrences(path)
    assert str(error.value).count(". ") == 0


def test_a_right_warning_needs_a_conflict(tmp_path):
    path = tmp_path / "events.csv"
    path.write_text("class,first_visible_s,nearest_s,warning\ncar,1,3,false\ncar,1,3,right\n")
    expected = (
        "line 3: expected seconds from first_visible_s for conflict_s, got no column conflict_s"
    )
    with pytest.raises(EventFileError, match=expected):
        read_occurrences(path)


@pytest.mark.parametrize("name", ["class", "first_visible_s", "nearest_s", "warning"])
def test_a_missing_column(tmp_path, name):
    path = tmp_path / "events.csv"
    columns = {"class": "car", "first_visible_s": "1", "nearest_s": "3", "warning": "false"}
    del columns[name]
    path.write_text(f"{','.join(columns)}\n{','.join(columns.values())}\n")
    with pytest.raises(EventFileError, match=rf"events.csv: no column {name}"):
        tr.evaluate.events(events_file(tmp_path), path)


def events_file(folder, *events):
    path = folder / "run.csv"
    path.write_text(events_text(events))
    return path


def run_folder(folder, seconds, *events):
    """A run of a video of some seconds, with these events."""
    folder.mkdir()
    (folder / "events.csv").write_text(events_text(events))
    (folder / "summary.json").write_text(json.dumps({"events": {"hours": seconds / 3600}}))
    return folder


def test_seconds_alone_are_enough(tmp_path):
    path = tmp_path / "events.csv"
    path.write_text("class;first_visible_s;conflict_s;nearest_s;warning\nCar;1,5;2,5;3;Right\n")
    assert read_occurrences(path)[0] == Occurrence("", "car", 1.5, 2.5, 3.0, 0.0, "right")


def test_the_evaluated_part_ends_at_a_cut(tmp_path, listed):
    run = run_folder(tmp_path / "run", 13.0, warning(3.0), warning(11.0))
    figures = tr.evaluate.events(run, listed)
    assert (figures["overall"]["hits"], figures["overall"]["false_alarms"]) == (1, 0)
    assert figures["overall"]["hours"] == pytest.approx(10 / 3600, abs=1e-6)
    assert "ends at 10.00 s" in figures["notes"][0]
    figures = tr.evaluate.events(run, listed, until_s=12.0)
    assert figures["overall"]["false_alarms"] == 1
    assert figures["overall"]["hours"] == pytest.approx(12 / 3600, abs=1e-6)
    assert tr.evaluate.events(run, listed, until_s=12.0, hours=2.0)["overall"]["hours"] == 2.0
    assert (
        "--until 500 is after the end" in tr.evaluate.events(run, listed, until_s=500.0)["notes"][0]
    )


def test_several_drives_and_drives_without_a_contact(tmp_path, listed):
    first = run_folder(tmp_path / "1", 13.0, warning(3.0))
    second = run_folder(tmp_path / "2", 26.0, warning(3.0), warning(9.0))
    none = tmp_path / "2_events.csv"
    none.write_text(HEADER)
    figures = tr.evaluate.events([first, second], [listed, none])
    assert (figures["overall"]["hits"], figures["overall"]["false_alarms"]) == (1, 2)
    assert figures["overall"]["hours"] == pytest.approx(36 / 3600, abs=1e-5)
    assert figures["overall"]["false_alarms_per_hour_95"] == pytest.approx([24.22, 722.5], rel=1e-3)
    assert [drive["overall"]["hits"] for drive in figures["drives"]] == [1, 0]
    assert figures["by_kind"]["forward_collision"]["false_alarms"] == 2
    figures = tr.evaluate.events([first, second], "none")
    assert figures["overall"]["false_alarms"] == 3
    with pytest.raises(UsageError, match="expected a truth= for each events="):
        tr.evaluate.events([first, second], listed)
    with pytest.raises(UsageError, match="hours"):
        tr.evaluate.events([first, second], "none", hours=3.0)


def test_command(tmp_path, listed):
    run = run_folder(tmp_path / "run", 13.0, warning(3.0), warning(9.0))
    out = tmp_path / "scores.json"
    done = run_command(
        "evaluate", "events", "--events", run, "--truth", listed, "--events", run, "--truth", "none",
        "--json", out,
    )  # fmt: skip
    assert done.status == 0
    assert "What happens" in done.stdout
    assert json.loads(out.read_text())["overall"]["false_alarms"] == 3


@pytest.mark.real
def test_the_given_files(shared_data):
    """Every file can be read, and at most one row of a file is right."""
    files = sorted((shared_data / "crashes").glob("*_events.csv"))
    if not files:
        pytest.skip("no crashes/*_events.csv in the real data")
    for path in files:
        rows = read_occurrences(path)
        assert all(0 < row.tolerance_s < 0.3 for row in rows)
        assert sum(row.warning == "right" for row in rows) <= 1

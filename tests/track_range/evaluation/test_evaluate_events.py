"""`track-range evaluate events`: hits, misses, false alarms and leads of hand-made cases."""

import json
import math

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import track_range as tr
from tests.support.command_line import run_command
from tests.support.results.events import event
from track_range.evaluation.events.scores import (
    Contact,
    contact_scores,
    event_scores,
    objects_by_time,
    read_contacts,
)
from track_range.foundation.errors import UsageError, UserError
from track_range.results.events.event import EVENT_KINDS, WARNING_KINDS
from track_range.results.events.files import EventFileError, events_text, read_events
from track_range.results.rows.columns import column_names

CAR, CHILD = Contact(3, "car", 10.0), Contact(8, "person", 20.0)


def warning(warning_s, **changes):
    return event(
        **{"warning_s": warning_s, "start_s": warning_s, "end_s": warning_s + 2, **changes}
    )


def counts(section):
    return section["hits"], section["misses"], section["false_alarms"]


def test_hits_misses_and_false_alarms():
    events = [
        warning(7.5),
        warning(19.5, kind="pedestrian_on_path", class_name="person"),  # 0.5 s before the contact
        warning(30.0, kind="cut_in"),
        event(kind="close_following", warning_s=math.nan),
        event(kind="forward_collision", warning_s=math.nan),
    ]
    scores = contact_scores(events, [3, 8, 4, 3, None], [CAR, CHILD], hours=0.5)
    assert counts(scores["overall"]) == (1, 1, 1)
    assert scores["overall"]["lead_s"] == [2.5]
    assert (scores["overall"]["hours"], scores["overall"]["false_alarms_per_hour"]) == (0.5, 2.0)
    assert list(scores["by_kind"]) == list(WARNING_KINDS)
    assert counts(scores["by_kind"]["forward_collision"]) == (1, 0, 0)
    assert counts(scores["by_kind"]["pedestrian_on_path"]) == (0, 1, 0)
    assert counts(scores["by_kind"]["cut_in"]) == (0, 0, 1)
    assert [row["lead_s"] for row in scores["contacts"]] == [2.5, 0.5]
    assert [row["warning_s"] for row in scores["false_warnings"]] == [30.0]


@pytest.mark.parametrize(
    ("lead_s", "is_hit"), [(0.8, True), (0.79, False), (0.0, False), (-1.0, False)]
)
def test_shortest_lead(lead_s, is_hit):
    scores = contact_scores([warning(10.0 - lead_s)], [3], [CAR], hours=1.0)
    assert counts(scores["overall"]) == (int(is_hit), int(not is_hit), 0)
    assert scores["overall"]["lead_s"] == ([lead_s] if is_hit else [])


@pytest.mark.parametrize("kind", WARNING_KINDS)
def test_a_warning_of_any_kind_hits(kind):
    scores = contact_scores([warning(8.0, kind=kind)], [3], [CAR], hours=1.0)
    assert counts(scores["by_kind"][kind]) == (1, 0, 0)


@pytest.mark.parametrize("kind", sorted(set(EVENT_KINDS) - set(WARNING_KINDS)))
def test_other_events_neither_hit_nor_alarm(kind):
    assert counts(contact_scores([warning(8.0, kind=kind)], [3], [CAR], hours=1.0)["overall"]) == (
        0,
        1,
        0,
    )


def test_lead_is_that_of_the_first_warning():
    scores = contact_scores([warning(9.9), warning(6.0), warning(8.0)], [3, 3, 3], [CAR], hours=1.0)
    assert scores["overall"]["lead_s"] == [4.0]
    assert counts(scores["overall"]) == (1, 0, 0)


def test_missed_contacts_count_for_the_expected_kind():
    scores = contact_scores([], [], [CAR, CHILD], hours=1.0)
    assert counts(scores["by_kind"]["forward_collision"]) == (0, 1, 0)
    assert counts(scores["by_kind"]["pedestrian_on_path"]) == (0, 1, 0)
    assert counts(scores["overall"]) == (0, 2, 0)


def test_two_contacts_with_one_object():
    contacts = [Contact(3, "car", 10.0), Contact(3, "car", 20.0)]
    scores = contact_scores([warning(12.0), warning(25.0)], [3, 3], contacts, hours=1.0)
    assert [row["lead_s"] for row in scores["contacts"]] == [None, 8.0]
    assert counts(scores["overall"]) == (1, 1, 0)


def test_nothing_at_all():
    scores = contact_scores([], [], [], hours=None)
    assert scores["overall"] == {
        "hits": 0,
        "misses": 0,
        "false_alarms": 0,
        "hours": None,
        "false_alarms_per_hour": None,
        "false_alarms_per_hour_95": None,
        "lead_s": [],
    }


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(st.sampled_from(EVENT_KINDS), st.floats(0, 50), st.integers(0, 3)), max_size=8
    ),
    st.lists(
        st.tuples(st.integers(0, 3), st.sampled_from(["car", "person"]), st.floats(0, 50)),
        max_size=4,
    ),
)
def test_kinds_add_up(some, contacts):
    events = [warning(time_s, kind=kind) for kind, time_s, _ in some]
    scores = contact_scores(
        events, [number for _, _, number in some], [Contact(*row) for row in contacts], hours=1.0
    )
    sections = scores["by_kind"].values()
    assert counts(scores["overall"]) == tuple(
        sum(part) for part in zip(*map(counts, sections), strict=True)
    )
    assert scores["overall"]["hits"] + scores["overall"]["misses"] == len(contacts)
    assert scores["overall"]["hits"] == len(scores["overall"]["lead_s"])
    assert min(scores["overall"]["lead_s"], default=1.0) >= 0.8


# -- labelled events
# --------------------------------------------------------------------------------------------------


def test_labelled_events():
    labels = [
        event(kind="cut_in", start_s=5, peak_s=6, end_s=7),
        event(kind="near_miss", start_s=20, end_s=21),
    ]
    events = [
        event(kind="cut_in", start_s=6.5, end_s=9, warning_s=math.nan),
        event(kind="cut_in", start_s=30, end_s=31),
        event(kind="hard_approach", start_s=20, end_s=21),
    ]
    scores = event_scores(events, labels, hours=2.0)
    assert counts(scores["overall"]) == (1, 1, 2)
    assert scores["overall"]["lead_s"] == [-0.5]
    assert counts(scores["by_kind"]["cut_in"]) == (1, 0, 1)
    assert counts(scores["by_kind"]["near_miss"]) == (0, 1, 0)
    assert counts(scores["by_kind"]["hard_approach"]) == (0, 0, 1)
    assert scores["by_kind"]["cut_in"]["false_alarms_per_hour"] == 0.5


def test_labelled_events_match_one_to_one():
    label = event(kind="cut_in", start_s=5, peak_s=6, end_s=7)
    near, far = (
        event(kind="cut_in", start_s=5, peak_s=6, end_s=7),
        event(kind="cut_in", start_s=7.9, end_s=9),
    )
    assert counts(event_scores([far, near], [label], hours=None)["overall"]) == (1, 0, 1)
    assert counts(event_scores([far, near], [label, label], hours=None)["overall"]) == (2, 0, 0)
    assert counts(
        event_scores([far], [event(kind="cut_in", start_s=5, end_s=6.8)], hours=None)["overall"]
    ) == (0, 1, 1)
    person = event(kind="cut_in", start_s=5, end_s=7, class_name="person")
    assert counts(event_scores([person], [label], hours=None)["overall"]) == (0, 1, 1)


# -- objects without tracks
# -------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("events", "objects"),
    [
        ([warning(8.0, track_id=3), warning(8.5, track_id=5)], [3, None]),
        ([warning(8.0, track_id=6), warning(8.5, track_id=5)], [3, 3]),
        ([warning(8.0, class_name="truck")], [3]),
        ([warning(8.0, class_name="person")], [None]),
        ([warning(18.0, class_name="person", kind="pedestrian_on_path")], [8]),
        ([warning(12.5)], [None]),
        ([warning(10.5)], [3]),
        ([event(kind="near_miss", warning_s=8.0, start_s=8.0)], [None]),
    ],
)
def test_objects_by_number_class_and_time(events, objects):
    assert objects_by_time(events, [CAR, CHILD]) == objects


# -- files
# ------------------------------------------------------------------------------------------------------------

CONTACTS = "object_id,class,contact_s\n"
N_FRAMES, FPS = 40, 10.0


def box_of(object_id, frame):
    """Box of one of three objects, which move to the right."""
    left = 100.0 + 150 * object_id + frame
    return [left, 100.0, left + 60, 160.0]


@pytest.fixture
def folders(tmp_path):
    """A drive of 4 s: objects 0, 1, 2 are tracks 11, 12, 13; a contact with 0 at 3 s, warnings on
    11 and 12."""
    run, drive = tmp_path / "run", tmp_path / "drive"
    run.mkdir()
    drive.mkdir()
    (drive / "contacts.csv").write_text(f"{CONTACTS}0,car,3.0\n")
    truth = ["frame,time_s,id,class,x1,y1,x2,y2,visible_share,distance_m,closing_mps,lane"]
    rows = [",".join(column_names())]
    for frame in range(N_FRAMES):
        for object_id, name in enumerate(("car", "car", "truck")):
            box = ",".join(f"{edge:g}" for edge in box_of(object_id, frame))
            truth.append(
                f"{frame},{frame / FPS},{object_id},{name},{box},1.0,{35 - frame / 2},5.0,0"
            )
            values = {
                "frame": frame,
                "time_s": frame / FPS,
                "track_id": 11 + object_id,
                "class": "car",
                "score": 0.9,
                "observed": 1,
                **dict(zip(("x1_px", "y1_px", "x2_px", "y2_px"), box.split(","), strict=True)),
                "closing_mps": 5.5 if name == "car" else 3.0,
                "closing_sigma_mps": 0.5,
                "contact_probability": 0.25,
            }
            rows.append(",".join(str(values.get(column, "")) for column in column_names()))
    (drive / "truth.csv").write_text("\n".join(truth) + "\n")
    (run / "tracks.csv").write_text("\n".join(rows) + "\n")
    events = [
        event(track_id=11, start_s=0.5, warning_s=0.7, end_s=2.5),
        event(track_id=12, start_s=1.0, warning_s=1.2, end_s=2.0),
    ]
    (run / "events.csv").write_text(events_text(events))
    return tmp_path


def evaluated(folder, **options):
    return tr.evaluate.events(folder / "run/events.csv", folder / "drive/contacts.csv", **options)


def test_objects_by_boxes(folders):
    figures = evaluated(folders)
    assert counts(figures["overall"]) == (1, 0, 1)
    assert figures["overall"]["lead_s"] == [2.3]
    assert figures["overall"]["hours"] == pytest.approx(N_FRAMES / FPS / 3600, abs=1e-6)
    assert figures["overall"]["false_alarms_per_hour"] == pytest.approx(900, rel=1e-3)
    assert figures["notes"] == []
    assert "IoU" in figures["protocol"]
    assert [row["track_id"] for row in figures["false_warnings"]] == [12]


def test_a_run_that_could_not_warn(folders):
    """Without a probability of contact, as of cameras to the side, no false alarm shows nothing."""
    path = folders / "run/tracks.csv"
    path.write_text(path.read_text().replace("0.25", ""))
    for truth in (folders / "drive/contacts.csv", "none"):
        notes = tr.evaluate.events(folders / "run", truth)["notes"]
        assert any("could not warn" in note for note in notes)


def test_closing_speeds_by_class(folders):
    closing = evaluated(folders)["closing"]
    assert list(closing) == ["car", "truck", "tall vehicles"]
    assert closing["car"]["median_error_mps"] == pytest.approx(0.5)
    assert closing["truck"] == closing["tall vehicles"]
    assert closing["truck"]["bias_mps"] == pytest.approx(-2.0)
    labels = [
        f"{frame} 1 Van 0 0 0 {' '.join(f'{edge:g}' for edge in box_of(1, frame))} 2 2 5 0 1.7 20 0\n"
        for frame in range(N_FRAMES)
    ]
    (folders / "drive/truth.txt").write_text("".join(labels))
    assert evaluated(folders)["closing"]["tall vehicles"]["n"] == 2 * closing["truck"]["n"]


def test_hours_of_the_summary(folders):
    (folders / "run/summary.json").write_text(
        json.dumps({"events": {"hours": 0.5}, "starts_s": 0.0})
    )
    assert evaluated(folders)["overall"]["false_alarms_per_hour"] == 2.0
    assert evaluated(folders, hours=2.0)["overall"]["false_alarms_per_hour"] == 0.5
    (folders / "run/summary.json").write_text("{")
    figures = evaluated(folders)
    assert figures["overall"]["hours"] == pytest.approx(N_FRAMES / FPS / 3600, abs=1e-6)
    assert "summary.json" in figures["notes"][0]


def test_contacts_outside_the_processed_part(folders):
    (folders / "drive/contacts.csv").write_text(
        f"{CONTACTS}0,car,3.0\n1,car,3.0\n2,truck,3.5\n2,truck,0.2\n"
    )
    (folders / "run/summary.json").write_text(
        json.dumps({"events": {"hours": 2 / 3600}, "starts_s": 0.5})
    )
    figures = evaluated(folders)
    assert [row["object_id"] for row in figures["contacts"]] == [0, 1]  # with warnings
    assert counts(figures["overall"]) == (2, 0, 0)
    assert any(note.startswith("2 of 4 contacts") for note in figures["notes"])


def test_options_and_folder(folders):
    (folders / "run/tracks.csv").rename(folders / "rows.csv")
    (folders / "drive/truth.csv").rename(folders / "labels.csv")
    without = evaluated(folders)
    assert any("--tracks" in note for note in without["notes"])
    given = tr.evaluate.events(
        folders / "run",
        folders / "drive/contacts.csv",
        tracks=folders / "rows.csv",
        boxes=folders / "labels.csv",
    )
    assert counts(given["overall"]) == (1, 0, 1)
    assert counts(evaluated(folders, min_lead_s=2.5)["overall"])[0] == 0
    with pytest.raises(UsageError, match=r"^hours: "):
        evaluated(folders, hours=0)


def test_only_the_two_files(tmp_path):
    events, contacts = tmp_path / "events.csv", tmp_path / "contacts.csv"
    events.write_text(
        events_text([warning(7.0, track_id=3, end_s=11.0), warning(40.0, track_id=9, end_s=45.0)])
    )
    contacts.write_text(f"{CONTACTS}3,car,10.0\n8,Pedestrian,20.0\n")
    figures = tr.evaluate.events(events, contacts, hours=2)
    assert counts(figures["overall"]) == (1, 1, 1)
    assert (figures["overall"]["lead_s"], figures["overall"]["false_alarms_per_hour"]) == (
        [3.0],
        0.5,
    )
    figures = tr.evaluate.events(events, contacts)
    assert figures["overall"]["hours"] == pytest.approx(0.0125)
    assert any("--hours" in note for note in figures["notes"])


def test_labelled_events_in_a_file(folders):
    (folders / "labels.csv").write_text(
        "kind,start_s,end_s,class\nforward_collision,0.4,2.0,car\ncut_in,3,4,\n"
    )
    figures = tr.evaluate.events(folders / "run/events.csv", folders / "labels.csv")
    assert counts(figures["overall"]) == (1, 1, 1)
    assert "closing" not in figures


def test_files_without_rows(tmp_path):
    events, contacts = tmp_path / "events.csv", tmp_path / "contacts.csv"
    events.write_text(events_text(()))
    contacts.write_text(CONTACTS)
    figures = tr.evaluate.events(events, contacts)
    assert counts(figures["overall"]) == (0, 0, 0)
    assert (figures["overall"]["hours"], figures["overall"]["false_alarms_per_hour"]) == (
        None,
        None,
    )
    json.dumps(figures, allow_nan=False)
    assert counts(tr.evaluate.events(events, events)["overall"]) == (0, 0, 0)


def test_events_of_another_video(folders):
    with (folders / "run/events.csv").open("a") as file:
        file.write(
            events_text([event(start_s=99, warning_s=99.0, end_s=100)]).splitlines()[1] + "\n"
        )
    assert any(note.startswith("1 of 3 events") for note in evaluated(folders)["notes"])


def test_labels_of_another_drive(folders):
    (folders / "drive/contacts.csv").write_text(f"{CONTACTS}77,car,3.0\n")
    figures = evaluated(folders)
    assert counts(figures["overall"]) == (0, 1, 2)
    assert any("77" in note for note in figures["notes"])


@pytest.mark.parametrize(
    ("content", "word"),
    [
        ("", "contacts"),
        ("frame,id\n1,2\n", "none of them"),
        ("object_id,class\n1,car\n", "contact_s"),
        (f"{CONTACTS}1,car\n", "cells"),
        (f"{CONTACTS}1,car,nan\n", "contact_s"),
        (f"{CONTACTS}1,car,-2\n", "contact_s"),
        (f"{CONTACTS}1.5,car,2\n", "object_id"),
        (f"{CONTACTS}1,dragon,2\n", "classes"),
        ("kind,start_s\ncut_in,1\n", "end_s"),
        ("kind,start_s,end_s\ncrash,1,2\n", "kinds"),
    ],
)
def test_bad_truth(folders, content, word):
    path = folders / "truth.csv"
    path.write_text(content)
    with pytest.raises(EventFileError, match=rf"truth.csv.*{word}"):
        tr.evaluate.events(folders / "run/events.csv", path)


def test_events_without_warnings_column(folders):
    (folders / "run/events.csv").write_text("kind,start_s,end_s\n")
    with pytest.raises(EventFileError, match="warning_s"):
        evaluated(folders)
    with pytest.raises(UserError, match="no such file"):
        tr.evaluate.events(folders / "none.csv", folders / "drive/contacts.csv")
    with pytest.raises(UserError, match="no such file"):
        tr.evaluate.events(folders / "run/events.csv", folders / "none.csv")


def test_contacts_of_a_file(tmp_path):
    path = tmp_path / "contacts.csv"
    path.write_text(f"{CONTACTS}0,Van,3.25\n")
    assert read_contacts(path) == (Contact(0, "car", 3.25),)


@pytest.mark.parametrize("name", ["run/events.csv", "drive/contacts.csv"])
def test_inputs_are_not_replaced(folders, name):
    before = (folders / name).read_bytes()
    done = run_command(
        "evaluate", "events", "--events", folders / "run", "--truth", folders / "drive/contacts.csv", "--json",
        folders / name,
    )  # fmt: skip
    assert done.status != 0
    assert name in done.stderr
    assert (folders / name).read_bytes() == before


def test_command(folders):
    done = run_command(
        "evaluate", "events", "--events", folders / "run", "--truth", folders / "drive/contacts.csv", "--json",
        folders / "scores.json",
    )  # fmt: skip
    assert done.status == 0, done.stderr
    figures = json.loads((folders / "scores.json").read_text())
    assert set(figures["overall"]) == {
        *("hits", "misses", "false_alarms", "hours", "lead_s"),
        *("false_alarms_per_hour", "false_alarms_per_hour_95"),
    }
    assert figures["by_kind"]["forward_collision"] == figures["overall"]
    assert np.isfinite(figures["overall"]["lead_s"]).all()
    assert "forward_collision" in done.stdout
    assert read_events(folders / "run/events.csv")[0].track_id == 11

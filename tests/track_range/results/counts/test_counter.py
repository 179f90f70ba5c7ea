"""Counts at lines and in zones, with hand-made paths."""

from dataclasses import replace

import numpy as np
import pytest

from tests.support.results.frame_results import result
from track_range.results.counts.counter import LineCounter
from track_range.results.counts.files import counts_section, write_crossings
from track_range.results.counts.places import parsed_places

LINE = "gate=0,100,200,100"
ZONE = "yard=0,0,100,0,100,100,0,100"
STEP_S = 0.1


def crossings(path_px, *, lines=(), zones=(), height_px=20.0, rows=(), ids=(), step_s=STEP_S):
    """The counter after a path of one road user, whose lower middles are given; None = no box. `rows`
    are its x_m and speeds in m/s, towards the camera; `ids` its numbers.
    """
    counter = LineCounter.of(lines, zones)
    for number, point in enumerate(path_px):
        first = result(number)
        x, y = point or (0.0, 0.0)
        box = np.array([[x - 5.0, y - height_px, x + 5.0, y]])
        tracks = replace(first.tracks.select(np.array([0])), xyxy_px=box)
        if ids:
            tracks = replace(tracks, track_id=np.array([ids[number]]))
        motion = type(first.world.motion).unknown(1)
        x_m, speed_mps = rows[number] if rows else (np.nan, float(first.world.motion.speed_mps[0]))
        place = {"world_x_m": np.array([x_m]), "world_y_m": np.zeros(1)}
        place["heading_deg"] = np.full(1, 180.0)
        motion = replace(motion, speed_mps=np.array([speed_mps]), **place)
        frame = replace(first.frame, time_s=step_s * number)
        world = replace(first.world, motion=motion)
        seen = replace(first, frame=frame, tracks=tracks, world=world)
        if point is None:
            motion = type(motion).unknown(0)
            none = replace(first.world, motion=motion)
            seen = replace(seen, tracks=tracks.select(np.array([], int)), world=none)
        counter.update(seen)
    counter.finish()
    return counter


def test_a_crossing_has_its_time_between_frames_and_its_direction():
    counter = crossings([(50, 85), (50, 95), (50, 115), (50, 135)], lines=[LINE])
    (one,) = counter.crossings
    assert one.time_s == pytest.approx(0.125)  # a quarter between 95 and 115
    assert (one.direction, one.kind, one.place) == ("down", "line", "gate")
    assert (one.x_px, one.y_px) == pytest.approx((50.0, 100.0))
    assert np.isfinite(one.speed_kmh)


def test_a_point_that_jitters_on_the_line_counts_once():
    jitter = [101, 99, 101, 99.5, 100.5, 99, 101, 100]
    path = [(50, y) for y in (90, *jitter, 110, 120)]
    assert len(crossings(path, lines=[LINE]).crossings) == 1
    back = [(50, y) for y in (90, *jitter, 95, 90)]
    assert crossings(back, lines=[LINE]).crossings == ()


def test_there_and_back_are_two_crossings_and_beside_the_line_none():
    path = [(50, 85), (50, 115), (50, 85)]
    assert [one.direction for one in crossings(path, lines=[LINE]).crossings] == ["down", "up"]
    assert crossings([(250, 85), (250, 115)], lines=[LINE]).crossings == ()


def test_a_track_that_ends_on_the_line_is_not_sure():
    counter = crossings([(50, 80), (50, 99.5), (50, 100.5)], lines=[LINE])
    assert counter.crossings == ()
    assert counter.n_unsure == {"gate": 1}


@pytest.mark.parametrize(
    ("path_px", "rows"),
    [
        ([(50, 80), (50, 90), (50, 110)], [(40.0, 7.0), (39.3, 7.0), (33.0, np.nan)]),
        ([(50, 80), (50, 90), (50, 110)], [(40.0, 7.0), (39.3, 7.0), (20.0, 7.0)]),
        ([(50, 90), *[None] * 15, (50, 110)], [(40.0, 20.0)] * 16 + [(20.0, 20.0)]),
    ],
)
def test_a_track_that_shows_another_object_counts_nothing_and_is_not_sure(path_px, rows):
    counter = crossings(path_px, lines=[LINE], rows=rows)
    assert counter.crossings == ()
    assert counter.n_unsure["gate"] >= 1


def test_a_speed_that_begins_again_at_the_same_place_is_the_same_object():
    rows = [(40.0, 15.0), (38.5, 15.0), (37.0, np.nan), (35.5, np.nan)]
    counter = crossings([(50, 80), (50, 98), (50, 102), (50, 120)], lines=[LINE], rows=rows)
    assert len(counter.crossings) == 1


def test_a_road_user_that_goes_on_under_another_number_counts_once():
    path_px = [(50, 60), (50, 80), None, None, (50, 110), (50, 120)]
    rows = [(40.0 - n, 10.0) for n in range(6)]
    ids = [1, 1, 1, 1, 2, 2]
    counter = crossings(path_px, lines=[LINE], rows=rows, ids=ids)
    (one,) = counter.crossings
    assert (one.track_id, one.direction) == (2, "down")
    assert one.time_s == pytest.approx(0.3)  # two thirds of the way from 80 to 110
    assert counter.n_unsure["gate"] == 0
    far = [*rows[:4], (10.0, 10.0), (9.0, 10.0)]
    assert crossings(path_px, lines=[LINE], rows=far, ids=ids).crossings == ()


def test_frames_that_are_far_apart_in_time_count():
    path_px, rows = [(50, 80), (50, 120)], [(40.0, 10.0), (20.0, 10.0)]
    counter = crossings(path_px, lines=[LINE], rows=rows, step_s=2.0)
    assert len(counter.crossings) == 1


def test_zone_entry_exit_and_stay():
    path = [(-30, 50), (-10, 50), (10, 50), *[(50, 50)] * 20, (90, 50), (110, 50), (130, 50)]
    enter, leave = crossings(path, zones=[ZONE]).crossings
    assert (enter.kind, leave.kind) == ("enter", "exit")
    assert enter.time_s == pytest.approx(0.15)
    assert leave.dwell_s == pytest.approx(leave.time_s - enter.time_s)
    assert leave.mean_speed_kmh > 0
    begun = crossings([(50, 50)] * 3, zones=[ZONE]).crossings  # began and ended inside
    assert [one.kind for one in begun] == ["exit"]


def test_section_and_files(tmp_path):
    counter = crossings([(50, 85), (50, 115), (50, 85)], lines=[LINE], zones=[ZONE])
    section = counts_section(counter.places, counter.crossings, counter.n_unsure)
    assert section["lines"]["gate"]["by_direction"] == {"down": 1, "up": 1}
    assert section["lines"]["gate"]["n"] == 2
    assert set(section["zones"]) == {"yard"}
    write_crossings(tmp_path, counter.crossings, {"program": "test"})
    header, *rows = (tmp_path / "crossings.csv").read_text().splitlines()
    assert header.startswith("time_s,track_id,class,kind,place,direction,speed_kmh")
    assert len(rows) == len(counter.crossings)
    from pyarrow import parquet

    table = parquet.read_table(tmp_path / "crossings.parquet")
    assert table.column("direction").to_pylist() == [one.direction for one in counter.crossings]


@pytest.mark.parametrize(
    ("lines", "zones", "word"),
    [
        (["gate"], [], "X2"),
        (["gate=1,2,3"], [], "X2"),
        (["gate=1,2,1,2"], [], "X2"),
        (["=1,2,3,4"], [], "X2"),
        ([], ["yard=1,2,3,4"], "X3"),
        ([], ["yard=1,2,a,4,5,6"], "X3"),
        (["a=1,2,3,4", "a=5,6,7,8"], [], "twice"),
    ],
)
def test_other_texts_are_refused(lines, zones, word):
    with pytest.raises(ValueError, match=word):
        parsed_places(lines, zones)

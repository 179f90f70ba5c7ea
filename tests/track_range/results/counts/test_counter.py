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


def crossings(path_px, *, lines=(), zones=(), height_px=20.0):
    """The counter after a path of one track, whose lower middles are given; NaN = no box."""
    counter = LineCounter.of(lines, zones)
    for number, (x, y) in enumerate(path_px):
        first = result(number)
        box = np.array([[x - 5.0, y - height_px, x + 5.0, y]])
        tracks = replace(first.tracks.select(np.array([0])), xyxy_px=box)
        rows = {name: getattr(first.world.motion, name)[:1] for name in ("speed_mps",)}
        motion = type(first.world.motion).unknown(1)
        motion = replace(motion, **rows)
        frame = replace(first.frame, time_s=STEP_S * number)
        world = replace(first.world, motion=motion)
        counter.update(replace(first, frame=frame, tracks=tracks, world=world))
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

"""Events found from frames: kinds, times, merging of gaps and tracks, reasons."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
import pytest

from tests.support.results.frame_results import changed, frame_result
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.warning.warnings import Warnings
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import ObjectMotion
from track_range.results.events.event import EVENT_KINDS, Event, EventSettings
from track_range.results.events.finder import EventFinder, events_of
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks

PERSON, CAR, TRUCK = 0, 2, 5
NAN = math.nan


@dataclass(frozen=True, kw_only=True)
class Seen:
    """One track of a frame."""

    distance_m: float
    track_id: int = 1
    class_id: int = CAR
    closing_mps: float = NAN
    offset_m: float = 0.0
    probability: float = 0.0
    active: bool = False


def frame(number: int, *seen: Seen, ego_mps: float = NAN) -> FrameResult:
    """Frame `number` at 10 frames/s with the given tracks."""

    def column(name: str) -> np.ndarray:
        return np.array([getattr(track, name) for track in seen], np.float64)

    n, ids = len(seen), np.array([track.track_id for track in seen], np.int64)
    d, closing = column("distance_m"), column("closing_mps")
    classes = np.array([track.class_id for track in seen], np.int64)
    return frame_result(
        frame=Frame(number, number / 10, np.zeros((1, 1, 3), np.uint8), None),
        tracks=Tracks(ids, np.zeros((n, 4)), classes, np.ones(n), np.ones(n, bool)),
        ranges={"fused_kf": Ranges(ids, d, 0.1 * d)},
        closing_mps=closing,
        closing_sigma_mps=0 * closing,
        ttc_s=d / np.where(closing > 0, closing, NAN),
        ttc_sigma_s=0 * closing,
        xyz_m=np.zeros((n, 3)),
        warnings=Warnings(column("probability"), column("active") > 0, column("offset_m")),
        ego_mps=ego_mps,
    )


def approach(*, n: int = 30, class_id: int = CAR) -> Iterable[FrameResult]:
    """Closing in at 10 m/s from 41.5 m, with an alarm from frame 15 on: 25 m before the front."""
    for i in range(n):
        yield frame(
            i,
            Seen(
                distance_m=41.5 - i,
                closing_mps=10.0,
                class_id=class_id,
                probability=0.9 if i >= 13 else 0.1,
                active=i >= 15,
            ),
            ego_mps=10.0,
        )


def kinds(events: Iterable[Event]) -> list[str]:
    return [event.kind for event in events]


@pytest.mark.parametrize(
    ("class_id", "kind"), [(CAR, "forward_collision"), (PERSON, "pedestrian_on_path")]
)
def test_alarm_is_an_event(class_id: int, kind: str) -> None:
    events = events_of(approach(class_id=class_id))
    assert kinds(events) == [kind]
    event = events[0]
    assert (event.start_s, event.warning_s, event.end_s) == (1.5, 1.5, 2.9)
    assert (event.frame, event.peak_s, event.track_id) == (29, 2.9, 1)
    assert event.min_distance_m == pytest.approx(12.5)
    assert event.min_distance_sigma_m == pytest.approx(1.25)
    assert event.min_ttc_s == pytest.approx(1.1)
    assert (event.closing_mps, event.ego_mps, event.probability) == (10.0, 10.0, 0.9)
    assert "contact in 2.5 s" in event.reason
    assert "closing at 10.0 ± 0.1 m/s" in event.reason
    # c / 2 (TTC - 1 s)
    assert event.reason.endswith(
        "(predicted probability 90 %), which after 1 s of reaction needs 3.3 m/s²."
    )


def test_reason_of_an_alarm_for_a_vehicle_that_moves_into_the_path() -> None:
    """Its probability of contact is too low for an alarm: the headway is the reason."""
    seen = Seen(distance_m=7.0, closing_mps=0.2, probability=0.2, active=True)
    (event,) = events_of(frame(i, seen, ego_mps=20.0) for i in range(5))
    assert event.kind == "forward_collision"
    assert event.reason == (
        "Car ahead at 7.0 ± 0.7 m: it moves into the path at a headway of 0.3 s."
    )


def test_reason_of_an_alarm_without_a_time_to_collision() -> None:
    seen = Seen(distance_m=7.0, probability=0.95, active=True, class_id=PERSON)
    (event,) = events_of(frame(i, seen) for i in range(5))
    assert "contact without braking (predicted probability 95 %)." in event.reason
    assert "nan" not in event.reason


def test_a_deceleration_of_zero_is_no_reason() -> None:
    seen = Seen(distance_m=8.5, closing_mps=0.3, probability=0.9, active=True)
    (event,) = events_of(frame(i, seen, ego_mps=20.0) for i in range(5))
    assert event.reason.endswith("without braking (predicted probability 90 %).")


def test_one_frame_is_no_extreme_of_an_event() -> None:
    """A distance, speed and time of one frame of an alarm, which the frames around it contradict."""

    def results() -> Iterable[FrameResult]:
        for i, result in enumerate(approach()):
            near = Seen(distance_m=5.0, closing_mps=30.0, probability=0.9, active=True)
            yield frame(i, near, ego_mps=10.0) if i == 20 else result

    (event,) = events_of(results())
    assert event.min_distance_m == pytest.approx(12.5)
    assert (event.min_ttc_s, event.gap_m) == pytest.approx((1.1, 11.0))
    assert (event.closing_mps, event.peak_s) == (10.0, 2.9)
    assert event.drac_mps2 < 5.0


def test_measures_of_an_event() -> None:
    """Extremes during the event, exposure from its first frame on, and the state at its peak, the
    last frame."""
    (event,) = events_of(approach())
    assert (event.gap_m, event.headway_s) == (pytest.approx(11.0), pytest.approx(1.1))
    assert event.drac_mps2 == pytest.approx(10.0**2 / (2 * 11.0))
    assert event.mdrac_mps2 == pytest.approx(10.0**2 / (2 * (11.0 - 10.0)))  # reaction time 1 s
    assert event.tet_s == pytest.approx(1.4)
    assert event.tit_s2 == pytest.approx(sum(0.1 * (3.0 - (40 - i) / 10) for i in range(16, 30)))
    peak = (event.peak_distance_m, event.peak_closing_mps, event.peak_ttc_s, event.peak_headway_s)
    assert (*peak, event.peak_probability) == pytest.approx((12.5, 10.0, 1.1, 1.1, 0.9))
    assert math.isnan(event.pet_s)  # without a pose


def test_pet_of_an_event_is_known_at_the_end() -> None:
    """A person leaves the path of 2 x 1.2 m at 40 m after 2.6 s; the front is there after 3.85
    s."""
    finder, nan = EventFinder(), np.full(1, NAN)
    for i in range(61):
        person = Seen(
            distance_m=40.0 - min(i, 30), class_id=PERSON, closing_mps=10.0, active=5 <= i < 20
        )
        motion = ObjectMotion(nan, nan, nan, np.array([40.0]), np.array([-4.0 + 0.2 * i]), nan, nan)
        pose = EgoPose(float(i), 0.0, 0.0, np.zeros((3, 3)))
        for event in finder.update(changed(frame(i, person), motion=motion, ego_pose=pose)):
            assert math.isnan(event.pet_s)  # the camera is not there yet
    (event,) = finder.finish()
    assert event.pet_s == pytest.approx(3.85 - 2.6, abs=0.11)


def test_events_are_returned_once_they_ended() -> None:
    finder = EventFinder()
    assert all(finder.update(result) == () for result in approach())
    assert [finder.update(frame(i)) for i in range(30, 40)] == [()] * 10
    (event,) = finder.update(frame(40))
    assert finder.update(frame(41)) == ()
    assert finder.finish() == (event,)


def test_gaps_and_new_tracks_are_merged() -> None:
    def results() -> Iterable[FrameResult]:
        for i, result in enumerate(approach()):
            if i in (18, 19, 20):
                yield frame(i)
            elif i > 20:
                again = Seen(
                    distance_m=41.5 - i, track_id=8, closing_mps=10.0, probability=0.9, active=True
                )
                yield frame(i, again, ego_mps=10.0)
            else:
                yield result

    (event,) = events_of(results())
    assert (event.start_s, event.end_s, event.track_id) == (1.5, 2.9, 8)


def test_two_objects_are_two_events() -> None:
    pair = [
        frame(
            i,
            *(
                Seen(distance_m=20.0, track_id=k, closing_mps=8.0, probability=0.9, active=True)
                for k in (1, 2)
            ),
        )
        for i in range(10)
    ]
    assert kinds(events_of(pair)) == ["forward_collision"] * 2
    apart = [
        frame(
            i,
            Seen(
                distance_m=20.0 + 30 * (i > 5), track_id=1 + (i > 5), closing_mps=8.0, active=True
            ),
        )
        for i in range(10)
    ]
    assert len(events_of(apart)) == 2


def test_close_following() -> None:
    def following(n: int, *, ego_mps: float = 25.0, gap_m: float = 15.0) -> list[FrameResult]:
        behind = Seen(distance_m=1.5 + gap_m, class_id=TRUCK, closing_mps=0.2)
        return [frame(i, behind, ego_mps=ego_mps) for i in range(n)]

    (event,) = events_of(following(40))
    assert (event.kind, event.headway_s, event.class_name) == (
        "close_following",
        pytest.approx(0.6),
        "truck",
    )
    assert math.isnan(event.warning_s)
    assert "Headway down to 0.6 s behind a truck" in event.reason
    assert "own speed 90 km/h" in event.reason
    assert events_of(following(8)) == ()  # too short
    assert events_of(following(40, ego_mps=NAN)) == ()
    assert events_of(following(40, gap_m=30.0)) == ()
    assert events_of(following(40, ego_mps=3.0)) == ()


def cut_in(*, active: bool) -> list[FrameResult]:
    return [
        frame(
            i,
            Seen(
                distance_m=13.5,
                closing_mps=0.5,
                offset_m=max(3.6 - 0.15 * i, 0.0),
                probability=0.3,
                active=active and 18 <= i < 24,
            ),
            ego_mps=20.0,
        )
        for i in range(60)
    ]


def test_cut_in_without_alarm() -> None:
    events = events_of(cut_in(active=False))
    assert kinds(events) == ["cut_in", "close_following"]
    assert math.isnan(events[0].warning_s)
    assert "Car cut in 14 ± 1 m ahead, at a headway of 0.6 s" in events[0].reason


def test_alarm_during_a_cut_in() -> None:
    events = events_of(cut_in(active=True))
    assert kinds(events) == ["cut_in", "close_following"]
    assert events[0].warning_s == pytest.approx(1.8)


def test_hard_approach_and_near_miss() -> None:
    """Braking from 10 m/s with 6 m/s2 in the last 8.3 m, without an alarm; at the end 1.5 m are
    left."""

    def results() -> Iterable[FrameResult]:
        gap_m, v = 12.0, 10.0
        for i in range(40):
            yield frame(i, Seen(distance_m=1.5 + gap_m, closing_mps=v, probability=0.6))
            v = max(v - 0.6 * (i > 2), 0.0)
            gap_m -= 0.1 * v

    events = events_of(results())
    assert sorted(kinds(events)) == ["hard_approach", "near_miss"]
    assert all(math.isnan(event.warning_s) for event in events)
    near_miss = events[kinds(events).index("near_miss")]
    assert near_miss.reason == (
        "Car at 3.8 ± 0.4 m, closing at 4.0 ± 0.1 m/s: smallest gap to the front 1.3 ± 0.3 m, "
        "smallest time to contact 0.6 s (predicted probability 60 %); by one camera."
    )
    assert "needed braking" in events[kinds(events).index("hard_approach")].reason


@pytest.mark.parametrize(("sigma", "is_excluded"), [(0.1, True), (0.3, False)])
def test_a_near_miss_says_whether_a_contact_is_within_its_errors(
    sigma: float, is_excluded: bool
) -> None:
    """A car that stops 1 m ahead of the front, at 2.5 m with 10 and 30 % as sigma."""

    def results() -> Iterable[FrameResult]:
        for i in range(40):
            is_near = i < 14
            seen = Seen(
                distance_m=max(2.5, 9.0 - 0.5 * i),
                closing_mps=5.0 if is_near else 0.0,
                probability=0.999 if is_near else 0.0,
            )
            result = frame(i, seen)
            distance_m = result.ranges["fused_kf"].distance_m
            ranges = {"fused_kf": Ranges(result.tracks.track_id, distance_m, sigma * distance_m)}
            yield changed(result, ranges=ranges)

    reasons = [event.reason for event in events_of(results()) if event.kind == "near_miss"]
    assert len(reasons) == 1
    assert f"smallest gap to the front 1.0 ± {2.5 * sigma:.1f} m" in reasons[0]
    assert ("a contact is not excluded" in reasons[0]) is not is_excluded
    assert "(predicted probability over 99 %); by one camera." in reasons[0]


@pytest.mark.parametrize(("stereo_m", "cameras"), [(4.0, "two cameras"), (math.nan, "one camera")])
def test_a_near_miss_names_the_cameras_that_measured_it(stereo_m: float, cameras: str) -> None:
    """A run with two cameras, which may not have measured this track."""

    def results() -> Iterable[FrameResult]:
        for i in range(40):
            is_near = i < 14
            seen = Seen(
                distance_m=max(2.5, 9.0 - 0.5 * i),
                closing_mps=5.0 if is_near else 0.0,
                probability=0.999 if is_near else 0.0,
            )
            result = frame(i, seen)
            stereo = Ranges(result.tracks.track_id, np.array([stereo_m]), np.array([0.1]))
            yield changed(result, ranges={**result.ranges, "stereo": stereo})

    reasons = [event.reason for event in events_of(results()) if event.kind == "near_miss"]
    assert len(reasons) == 1
    assert f"; by {cameras}." in reasons[0]


def test_no_sentence_states_what_a_video_does_not_show() -> None:
    """Each reason has a distance with its sigma, and contacts only as predictions."""
    events = [
        *events_of(approach()),
        *events_of(approach(class_id=PERSON)),
        *events_of(cut_in(active=True)),
    ]
    assert {event.kind for event in events} >= {"forward_collision", "pedestrian_on_path", "cut_in"}
    for event in events:
        assert re.search(r"\d ± \d+(\.\d)? m\b", event.reason), event.reason
        assert not re.search("did not|avoided|without contact|no contact", event.reason)
        assert "contact in" not in event.reason or "predicted probability" in event.reason


@pytest.mark.parametrize(
    ("distance_m", "closing_mps", "n_frames", "ego_mps"),
    [
        (4.0, 20.0, 10, NAN),  # needs 80 m/s2
        (8.0, 9.0, 2, NAN),  # for 0.1 s
        (30.0, 20.0, 10, 10.0),  # oncoming, 7 m/s2
    ],
)
def test_no_hard_approach(
    distance_m: float, closing_mps: float, n_frames: int, ego_mps: float
) -> None:
    def results() -> Iterable[FrameResult]:
        for i in range(30):
            car = Seen(
                distance_m=distance_m,
                closing_mps=closing_mps,
                probability=0.9 if i < n_frames else 0.0,
            )
            yield frame(i, car, ego_mps=ego_mps)

    assert "hard_approach" not in kinds(events_of(results()))


@pytest.mark.parametrize(("closing_mps", "n_frames"), [(12.0, 2), (95.0, 10)])
def test_no_near_miss_of_one_frame_or_at_a_wrong_speed(closing_mps: float, n_frames: int) -> None:
    seen = [
        Seen(distance_m=10.0, closing_mps=closing_mps, probability=0.9 * (i < n_frames))
        for i in range(30)
    ]
    assert "near_miss" not in kinds(events_of(frame(i, car) for i, car in enumerate(seen)))


def test_contact_is_no_near_miss() -> None:
    crash = [
        frame(i, Seen(distance_m=11.5 - i, closing_mps=10.0, probability=0.9)) for i in range(11)
    ]
    assert "near_miss" not in kinds(events_of(crash))


@pytest.mark.parametrize(("n_known", "n_seen"), [(6, 11), (6, 9), (9, 9)])
def test_unproven_near_miss(n_known: int, n_seen: int) -> None:
    """The closing speed is unknown in the last frames, or the object is lost before the contact."""

    def results() -> Iterable[FrameResult]:
        for i in range(40):
            car = Seen(
                distance_m=11.5 - i, closing_mps=10.0 if i < n_known else NAN, probability=0.9
            )
            yield frame(i, *([car] if i < n_seen else []))

    assert "near_miss" not in kinds(events_of(results()))


def test_near_miss_of_a_person_who_leaves_the_path() -> None:
    def results() -> Iterable[FrameResult]:
        for i in range(40):
            person = Seen(
                distance_m=11.5 - i,
                class_id=PERSON,
                closing_mps=10.0,
                offset_m=0.4 * i,
                probability=0.9 if i < 4 else 0.0,
            )
            yield frame(i, *([person] if i < 10 else []))

    assert kinds(events_of(results())) == ["near_miss"]


def test_nothing_happens() -> None:
    assert events_of([]) == ()
    assert events_of(frame(i) for i in range(5)) == ()
    assert (
        events_of(frame(i, Seen(distance_m=NAN, offset_m=NAN, probability=NAN)) for i in range(5))
        == ()
    )


def test_settings() -> None:
    fast = EventSettings(close_headway_s=0.5)
    behind = [frame(i, Seen(distance_m=16.5, closing_mps=0.2), ego_mps=25.0) for i in range(40)]
    assert events_of(behind, fast) == ()
    assert set(kinds(events_of(behind))) <= set(EVENT_KINDS)

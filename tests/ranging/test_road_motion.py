"""Speeds on the plane of the road, from exact outlines of cuboids."""

import numpy as np
import pytest

from track_range.detection.classes import road_class_id
from track_range.ranging.world.object_motion import MOTION_STATES
from track_range.ranging.world.road_motion import RoadMotions
from track_range.ranging.world.road_plane import RoadPlane
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera.of_focal_length(900.0, (1280, 720))
PLANE = RoadPlane.of_mounting(CAMERA, Mounting(pitch_deg=16.0, z_m=6.0, sigma_deg=0.2), 0.005)
STEP_S = 0.05
CORNERS = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])


def tracks_of(track_id, class_id, box, is_seen):
    return Tracks(
        track_id=np.array([track_id]),
        class_id=class_id,
        score=np.ones(1),
        xyxy_px=box[None],
        observed=np.array([is_seen]),
    )


def outline(place, heading, size):
    """Box of a cuboid (length, width, height) on the road."""
    c, s = np.cos(heading), np.sin(heading)
    corners = CORNERS * size @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])
    pixels = PLANE.pixels(corners + np.array([*place, 0.0]))
    return np.concatenate([pixels.min(axis=0), pixels.max(axis=0)])


def motions(places, heading, size, name="car", rng=None, observed=None):
    """Motion after each frame of one object."""
    road, found = RoadMotions(PLANE), []
    for number, place in enumerate(places):
        box = outline(place, heading, np.array(size))
        if rng is not None:
            box = box + rng.normal(0.0, 1.0, 4)
        is_seen = observed is None or observed[number]
        class_id = np.array([road_class_id(name)])
        tracks = tracks_of(7, class_id, box, is_seen)
        found.append(road.update(tracks, STEP_S * number))
    return found


def straight(start, velocity_mps, n):
    return [np.array(start) + STEP_S * i * np.array(velocity_mps) for i in range(n)]


@pytest.mark.parametrize(
    ("start", "velocity_mps", "state"),
    [
        ((14.0, 1.0), (15.0, 0.0), "moving"),
        ((60.0, 3.0), (-15.0, 0.0), "oncoming"),
        ((25.0, 10.0), (0.0, -8.0), "crossing"),
        ((16.0, 6.0), (9.0, -6.0), "moving"),
    ],
)
def test_speed_heading_and_place_of_the_middle_of_the_footprint(start, velocity_mps, state):
    """The size differs from that of the class, and the aspect changes on the way."""
    places = straight(start, velocity_mps, 45)
    heading = float(np.arctan2(velocity_mps[1], velocity_mps[0]))
    last = motions(places, heading, (4.7, 1.85, 1.5))[-1]
    speed_mps = float(np.hypot(*velocity_mps))
    assert last.speed_mps[0] == pytest.approx(speed_mps, abs=0.35)
    assert last.speed_sigma_mps[0] < 1.5
    turn_deg = (last.heading_deg[0] - np.degrees(heading) + 180.0) % 360.0 - 180.0
    assert abs(turn_deg) < 3.0
    assert (last.world_x_m[0], last.world_y_m[0]) == pytest.approx(tuple(places[-1]), abs=0.5)
    assert MOTION_STATES[int(last.state[0])] == state


def test_a_standing_car_has_speed_zero_with_a_sigma():
    last = motions([(22.0, 2.0)] * 60, 0.0, (4.3, 1.8, 1.5), rng=np.random.default_rng(1))[-1]
    assert last.speed_mps[0] < 0.4
    assert 0.02 < last.speed_sigma_mps[0] < 1.5
    assert np.isnan(last.heading_deg[0])
    assert MOTION_STATES[int(last.state[0])] == "parked"


def test_errors_are_within_their_sigmas_and_predictions_widen_them():
    rng, z = np.random.default_rng(0), []
    for _ in range(30):
        places = straight((15.0, 1.5), (12.0, 0.0), 40)
        last = motions(places, 0.0, (4.4, 1.8, 1.5), rng=rng)[-1]
        z.append((last.speed_mps[0] - 12.0) / last.speed_sigma_mps[0])
    assert np.mean(np.abs(z) < 2) >= 0.92
    seen = [i < 30 for i in range(40)]
    known = motions(straight((15.0, 1.5), (12.0, 0.0), 40), 0.0, (4.4, 1.8, 1.5), observed=seen)
    assert known[-1].speed_sigma_mps[0] > known[29].speed_sigma_mps[0]


def test_boxes_that_the_image_cuts_are_not_used():
    """A truck enters at the lower border: its box grows in the image without a place on the road."""
    road = RoadMotions(PLANE)
    for number in range(12):
        box = np.array([[400.0, 500.0 - 30 * number, 800.0, 719.0]])
        tracks = tracks_of(1, np.array([road_class_id("truck")]), box[0], True)
        motion = road.update(tracks, STEP_S * number)
    assert np.isnan(motion.speed_mps).all()
    assert np.isnan(motion.world_x_m).all()

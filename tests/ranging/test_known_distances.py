"""Known distances as evidence of the scale of a pair."""

import math

import numpy as np
import pytest

from track_range.detection.boxes import iou
from track_range.ranging.cameras.evidence import SeenFrame
from track_range.ranging.cameras.known_distances import KnownDistance, KnownDistances
from track_range.ranging.cameras.posterior import posterior
from track_range.ranging.cameras.unknowns import OF_PAIR, camera_priors
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion
from track_range.tracking.tracks import Tracks

BOX_PX = (100.0, 100.0, 200.0, 180.0)


def seen(time_s, *, distance_m=12.0, box_px=BOX_PX):
    """A frame with another car, and with the measured one at a distance by the rig."""
    ids = np.array([3, 4])
    boxes_px = np.array([(400.0, 100.0, 460.0, 150.0), box_px])
    tracks = Tracks(ids, boxes_px, np.full(2, 2), np.ones(2), np.ones(2, np.bool_))
    by_rig = Ranges(ids, np.array([30.0, distance_m]), np.array([1.0, 0.24]))
    return SeenFrame(tracks, by_rig, by_rig, Ego(motion=EgoMotion()), time_s)


def test_distance_by_the_rig_in_the_frame_of_the_time_is_compared():
    known = KnownDistances([KnownDistance(2.0, BOX_PX, 10.0)])
    for time_s, distance_m in ((1.9, 12.5), (2.0, 12.0), (2.1, 11.5)):
        known.add(seen(time_s, distance_m=distance_m))
    (evidence,) = known.evidence
    assert not known.notes
    assert evidence.of == OF_PAIR
    assert evidence.value == pytest.approx(math.log(1.2))
    assert evidence.sigma == pytest.approx(math.hypot(0.02, 0.03))
    priors = camera_priors(700.0, focal_sigma=0.2, baseline_m=0.5, baseline_sigma=1.0)
    shown = posterior(priors, known.evidence).estimate(OF_PAIR)
    assert shown.mean == pytest.approx(math.log(1.2), abs=0.002)
    assert shown.sigma == pytest.approx(evidence.sigma, rel=0.01)


@pytest.mark.parametrize(
    "frame", [seen(2.0, distance_m=math.nan), seen(2.0, box_px=(0.0, 0.0, 9.0, 9.0))]
)
def test_objects_without_a_distance_or_a_track_are_no_evidence(frame):
    assert iou(np.array([BOX_PX]), frame.tracks.xyxy_px).max() in (0.0, 1.0)
    known = KnownDistances([KnownDistance(2.0, BOX_PX, 10.0)])
    known.add(frame)
    known.add(seen(2.1))
    assert not known.evidence
    assert "--known-distance at 2 s" in known.notes[0]


def test_a_time_without_a_frame_is_no_evidence():
    """A run that starts later: another object may be in the box."""
    known = KnownDistances([KnownDistance(2.0, BOX_PX, 10.0)])
    known.add(seen(2.3))
    assert not known.evidence
    assert len(known.notes) == 1

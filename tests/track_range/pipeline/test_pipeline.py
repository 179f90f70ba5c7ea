"""The pipeline on synthetic frames: order, errors in threads, and content of results."""

import itertools
import time
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from tests.support.results.frame_results import frame_pipeline
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.detector import DetectorError
from track_range.detection.lanes.lines import LaneLine, LaneLines
from track_range.pipeline.alarming import AlarmStage
from track_range.pipeline.detecting import DetectionStage
from track_range.pipeline.ego import EgoStage
from track_range.pipeline.ranging import RangingStage
from track_range.pipeline.threads import LIVE_DEPTHS, run_in_threads
from track_range.ranging.cameras.unknowns import Prior, Unknown
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.ground_plane import GroundRanger
from track_range.ranging.methods.method import MethodError, Ranger
from track_range.ranging.methods.patch_stereo import StereoRanger
from track_range.ranging.methods.size_regression import SizeRanger
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.run.box_source import boxes_of
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patch_matches import PatchMatches
from track_range.tracking.registry import TrackerError
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(100.0, 100.0, 49.5, 39.5, 100, 80)
IMAGE = np.zeros((80, 100, 3), np.uint8)


class OneTrack:
    """A tracker that makes every detection a track, with numbers from 1 or another one on."""

    def __init__(self, first=1):
        self.first = first

    def update(self, detections, time_s, image):
        n = len(detections)
        return Tracks(
            np.arange(self.first, self.first + n),
            detections.xyxy_px,
            detections.class_id,
            detections.score,
            np.ones(n, bool),
        )


class Falling(Ranger):
    """A ranger whose distance shrinks by 10 m/s from 50 m."""

    def measure(self, tracks, frame):
        n = len(tracks)
        return Ranges(tracks.track_id, np.full(n, 50 - 10 * frame.time_s), np.full(n, 0.5))


def frames(n, dt_s=0.1):
    return (Frame(i, i * dt_s, IMAGE, None) for i in range(n))


# a box that does not grow, of a sign: distances of vehicles are compared with the heights of their
# boxes
SIGN = Detections.of([[49.5, 59.5, 69.5, 79.5]], [0.9], [ROAD_CLASSES.index("traffic sign")])


def pipeline(detect=lambda frame: SIGN, **options):
    return frame_pipeline(
        CAMERA,
        detection=DetectionStage(detect=detect),
        tracker=OneTrack(),
        ranging=RangingStage({"mono": Falling()}),
        **options,
    )


def test_frames_in_order_with_all_methods():
    loop = pipeline()
    results = list(run_in_threads(loop, frames(30)))
    assert [r.frame.index for r in results] == list(range(30))
    assert set(results[0].ranges) == {"mono", "fused", "mono_kf", "fused_kf"}
    last = results[-1]
    assert last.ranges["fused"].distance_m == pytest.approx([21.0])
    assert last.closing_mps == pytest.approx([10.0], abs=0.3)
    assert last.ttc_s == pytest.approx([2.1], abs=0.1)
    # box centre 10 px right, 30 px below
    np.testing.assert_allclose(last.xyz_m, [[0.1 * 21, 0.3 * 21, 21.0]])


def scenes(n, cut):
    """Frames of one texture, and of another one from a frame on."""
    rng = np.random.default_rng(0)
    blocks = rng.integers(0, 255, (2, 12, 16)).astype(np.uint8)
    large = [cv2.resize(one, (640, 480), interpolation=cv2.INTER_CUBIC) for one in blocks]
    noise = rng.integers(0, 12, (n, 480, 640)).astype(np.uint8)
    return [
        Frame(
            k, 0.1 * k, np.repeat(cv2.add(large[int(k >= cut)], noise[k])[:, :, None], 3, 2), None
        )
        for k in range(n)
    ]


def test_another_scene_has_another_tracker_and_other_numbers():
    loop = pipeline(restarted=lambda: (OneTrack(), EgoStage(), AlarmStage(CAMERA, None)))
    before = loop.ego
    results = list(run_in_threads(loop, scenes(10, cut=5)))
    # a cut is known with the second image of the other scene
    assert [r.tracks.track_id.tolist() for r in results] == [[1]] * 6 + [[3]] * 4
    assert loop.ego is not before
    # the alarms, too: the change of the ego speed from scene to scene is no acceleration
    assert [r.alarms.has_warnings for r in results] == [True] * 6 + [False] * 4
    assert np.isnan(results[6].closing_mps).all()
    (note,) = loop.notes()
    assert "another scene from 0.5 s on" in note
    kept = pipeline()
    assert [r.tracks.track_id.tolist() for r in run_in_threads(kept, scenes(10, cut=5))] == [
        [1]
    ] * 10


def test_numbers_of_a_tracker_from_0_on_are_other_ones_in_another_scene():
    loop = pipeline(restarted=lambda: (OneTrack(0), EgoStage(), AlarmStage(CAMERA, None)))
    loop.tracker = OneTrack(0)
    results = list(run_in_threads(loop, scenes(10, cut=5)))
    assert [r.tracks.track_id.tolist() for r in results] == [[0]] * 6 + [[1]] * 4


def test_a_tracker_that_goes_on_keeps_its_numbers_in_another_scene():
    tracker = OneTrack()
    loop = pipeline(restarted=lambda: (tracker, EgoStage(), AlarmStage(CAMERA, None)))
    loop.tracker, before = tracker, loop.ego
    results = list(run_in_threads(loop, scenes(10, cut=5)))
    assert [r.tracks.track_id.tolist() for r in results] == [[1]] * 10
    assert loop.ego is not before


def test_clock_counts_the_stages_that_ran():
    loop = pipeline()
    list(run_in_threads(loop, frames(30)))
    assert {name for name, seconds in loop.clock.busy_s.items() if seconds > 0} == {
        "detect",
        "track",
        "ego",
        "mono",
        "doubt",
        "fuse",
        "filter",
        "world",
        "alarm",
    }


def test_shared_error_increases_every_sigma():
    plain, doubtful = pipeline(), pipeline(priors={Unknown.FOCAL: Prior(0.25)})
    for one, other in zip(
        run_in_threads(plain, frames(3)), run_in_threads(doubtful, frames(3)), strict=True
    ):
        assert set(one.ranges) == set(other.ranges)
        for name, ranges in one.ranges.items():
            assert other.ranges[name].distance_m == pytest.approx(ranges.distance_m)
            assert other.ranges[name].sigma_m == pytest.approx(
                np.hypot(ranges.sigma_m, 0.25 * ranges.distance_m)
            )


class LinesTo:
    """A lane finder whose lines meet in a row."""

    notes = ()

    def __init__(self, y_px):
        self.y_px = y_px
        self.looked_s, self.boxes_px = [], []

    def find(self, image, time_s, boxes_px):
        self.looked_s.append(time_s)
        self.boxes_px.append(boxes_px.tolist())
        left, right = (
            LaneLine(
                np.array([49.5 - slope * self.y_px, slope, 0.0]),
                np.diag([0.01, 0.0, 0.0]),
                50.0,
                79.0,
            )
            for slope in (-1.0, 1.0)
        )
        return LaneLines(left, right)


class Listening(Falling):
    """A ranger that records the arguments of its hooks."""

    background_s = 7.0

    def __init__(self):
        self.started, self.lanes, self.others, self.is_closed = [], [], [], False

    def start(self, frame):
        self.started.append(frame.index)

    def update_lanes(self, lines):
        self.lanes.append(lines)

    def measure_with(self, tracks, frame, others):
        self.others.append(set(others))
        return self.measure(tracks, frame)

    def close(self):
        self.is_closed = True


def test_every_hook_of_a_ranger_is_called():
    loop, ranger = pipeline(), Listening()
    loop.ranging.rangers = {
        "mono": Falling(),
        "sgbm": Falling(),
        "stereo": Falling(),
        "lane": ranger,
    }
    loop.detection.lane_finder = LinesTo(40.0)
    list(run_in_threads(loop, frames(3)))
    assert ranger.started == [0, 1, 2]
    assert ranger.others == [{"mono", "stereo"}] * 3  # only the methods that lane reads
    assert ranger.is_closed
    assert 7.0 <= loop.clock.busy_s["lane"] < 8.0


def test_lanes_are_detected_ten_times_per_second():
    loop, ranger = pipeline(), Listening()
    loop.detection.lane_finder, loop.ranging.rangers = LinesTo(40.0), {"ground": ranger}
    results = list(run_in_threads(loop, frames(7, dt_s=1 / 30)))
    assert loop.detection.lane_finder.looked_s == pytest.approx([0.0, 0.1, 0.2])
    assert [r.lanes is results[0].lanes for r in results] == [True] * 3 + [False] * 4
    assert [id(lines) for lines in ranger.lanes] == [id(results[i].lanes) for i in (0, 3, 6)]
    assert loop.detection.lane_finder.boxes_px == [[[49.5, 59.5, 69.5, 79.5]]] * 3


@pytest.mark.parametrize("y_px", [35.0, 44.0])
def test_horizon_is_where_lane_lines_meet(y_px):
    loop, ranger = pipeline(), GroundRanger(CAMERA)
    loop.detection.lane_finder, loop.ranging.rangers = LinesTo(y_px), {"ground": ranger}
    assert len(list(run_in_threads(loop, frames(3)))) == 3
    assert ranger.plane.horizon.y_px == pytest.approx(y_px, abs=1.0)


def test_frame_without_boxes():
    empty = list(run_in_threads(pipeline(lambda frame: Detections.empty()), frames(3)))
    assert [len(r.tracks) for r in empty] == [0, 0, 0]
    assert empty[0].xyz_m.shape == (0, 3)


def test_error_in_a_stage_follows_earlier_frames():
    def detect(frame):
        if frame.index == 5:
            raise ValueError("broken")
        return Detections.empty()

    seen = []
    with pytest.raises(ValueError, match="broken"):
        seen.extend(r.frame.index for r in run_in_threads(pipeline(detect), frames(9)))
    assert seen == [0, 1, 2, 3, 4]


def test_closing_early_stops_reading():
    asked = []

    def endless():
        for frame in frames(10_000):
            asked.append(frame.index)
            yield frame

    run = run_in_threads(pipeline(), endless())
    next(run)
    run.close()
    assert len(asked) < 50


def test_receding_track_has_no_ttc():
    class Rising(Ranger):
        def measure(self, tracks, frame):
            return Ranges(
                tracks.track_id,
                np.full(len(tracks), 20 + 5 * frame.time_s),
                np.full(len(tracks), 0.2),
            )

    loop = pipeline()
    loop.ranging.rangers = {"mono": Rising()}
    last = list(run_in_threads(loop, frames(30)))[-1]
    assert last.closing_mps[0] < -3
    assert np.isnan(last.ttc_s[0])


def test_ranger_of_other_tracks():
    class Missing(Ranger):
        def measure(self, tracks, frame):
            return Ranges.unmeasured(tracks.track_id[1:])

    loop = pipeline()
    loop.ranging.rangers = {"mono": Falling(), "radar": Missing()}
    with pytest.raises(MethodError, match="radar"):
        list(run_in_threads(loop, frames(1)))


class Returning(Ranger):
    """A ranger that returns the result of a function of the tracks."""

    def __init__(self, made_of):
        self._made_of = made_of

    def measure(self, tracks, frame):
        return self._made_of(tracks)


@pytest.mark.parametrize(
    ("made_of", "word"),
    [
        (lambda tracks: None, "NoneType"),
        (lambda tracks: tracks, "Tracks"),
        (lambda tracks: Ranges.unmeasured(tracks.track_id + 1), "track_id"),
    ],
)
def test_ranger_without_ranges(made_of, word):
    loop = pipeline()
    loop.ranging.rangers = {"radar": Returning(made_of)}
    with pytest.raises(MethodError, match=f"radar.*{word}"):
        list(run_in_threads(loop, frames(1)))


@pytest.mark.parametrize(
    ("distance_m", "sigma_m", "systematic_m"),
    [
        (-20.0, 1.0, 0.5),
        (0.0, 1.0, 0.5),
        (np.inf, 1.0, 0.5),
        (np.nan, 1.0, 0.5),
        (20.0, 0.0, 0.0),
        (20.0, -1.0, 0.5),
        (20.0, np.inf, 0.5),
        (20.0, np.nan, 0.5),
        (20.0, 1.0, -0.5),
        (20.0, 1.0, np.inf),
    ],
)
def test_invalid_distances_become_nan(distance_m, sigma_m, systematic_m):
    values = np.array([[distance_m, 30.0], [sigma_m, 1.0], [systematic_m, 0.5]])
    loop = pipeline(
        lambda frame: Detections.of(
            [[49.5, 59.5, 69.5, 79.5], [9.5, 59.5, 29.5, 79.5]], [0.9, 0.9], [2, 2]
        )
    )
    loop.ranging.rangers = {
        "mono": Falling(),
        "ground": Returning(lambda tracks: Ranges(tracks.track_id, *values)),
    }
    (result,) = run_in_threads(loop, frames(1))
    ground = result.ranges["ground"]
    for column, value in zip(
        (ground.distance_m, ground.sigma_m, ground.sigma_systematic_m), values, strict=True
    ):
        np.testing.assert_array_equal(column, [np.nan, value[1]])
    assert result.ranges["fused"].distance_m[0] == pytest.approx(50.0)
    # the ranger's own arrays
    np.testing.assert_array_equal(values[:, 0], [distance_m, sigma_m, systematic_m])


def test_tracker_and_detector_without_results():
    class Silent:
        def update(self, detections, time_s, image):
            return None

        def detect(self, image):
            return None

    loop = pipeline()
    loop.tracker = Silent()
    with pytest.raises(TrackerError, match=r"Silent: .*Tracks.*NoneType"):
        list(run_in_threads(loop, frames(1)))
    with pytest.raises(DetectorError, match=r"Silent, frame 0: .*Detections.*NoneType"):
        list(run_in_threads(pipeline(boxes_of(Silent()).detect), frames(1)))


def test_detector_with_invalid_boxes():
    class Coco:
        def __init__(self):
            self.n_images = 0

        def detect(self, image):
            self.n_images += 1
            return Detections.of([[49.5, 59.5, 69.5, 79.5]], [0.9], [2 if self.n_images < 3 else 9])

    expected = r"Coco, frame 2: ValueError: class_id: .*5 truck.*got 9 in row 0 \(line \d+ of test_pipeline\.py\)\.$"
    with pytest.raises(DetectorError, match=expected) as raised:
        list(run_in_threads(pipeline(boxes_of(Coco()).detect), frames(5)))
    assert isinstance(raised.value.__cause__, ValueError)


@pytest.mark.parametrize(
    "errors", [3, {"car": (0.1,)}, {"plane": (0, 0.1, 0, 0.1)}, {"car": (10**400, 0.1, 0, 0.1)}]
)
def test_detector_with_invalid_box_errors(errors):
    with pytest.raises(DetectorError, match=r"SimpleNamespace, box_errors: .*log_height"):
        boxes_of(SimpleNamespace(detect=None, box_errors=errors))


class FixedDisparity:
    """A matcher that returns the same disparity for every box."""

    def __init__(self, disparity_px):
        self.disparity_px = disparity_px

    def match(self, left, right, xyxy_px, prior_px, by_size=None):
        n = len(xyxy_px)
        return PatchMatches.of(
            np.full(n, self.disparity_px), np.full(n, 0.05), np.zeros(n, np.int64)
        )


def test_a_ranger_alone_gives_what_it_gives_in_the_pipeline_at_the_same_scale():
    """Stereo measures the scale of the drive; mono gets it as a value, and nothing else."""
    boxes = [[20.0 + 9 * k, 30.0, 28.0 + 9 * k, 52.0] for k in range(6)]
    loop = pipeline(lambda frame: Detections.of(boxes, [0.9] * 6, [2] * 6))
    rig = StereoRig.rectified(CAMERA, 0.5)
    matcher = FixedDisparity(3.0)
    loop.ranging.rangers = {"mono": SizeRanger(CAMERA), "stereo": StereoRanger(rig, matcher)}
    alone = {"mono": SizeRanger(CAMERA), "stereo": StereoRanger(rig, matcher)}
    scale = DriveScale()
    for frame in (Frame(i, i * 0.1, IMAGE, IMAGE) for i in range(12)):
        result = loop.step(loop.detected(frame))
        evidence = []
        others = {}
        for name, ranger in alone.items():
            measured = ranger.measure_at_scale(result.tracks, frame, dict(others), scale)
            others[name] = measured.ranges
            evidence.append(measured.evidence)
            np.testing.assert_array_equal(others[name].distance_m, result.ranges[name].distance_m)
            np.testing.assert_array_equal(others[name].sigma_m, result.ranges[name].sigma_m)
        scale = scale.after(evidence, frame.time_s)
    assert loop.scale.n_tracks == 6
    assert abs(scale.bias_of("car").log_factor) > 0.01


def test_two_frames_of_a_camera_are_in_progress():
    """The newest image is read when there is a slot for it, and not to wait in a queue."""
    taken = []

    def images():
        for frame in frames(100):
            taken.append(frame.index)
            yield frame

    run = run_in_threads(pipeline(), images(), LIVE_DEPTHS)
    for number, _ in enumerate(itertools.islice(run, 10), 1):
        time.sleep(0.005)  # the threads run ahead as far as they may
        assert len(taken) <= number + LIVE_DEPTHS.in_progress
    run.close()  # does not wait for a slot
    assert len(taken) <= 20


class FallingByImage(Ranger):
    """A ranger whose distance shrinks by 1 m with each image that is measured."""

    def __init__(self):
        self.n_measured = self.n_skipped = 0

    def measure(self, tracks, frame):
        self.n_measured += 1
        n = len(tracks)
        return Ranges(tracks.track_id, np.full(n, 70.0 - self.n_measured), np.full(n, 0.5))

    def skip(self, frame):
        self.n_skipped += 1


def textured_frames(numbers, fps):
    """Frames that show numbered images of a moving camera."""
    texture = cv2.resize(np.random.default_rng(0).integers(0, 256, (20, 300), np.uint8), (1200, 80))
    for k, number in enumerate(numbers):
        grey = texture[:, 4 * number : 4 * number + 100]
        yield Frame(k, k / fps, np.repeat(grey[:, :, None], 3, axis=2), None)


def test_repeated_images_are_not_measured_and_speeds_are_those_between_new_ones():
    loop, ranger = pipeline(), FallingByImage()
    loop.ranging.rangers = {"mono": ranger}
    numbers = [(5 * k + 4) // 6 for k in range(48)]  # 10 images per second in 12 frames
    results = list(run_in_threads(loop, textured_frames(numbers, fps=12.0)))
    assert [bool(np.isnan(r.ranges["fused"].distance_m[0])) for r in results] == [
        k % 6 == 5 for k in range(48)
    ]
    assert (ranger.n_measured, ranger.n_skipped) == (40, 8)
    assert [r.time_s for r in results] == pytest.approx([k / 12 for k in range(48)])
    assert all(r.tracks.observed.all() for r in results)
    closing_mps = np.array([r.closing_mps[0] for r in results[36:]])
    assert closing_mps == pytest.approx(10.0, abs=0.1)
    filtered_m = np.array([r.ranges["fused_kf"].distance_m[0] for r in results[24:]])
    assert np.diff(filtered_m).mean() == pytest.approx(-10 / 12, abs=0.02)
    assert loop.notes()[-1].startswith("Every sixth frame repeats")


def test_distances_of_a_frozen_camera_are_predicted_and_soon_unknown():
    loop, ranger = pipeline(), FallingByImage()
    loop.ranging.rangers = {"mono": ranger}
    numbers = [*range(20), *[19] * 15, *range(35, 40)]
    results = list(run_in_threads(loop, textured_frames(numbers, fps=10.0)))
    frozen = [r.ranges["fused_kf"] for r in results[20:35]]
    sigma_m = np.array([ranges.sigma_m[0] for ranges in frozen])
    assert sigma_m[8] > 1.2 * sigma_m[0]
    assert np.isnan(sigma_m[11:]).all()
    assert frozen[8].distance_m[0] == pytest.approx(50.0 - 9.0, abs=3 * sigma_m[8])
    assert np.isnan([r.closing_mps[0] for r in results[31:35]]).all()

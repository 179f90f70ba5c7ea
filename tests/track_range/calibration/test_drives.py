"""The pre-pass of drives: parts that are read, motion as a source, boxes without distortion, and
`track-range calibrate drive`.
"""

import json
import math
import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest

from track_range.calibration.drive.drive_video import DriveVideo
from track_range.calibration.drive.pre_pass import (
    PrePass,
    _shown_names,
    drive_priors,
    source_of_evidence,
    thinned,
    undistorted,
    with_motion,
)
from track_range.calibration.drive.road_evidence import RoadEvidence
from track_range.detection.detections import Detections
from track_range.ranging.cameras.evidence import Evidence
from track_range.ranging.cameras.measurements import SceneBoxes
from track_range.ranging.cameras.scale_evidence import height_by_speed
from track_range.ranging.cameras.unknowns import USUAL_HEIGHT_M, Unknown
from track_range.ranging.size_models.curve import load_curves
from track_range.recording.cameras.camera_estimate import CameraEstimate, source_of_guess
from track_range.recording.sources.names import video_name
from track_range.recording.video.options import RecordingOptions
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_curve import FocalCurve
from track_range.stereo.geometry.focal_guess import FocalGuess, default_guess
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import RoadCalibration
from track_range.stereo.rig_formats.reading import load_camera, read_calibration
from track_range.stereo.rig_formats.rig_yaml import save_camera
from track_range.stereo.self_calibration.scene_motion import MotionEstimate

SIZE_PX = (1280, 720)


def motion(focal_px=1000.0, sigma=0.02, **changes):
    log_f = np.log(np.geomspace(400, 2500, 200))
    values = {
        "curve": FocalCurve.of_guess(FocalGuess(focal_px, sigma, "motion"), log_f),
        "focal_px": focal_px,
        "sigma": sigma,
        "coefficients": (-0.1, 0.0, 0.0, 0.0),
        "k1_sigma": 0.01,
        "readout_s": 0.0,
        "turn_deg": 30.0,
        "span_s": (42.3, 44.3),
        "n_points": 500,
    }
    return MotionEstimate(**{**values, **changes})


def usual():
    source = source_of_guess(default_guess(SIZE_PX), "usual", SIZE_PX)
    return CameraEstimate(size_px=SIZE_PX, sources=(source,))


def test_turn_gives_the_focal_length_and_the_distortion():
    estimate = with_motion(usual(), motion())
    assert estimate.focal_px == pytest.approx(1000, rel=0.01)
    assert 0.015 < estimate.sigma < 0.03
    assert estimate.sentence.startswith("Focal length 99")
    assert "from the turn at 0:42" in estimate.sentence
    assert "k1 = -0.100" in estimate.sentence
    assert estimate.distortion == (-0.1, 0.0, 0.0, 0.0)
    straight = with_motion(usual(), motion(turn_deg=1.0, k1_sigma=0.1, span_s=(62.0, 64.0)))
    assert "from the motion of the static scene at 1:02" in straight.sentence
    assert straight.distortion == ()


def test_turn_of_several_recordings_names_its_video():
    estimate = with_motion(usual(), motion(), "drive2.mp4")
    assert "from the turn at 0:42 of drive2.mp4" in estimate.sentence
    assert _shown_names(["a/drive1.mp4", "a/drive2.mp4"]) == ["drive1.mp4", "drive2.mp4"]
    assert _shown_names(["a/drive.mp4", "b/drive.mp4"]) == ["a/drive.mp4", "b/drive.mp4"]


def shifted_frames(start_s, shifts_px):
    """Frames of 5 Hz of a texture that moves by pixels per frame."""
    noise = np.random.default_rng(4).integers(0, 255, (240, 1200), np.uint8)
    texture = cv2.cvtColor(cv2.GaussianBlur(noise, (0, 0), 2.0), cv2.COLOR_GRAY2BGR)
    for number, left in enumerate(np.cumsum(shifts_px).tolist()):
        image = np.ascontiguousarray(texture[:, left : left + 400])
        yield Frame(number, start_s + 0.2 * number, image, None)


def test_time_and_video_of_the_motion():
    camera = PinholeCamera.of_focal_length(300.0, (400, 240))
    view = RoadEvidence(has_horizon=False)
    parts = {"straight.mp4": (5.0, [0] * 8), "turn.mp4": (61.0, [0] * 6 + [6] * 12)}
    for video, (start_s, shifts_px) in parts.items():
        frames = shifted_frames(start_s, shifts_px)
        view.add(video, camera, frames, lambda _frame: Detections.empty(), lambda *_: None)
    view.measure_lens()
    found, video = view.lens
    assert video == "turn.mp4"
    # the standing camera has one keyframe at 61 s; the camera moves from 62.0 to 64.4 s
    assert 61.0 <= found.span_s[0] <= 62.5
    assert found.span_s[1] == pytest.approx(64.4, abs=0.3)


def test_dark_images_show_no_lens():
    camera = PinholeCamera.of_focal_length(300.0, (400, 240))
    view = RoadEvidence(has_horizon=False)
    frames = (
        replace(frame, left=frame.left // 8) for frame in shifted_frames(0.0, [0] * 6 + [6] * 12)
    )
    view.add("night.mp4", camera, frames, lambda _frame: Detections.empty(), lambda *_: None)
    view.measure_lens()
    assert view.lens is None


def test_views_of_one_object_are_thinned():
    ids = np.repeat([3, 5], [100, 4])
    xyxy = np.arange(4.0) + np.arange(104)[:, None]
    few = thinned(SceneBoxes(xyxy, np.zeros(104, np.int64), ids))
    assert [(few.track_id == number).sum() for number in (3, 5)] == [8, 4]
    assert few.xyxy_px[few.track_id == 3][[0, -1], 0].tolist() == [0.0, 99.0]
    assert len(thinned(SceneBoxes())) == 0


def test_boxes_without_distortion_by_hand():
    camera = PinholeCamera(1000.0, 1000.0, 639.5, 359.5, *SIZE_PX, (-0.1, 0.0, 0.0, 0.0))
    # the ray (0.3, 0) is imaged at 0.3 (1 - 0.1 0.09) = 0.2973
    boxes = SceneBoxes(
        np.array([[639.5, 349.5, 639.5 + 297.3, 369.5]]), np.zeros(1, int), np.zeros(1, int)
    )
    (straight,) = undistorted(boxes, camera).xyxy_px
    assert straight[2] == pytest.approx(639.5 + 300.0, abs=0.05)
    assert straight[0] == pytest.approx(639.5, abs=0.05)
    assert undistorted(boxes, camera.without_distortion()) is boxes


def write_video(path, shifts_px):
    """A video of 10 Hz in which a texture moves by pixels per frame."""
    texture = np.random.default_rng(1).integers(0, 255, (60, 90), np.uint8)
    wide = cv2.resize(texture, (1800, 120), interpolation=cv2.INTER_CUBIC)
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"mp4v"), 10, (160, 120))
    place = 800.0
    for shift_px in shifts_px:
        place += shift_px
        left = int(place)
        writer.write(cv2.cvtColor(wide[:, left : left + 160], cv2.COLOR_GRAY2BGR))
    writer.release()
    return DriveVideo.of(video_name(str(path)))


def test_parts_that_are_read(tmp_path):
    straight = write_video(tmp_path / "straight.mp4", [0] * 200)
    assert straight.parts_s() == [(0.0, None)]
    long = write_video(tmp_path / "long.mp4", [0] * 400)
    assert [start for start, _ in long.parts_s()] == pytest.approx([0.0, 20.0, 34.0], abs=0.2)
    turning = write_video(tmp_path / "turn.mp4", [0] * 120 + [-4] * 60 + [0] * 120)
    ((start_s, length_s),) = turning.parts_s()
    assert start_s < 13
    assert start_s + length_s > 17
    assert length_s <= 10.5


def test_rest_of_a_drive(tmp_path):
    short = write_video(tmp_path / "short.mp4", [0] * 200)
    assert short.rest_s([(0.0, None)]) == []
    assert short.rest_s([(6.0, 8.0)]) == [(0.0, 6.0), (14.0, 6.0)]
    assert short.rest_s([(10.5, 9.0), (0.5, 9.5)]) == []  # half a second is not worth it
    long = write_video(tmp_path / "long.mp4", [0] * 400)
    assert long.rest_s(long.parts_s()) == []
    assert long.rest_s([(16.0, 8.0)]) == [(0.0, 10.0), (24.0, 6.0), (34.0, 10.0)]


def test_a_turn_that_the_motion_does_not_show_does_not_leave_out_the_rest(tmp_path):
    """The images look like a turn, but their texture has no depth and no rotation of a camera."""
    shaken = write_video(tmp_path / "shaken.mp4", [0] * 60 + [-4] * 60 + [0] * 60)
    ((_, length_s),) = shaken.parts_s()
    pre_pass = PrePass(detect=lambda _frame: Detections.empty(), sizes=load_curves(None, "europe"))
    found = pre_pass.camera_of([shaken])
    assert length_s <= 10.5
    assert found.n_frames == pytest.approx(180, abs=2)


def test_part_that_was_asked_for(tmp_path):
    whole = write_video(tmp_path / "a.mp4", [0] * 100)
    part = DriveVideo(
        whole.name,
        whole.size_px,
        whole.duration_s,
        whole.guesses,
        RecordingOptions(start_s=2.0, duration_s=3.0),
    )
    assert part.parts_s() == [(2.0, 3.0)]


def assumed_px_m(priors):
    return priors[Unknown.FOCAL].value * priors[Unknown.HEIGHT].value


def test_speed_gives_the_focal_length_by_hand():
    """The speed gives 1250 px m, and contact points 1.25 m: with errors of sizes of 5.5 and 6.5 %,
    of the contact points of 4 %, and of the speed of 1.5, 2 and 3 %, this is 1000 px +- 10 %. The
    usual height of cameras makes it 2 % less.
    """
    priors = drive_priors(usual(), None)
    height = Evidence(
        "", {Unknown.HEIGHT: 1.0, Unknown.SIZES: 1.0}, math.log(1.25 / USUAL_HEIGHT_M), 0.04
    )
    evidence = [height_by_speed(math.log(1250.0 / assumed_px_m(priors)), 0.03), height]
    by_speed = source_of_evidence("speed", "the speed of the camera", priors, evidence, SIZE_PX)
    focal_px, sigma = by_speed.curve.estimate
    assert focal_px == pytest.approx(980, rel=0.01)
    expected = math.sqrt(0.055**2 + 0.065**2 + 0.04**2 + 0.015**2 + 0.02**2 + 0.03**2)
    # wrong speeds widen it
    assert expected < sigma < 1.35 * expected
    estimate = usual().with_source(by_speed)
    assert estimate.focal_px == pytest.approx(980, rel=0.03)
    assert estimate.leading.kind == "speed"
    assert "from the speed of the camera" in estimate.sentence


def test_a_measured_height_and_a_speed_need_no_road_users():
    priors = drive_priors(usual(), 1.25)
    evidence = [height_by_speed(math.log(1250.0 / assumed_px_m(priors)), 0.01)]
    by_speed = source_of_evidence("speed", "the speed of the camera", priors, evidence, SIZE_PX)
    focal_px, sigma = by_speed.curve.estimate
    assert focal_px == pytest.approx(1000, rel=0.01)
    # 3 % of the height, 1.5, 2 and 1 % of the speed are 4.0 %; in 6 % of cases one is a mistake
    assert 0.06 < sigma < 0.12
    estimate = usual().with_source(by_speed)
    assert 0.041 < estimate.sigma < 0.06


def test_straight_parts_are_read_where_a_speed_is_given(tmp_path):
    turning = write_video(tmp_path / "turn.mp4", [0] * 120 + [-4] * 60 + [0] * 120)
    assert len(turning.parts_s()) == 1
    assert turning.parts_s()[0][1] is not None
    assert turning.with_speed("36").parts_s() == [(0.0, None)]
    assert turning.with_speed("36").speed.at(3.0) == pytest.approx(10.0)
    assert turning.with_speed("auto").speed is None


@pytest.mark.slow
def test_two_recordings_and_their_continuation(tmp_path, cli, small_drive):
    videos = [shutil.copy(small_drive.left, tmp_path / name) for name in ("a.mp4", "b.mp4")]
    out, figures = tmp_path / "rig.yaml", tmp_path / "f.json"
    measured = ("--camera-height-m", "1.6")
    outputs = ("--out", out, "--json", figures)
    status, printed, complaint = cli("calibrate", "drive", *videos, *measured, *outputs)
    assert status == 0, complaint
    assert "2 videos" in printed
    assert "all" in printed
    true_px = load_camera(small_drive.rig, size_px=None)[0].fx_px
    first = read_calibration(out, is_grey=False, is_pair=False).road
    camera, _ = load_camera(out, size_px=None)
    assert abs(math.log(camera.fx_px / true_px)) < 3 * first.focal_sigma
    estimate = json.loads(figures.read_text())["camera_estimate"]
    assert "usual" in [source["kind"] for source in estimate["sources"]]
    status, _, complaint = cli(
        "calibrate", "drive", videos[0], "--rig", out, "--out", out, "--json", figures
    )
    assert status == 0, complaint
    estimate = json.loads(figures.read_text())["camera_estimate"]
    kinds = [source["kind"] for source in estimate["sources"]]
    assert "given" in kinds
    assert "usual" not in kinds
    second = read_calibration(out, is_grey=False, is_pair=False).road
    assert second.focal_sigma < 1.1 * first.focal_sigma
    assert second.camera_height_m == pytest.approx(1.6, abs=0.06)
    assert second.camera_height_sigma_m <= 0.049


def test_a_recording_counts_once(tmp_path, cli):
    write_video(video := tmp_path / "a.mp4", [0] * 3)
    status, _, complaint = cli("calibrate", "drive", video, video)
    assert (status, "found it 2 times" in complaint) == (2, True)


def test_recordings_of_two_sizes(tmp_path, cli):
    write_video(tmp_path / "a.mp4", [0] * 3)
    writer = cv2.VideoWriter(str(tmp_path / "b.mp4"), cv2.VideoWriter_fourcc(*"mp4v"), 10, (80, 64))
    for _ in range(3):
        writer.write(np.zeros((64, 80, 3), np.uint8))
    writer.release()
    status, _, complaint = cli("calibrate", "drive", tmp_path / "a.mp4", tmp_path / "b.mp4")
    assert (status, "b.mp4" in complaint, "160x120" in complaint) == (2, True, True)


@pytest.mark.parametrize(
    ("k1_sigma", "expected"),
    [(0.002, (-0.2, 0.03, 0.0, 0.0)), (0.05, (-0.1, 0.0, 0.0, 0.0))],
)
def test_the_better_known_distortion_stays(k1_sigma, expected):
    """An earlier calibration against a turn, which shows -0.1 within 0.01."""
    given = source_of_guess(FocalGuess(1000.0, 0.02, "rig.yaml"), "given", SIZE_PX)
    earlier = {"coefficients": (-0.2, 0.03, 0.0, 0.0), "k1_sigma": k1_sigma}
    before = CameraEstimate(size_px=SIZE_PX, sources=(given,), **earlier)
    assert with_motion(before, motion()).distortion == expected


def test_a_drive_without_motion_keeps_an_earlier_calibration(tmp_path, cli):
    """A standing camera shows nothing; its earlier calibration is written again. Its axis meets the
    image 6 px below the middle, where a level camera has the horizon: 6 / 150 rad above the axis."""
    write_video(video := tmp_path / "still.mp4", [0] * 12)
    earlier = PinholeCamera(150.0, 150.0, 84.0, 65.5, 160, 120, (-0.3, 0.08, 0.0, 0.0))
    rig, out = tmp_path / "rig.yaml", tmp_path / "new.yaml"
    road = RoadCalibration(
        focal_sigma=0.01,
        camera_height_m=1.5,
        camera_height_sigma_m=0.02,
        pitch_deg=0.0,
        pitch_sigma_deg=0.1,
        k1_sigma=0.01,
    )
    save_camera(earlier, rig, road=road)
    status, _, complaint = cli("calibrate", "drive", video, "--rig", rig, "--out", out)
    assert status == 0, complaint
    camera, _ = load_camera(out, size_px=None)
    assert camera.distortion == earlier.distortion
    assert camera.fx_px == pytest.approx(150.0, rel=0.01)
    assert (camera.cx_px, camera.cy_px) == (84.0, 65.5)
    after = read_calibration(out, is_grey=False, is_pair=False).road
    assert after.k1_sigma == 0.01
    assert after.pitch_deg == pytest.approx(math.degrees(math.atan(6 / 150)), abs=0.1)


def test_prior_is_a_source():
    given = source_of_guess(FocalGuess(950.0, 0.02, "rig.yaml"), "given", SIZE_PX)
    estimate = with_motion(CameraEstimate(size_px=SIZE_PX, sources=(given,)), motion(1000.0, 0.02))
    assert estimate.focal_px == pytest.approx(math.sqrt(950 * 1000), rel=0.005)

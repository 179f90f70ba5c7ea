"""`track-range calibrate` without a board: texts of measurements, sources of focal lengths, whole
commands."""

from __future__ import annotations

import json
import math
import shutil
from types import SimpleNamespace

import numpy as np
import pytest

from track_range.calibration.drive.known_metres import known_lanes, known_metres
from track_range.calibration.drive.pre_pass import MountedCamera
from track_range.calibration.drive.separability import separability
from track_range.foundation.errors import UsageError
from track_range.ranging.cameras.measurements import SceneBoxes
from track_range.recording.cameras.camera_estimate import CameraEstimate, source_of_guess
from track_range.recording.cameras.focal_sources import focal_guesses
from track_range.recording.cameras.known_lenses import KNOWN_CAMERAS, GivenLens
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_guess import FocalGuess
from track_range.stereo.geometry.rig import RoadCalibration
from track_range.stereo.rig_formats.reading import load_camera, read_calibration
from track_range.stereo.rig_formats.rig_yaml import save_camera

ROAD = RoadCalibration(
    focal_sigma=0.04,
    camera_height_m=1.4,
    camera_height_sigma_m=0.05,
    pitch_deg=1.5,
    pitch_sigma_deg=0.2,
)


def test_measurements_of_one_box_are_joined():
    (known,) = known_metres(["3.2,610,340,702,415=12.4"], ["3.2, 610,340,702,415 = 1.48"], [])
    assert (known.time_s, known.xyxy_px) == (3.2, (610.0, 340.0, 702.0, 415.0))
    assert (known.distance_m, known.height_m) == (12.4, 1.48)
    assert math.isnan(known.width_m)
    (van,) = known_metres(["0,610,340,702,415,van=9"], [], [])
    assert van.class_name == "van"
    (lane,) = known_lanes(["1.5,400,900,600=3.6"])
    assert (lane.x1_px, lane.x2_px, lane.y_px, lane.width_m) == (400, 900, 600, 3.6)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "12.4",
        "1,2,3,4,5",
        "1,2,3,4=5",
        "1,9,3,4,8=5",
        "1,2,3,4,8=0.2",
        "1,2,3,4,8=nan",
        "a,2,3,4,8=5",
        "-1,2,3,4,8=5",
    ],
)
def test_wrong_measurements(text):
    with pytest.raises(UsageError, match=r"--known-distance|expected a time and a box"):
        known_metres([text], [], [])


def test_two_values_of_one_box():
    with pytest.raises(UsageError, match="found two"):
        known_metres(["1,2,3,4,8=5", "1,2,3,4,8=9"], [], [])


@pytest.mark.parametrize("text", ["1,2,3=3", "1,5,5,9=3", "1,2,3,4=100"])
def test_wrong_lanes(text):
    with pytest.raises(UsageError, match="--known-lane-width"):
        known_lanes([text])


def reader(metadata, path="drive.mp4", size=(1920, 1080)):
    """Properties of an opened video."""
    return SimpleNamespace(shown_size_px=size, metadata=metadata, path=path)


def test_focal_length_of_apples_header():
    key = "com.apple.quicktime.camera.focal_length.35mm_equivalent"
    (guess,) = focal_guesses(reader({key: "26"}))
    assert guess.focal_px == pytest.approx(26 * math.hypot(1920, 1080) / 43.27, rel=1e-3)
    assert "26 mm" in guess.source
    # not plausible: the usual field of view
    assert focal_guesses(reader({key: "0"}))[0].sigma >= 0.25


def test_focal_length_of_exif(tmp_path):
    image = pytest.importorskip("PIL.Image").new("RGB", (64, 48))
    exif = image.getexif()
    exif.get_ifd(0x8769)[0xA405] = 28
    image.save(tmp_path / "000000.jpg", exif=exif)
    (guess,) = focal_guesses(reader({}, tmp_path, (64, 48)))
    assert guess.focal_px == pytest.approx(28 * 80 / 43.27, rel=1e-3)


def test_known_cameras():
    (guess,) = focal_guesses(reader({}), GivenLens("comma eon"))
    assert guess.focal_px == pytest.approx(910 * 1920 / 1164)
    (guess,) = focal_guesses(reader({}), GivenLens("Comma Three"))
    assert guess.focal_px == pytest.approx(2648 * 1920 / 1928)
    with pytest.raises(UsageError, match="comma EON"):
        GivenLens("unknown")
    (guess,) = focal_guesses(reader({"firmware": "HD9.01.01.60.00"}))
    assert "HERO9" in guess.source
    for camera in KNOWN_CAMERAS:
        assert 20 < math.degrees(2 * math.atan(0.5 / camera.focal_per_width)) < 130, camera
        assert camera.source


def test_road_calibration_in_rig_yaml(tmp_path, cli):
    camera = PinholeCamera.of_focal_length(900.0, (1280, 720))
    path = tmp_path / "rig.yaml"
    save_camera(camera, path, road=ROAD)
    assert load_camera(path, size_px=(1280, 720))[0] == camera
    assert road_of(path) == ROAD
    status, printed, _ = cli("rig", "show", path)
    assert (status, "4.0 %" in printed, "1.40" in printed) == (0, True, True)
    assert (
        "OUT does not store"
        in cli("rig", "convert", path, tmp_path / "cv.yml", "--to", "opencv")[1]
    )
    assert "OUT does not store" not in cli("rig", "convert", path, tmp_path / "copy.yaml")[1]
    assert road_of(tmp_path / "copy.yaml") == ROAD
    save_camera(camera, path)
    assert road_of(path) is None


def test_wrong_commands(tmp_path, cli, film):
    out = tmp_path / "rig.yaml"
    status, _, complaint = cli("calibrate", "--out", out)
    assert (status, "--mono" in complaint) == (2, True)
    video = film(tmp_path / "a.mp4", range(4))
    status, _, complaint = cli(
        "calibrate", "--mono", video, "--known-distance", "0,1,1,900,40=5", "--out", out
    )
    assert (status, "64x48" in complaint) == (2, True)
    status, _, complaint = cli(
        "calibrate", "--mono", video, "--known-distance", "99,1,1,20,40=5", "--out", out
    )
    assert (status, "end of the video" in complaint) == (2, True)
    for option, words in (
        (("--known-lane-width", "0,1,40,90=3.5"), "64x48"),
        (("--known-lane-width", "99,1,40,30=3.5"), "end of the video"),
        (("--square-mm", 24), "--board"),
        (("--board", "9x6", "--known-distance", "0,1,1,20,40=5"), "--known-distance"),
    ):
        status, _, complaint = cli("calibrate", "--mono", video, *option, "--out", out)
        assert (status, words in complaint) == (2, True), complaint
    assert not out.exists()


@pytest.mark.slow
def test_simulated_video(tmp_path, cli, small_drive):
    rows = np.genfromtxt(small_drive.table, delimiter=",", names=True, dtype=None, encoding="utf-8")
    usable = (rows["frame"] == 0) & (rows["class"] == "car")
    camera, _ = load_camera(small_drive.rig, size_px=None)
    inside = (
        usable
        & (rows["x1"] > 2)
        & (rows["x2"] < camera.width_px - 3)
        & (rows["y2"] < camera.height_px - 3)
    )
    row = rows[np.flatnonzero(inside)[np.argmin(rows["distance_m"][inside])]]
    box = ",".join(str(row[name]) for name in ("x1", "y1", "x2", "y2"))
    out, figures = tmp_path / "rig.yaml", tmp_path / "f.json"
    status, printed, complaint = cli(
        "calibrate",
        "--mono",
        small_drive.left,
        "--known-distance",
        f"0,{box},car={row['distance_m']}",
        "--known-height",
        f"0,{box},car=1.5",
        "--camera-height-m",
        1.65,
        "--out",
        out,
        "--json",
        figures,
    )
    assert status == 0, complaint
    assert "known height" in printed
    assert "as measured" in printed
    fitted, road = load_camera(out, size_px=None)[0], road_of(out)
    assert fitted.fx_px == pytest.approx(camera.fx_px, rel=4 * road.focal_sigma)
    assert road.camera_height_m == pytest.approx(1.65, abs=0.1)
    assert json.loads(figures.read_text())["focal_px"] == pytest.approx(fitted.fx_px)
    status, printed, complaint = cli(
        "run",
        "--mono",
        small_drive.left,
        "--rig",
        out,
        "--detections",
        small_drive.detections,
        "--out",
        tmp_path / "run",
    )
    assert status == 0, complaint
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["calibration"] == "rig"


@pytest.mark.slow
def test_run_without_a_calibration(tmp_path, cli, small_drive):
    video = shutil.copy(small_drive.left, tmp_path / "drive.mp4")  # without the rig.yaml beside it
    out = tmp_path / "run"
    status, printed, complaint = cli(
        "run", "--mono", video, "--detections", small_drive.detections, "--out", out, "--no-overlay"
    )
    assert status == 0, complaint
    assert "Give --focal-px" in printed
    summary = json.loads((out / "summary.json").read_text())
    assert summary["calibration"] == "estimated"
    assert summary["camera_estimate"]["focal_px"] == pytest.approx(summary["focal_px"], abs=0.01)
    assert 0.08 < summary["focal_sigma"] < 0.31
    true_px = load_camera(small_drive.rig, size_px=None)[0].fx_px
    assert abs(math.log(summary["focal_px"] / true_px)) < 3 * summary["focal_sigma"]
    rows = np.genfromtxt(
        out / "tracks.csv", delimiter=",", names=True, dtype=None, encoding="utf-8"
    )
    fraction = rows["fused_sigma_m"] / rows["fused_m"]
    assert np.nanmin(fraction) >= summary["focal_sigma"] - 1e-3


@pytest.mark.slow
def test_known_distance_in_a_run(tmp_path, cli, small_drive):
    rows = np.genfromtxt(small_drive.table, delimiter=",", names=True, dtype=None, encoding="utf-8")
    camera, _ = load_camera(small_drive.rig, size_px=None)
    is_usable = (rows["frame"] == 0) & (rows["class"] == "car") & (rows["x1"] > 2)
    is_usable &= (rows["x2"] < camera.width_px - 3) & (rows["y2"] < camera.height_px - 3)
    row = rows[np.flatnonzero(is_usable)[np.argmin(rows["distance_m"][is_usable])]]
    box = ",".join(str(row[name]) for name in ("x1", "y1", "x2", "y2"))
    video = shutil.copy(small_drive.left, tmp_path / "drive.mp4")
    out = tmp_path / "run"
    arguments = ("run", "--mono", video, "--detections", small_drive.detections, "--out", out)
    known = ("--known-distance", f"0,{box},car={row['distance_m']}")
    status, printed, complaint = cli(*arguments, *known, "--no-overlay")
    assert status == 0, complaint
    assert printed.strip().splitlines()[-1].startswith("- ")  # the estimate comes last
    summary = json.loads((out / "summary.json").read_text())
    kinds = [source["kind"] for source in summary["camera_estimate"]["sources"]]
    assert "known metres" in kinds
    assert summary["focal_sigma"] < 0.12
    assert abs(math.log(summary["focal_px"] / camera.fx_px)) < 3 * summary["focal_sigma"]
    status, _, complaint = cli(*arguments, *known, "--focal-px", 700)
    assert (status, "omit it" in complaint) == (2, True)


@pytest.mark.real
def test_real_drive(shared_data, tmp_path, cli):
    """KITTI 0005: the car ahead is 1.62 m high, and its rear 33.39 - 4.5 / 2 m away in frame 8; f =
    721.5 px."""
    video, out = shared_data / "kitti_stereo" / "0005" / "left.mp4", tmp_path / "rig.yaml"
    box = "0.8,573.9,173.4,612.0,211.3"
    status, printed, complaint = cli(
        "calibrate", "--mono", video, "--known-distance", f"{box}=31.1", "--out", out
    )
    assert status == 0, complaint
    assert "from the measurements" in printed
    focal_px, road = load_camera(out, size_px=None)[0].fx_px, road_of(out)
    assert 0.05 < road.focal_sigma < 0.12
    assert abs(math.log(focal_px / 721.5)) < 2.5 * road.focal_sigma
    known = (
        "--known-distance",
        f"{box}=31.1",
        "--known-height",
        f"{box}=1.622",
        "--camera-height-m",
        1.65,
    )
    status, printed, complaint = cli("calibrate", "--mono", video, *known, "--out", out)
    assert status == 0, complaint
    assert load_camera(out, size_px=None)[0].fx_px == pytest.approx(721.5, rel=0.06)
    assert -1.0 < road_of(out).pitch_deg < 3.0
    one_sigma = road.focal_sigma
    wrong = ("--known-distance", f"{box}=31.1", "--known-distance", "0,257,176,301,200=10")
    written = out.read_bytes()
    status, printed, complaint = cli("calibrate", "--mono", video, *wrong, "--out", out)
    assert (status, "--force" in complaint, "contradict each other" in printed) == (1, True, True)
    assert out.read_bytes() == written
    status, printed, complaint = cli("calibrate", "--mono", video, *wrong, "--out", out, "--force")
    assert status == 0, complaint
    assert road_of(out).focal_sigma > 3 * one_sigma
    status, _, complaint = cli(
        "calibrate", "--mono", video, "--known-distance", "0,900,20,980,60=12", "--out", out
    )
    assert (status, "the detector finds none there" in complaint) == (2, True)


def road_of(path):
    return read_calibration(path, is_grey=False, is_pair=False).road


def test_focal_length_before_the_measurements_is_named_once():
    source = source_of_guess(FocalGuess(833.0, 0.1, "a guess"), "metadata", (1280, 720))
    before = CameraEstimate(size_px=(1280, 720), sources=(source,))
    fit = SimpleNamespace(
        focal_sigma=0.092,
        contradiction=1.0,
        gain=lambda name: 0.0,
        correlation=lambda *names: 0.0,
        height_m=1.4,
        height_sigma_m=0.1,
        pitch_rad=lambda camera: 0.0,
        pitch_sigma_rad=0.01,
    )
    known = source_of_guess(
        FocalGuess(883.0, 0.04, "the known metres"), "known metres", (1280, 720)
    )
    parts = {"shapes": None, "scene": SceneBoxes(), "n_frames": 1, "before": before}
    mounted = MountedCamera(estimate=before.with_source(known), fit=fit, **parts)
    (first, *_) = separability(mounted, has_height=True)
    assert first.startswith("Focal length 87")
    assert "px within 3.7 %, from the measurements; without them, 83" in first
    assert first.endswith("%, from a guess.")
    # without measurements, and with ones that contradict each other
    (first, *_) = separability(MountedCamera(estimate=before, fit=fit, **parts), has_height=True)
    assert first.endswith("%, from a guess.")
    fit.contradiction, fit.largest_deviation = 2.0, ("a lane", 5.0)
    (warning, second, *_) = separability(mounted, has_height=True)
    assert "a lane" in warning
    assert "within 9.2 %" in second

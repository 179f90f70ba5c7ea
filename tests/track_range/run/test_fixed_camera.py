"""Runs of a camera that stands still, on recorded boxes of the scenario with exact truth."""

import csv
import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

import track_range as tr
from tests.support.command_line import run_command
from tests.support.recordings.recording_files import write_video
from track_range.errors import UsageError
from track_range.run.reports.fixed_camera import FixedCamera
from track_range.simulation.camera.fixed_files import crossings, line_texts, point_texts
from track_range.simulation.camera.playback import play_back
from track_range.simulation.tables import kitti_text
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import label_scene

CAMERA = tr.PinholeCamera.of_focal_length(410.0, (640, 360))
FPS, SECONDS, SEED = 10, 7.0, 5


@pytest.fixture(scope="module")
def street(tmp_path_factory):
    """A folder with a grey video, its boxes and the plane of its road, and the scene."""
    folder = tmp_path_factory.mktemp("street")
    scene = make_scenario("fixed", seed=SEED, seconds=SECONDS)
    times_s = (np.arange(round(FPS * SECONDS)) / FPS).tolist()
    labels = label_scene(scene, times_s, camera=CAMERA)
    boxes = play_back(labels, seed=SEED, image_size_px=CAMERA.size_px)
    (folder / "boxes.txt").write_text(kitti_text(boxes))
    image = np.full((360, 640, 3), 120, np.uint8)
    write_video(folder / "street.mp4", [[image] * len(times_s)], rate=FPS)
    return folder, scene


def points(scene):
    texts = point_texts(scene, CAMERA, np.random.default_rng(0), click_px=0.5)
    return [word for text in texts for word in ("--known-point", text)]


@pytest.fixture(scope="module")
def counted(street, tmp_path_factory):
    """Output folder of a run with lines and a zone, and what it printed."""
    folder, scene = street
    out = tmp_path_factory.mktemp("out") / "results"
    fitted = run_command(
        *("calibrate", "ground", folder / "street.mp4", *points(scene)),
        *("--out", folder / "ground.yaml", "--picture", folder / "ground.png"),
    )
    assert fitted.status == 0, fitted.stderr
    assert "Lengths on the road are known to" in fitted.stdout
    lines = [word for text in line_texts(scene, CAMERA) for word in ("--count-line", text)]
    done = run_command(
        *("--mono", folder / "street.mp4", "--detections", folder / "boxes.txt"),
        *("--static-camera", "--ground", folder / "ground.yaml", *lines),
        *("--zone", "yard=0,180,639,180,639,359,0,359", "--out", out),
    )
    assert done.status == 0, done.stderr
    return out, done.stdout


@pytest.mark.slow
def test_counts_times_and_speeds_are_those_of_the_scene(street, counted):
    _, scene = street
    out, _ = counted
    with (out / "crossings.csv").open() as file:
        rows = [row for row in csv.DictReader(file) if row["kind"] == "line"]
    # of tracks that are confirmed before, and leave the line before the end
    true = [one for one in crossings(scene, SECONDS) if 1.0 < one[3] < SECONDS - 0.5]
    errors_kmh, free = [], list(rows)
    for name, _, kind, time_s, speed_mps, direction in true:
        for row in free:
            is_same = (row["place"], row["direction"], row["class"]) == (name, direction, kind)
            if is_same and abs(float(row["time_s"]) - time_s) < 0.4:
                free.remove(row)
                errors_kmh.append(abs(float(row["speed_kmh"] or "nan") - 3.6 * speed_mps))
                break
    assert len(true) >= 6
    assert len(errors_kmh) >= len(true) - 1  # a car may be hidden behind a truck
    assert np.nanmedian(errors_kmh) < 3.0
    assert len(free) <= 2


@pytest.mark.slow
def test_results_speak_of_speeds_and_counts_and_of_no_collision(counted):
    out, printed = counted
    summary = json.loads((out / "summary.json").read_text())
    assert summary["fixed_camera"]["ground"]["height_m"] == pytest.approx(6.0, abs=1.5)
    assert set(summary["counts"]["lines"]) == {"near", "far"}
    users = summary["fixed_camera"]["road_users"]
    assert any(user["speed_kmh"] is not None and user["speed_kmh"] > 20 for user in users)
    assert summary["events"]["n"] == 0
    page = (out / "report.html").read_text()
    content = page.partition("<main")[2].partition("<script")[0]
    for text in (printed, content, *summary["notes"]):
        assert "collision" not in text.lower()
    assert "85th percentile" in printed
    assert "fastest road user" in page
    with (out / "tracks.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert {row["ego_mps"] for row in rows} == {"0.000"}
    assert all(not row["mono_m"] for row in rows)
    assert any(row["ground_m"] for row in rows)


@pytest.mark.slow
@pytest.mark.usefixtures("counted")  # which fits the plane
def test_pipeline_and_counter_in_a_loop(street):
    folder, scene = street
    plane = tr.load_ground(folder / "ground.yaml")
    counter = tr.LineCounter.of(line_texts(scene, CAMERA), plane=plane)
    run = tr.Run.mono(
        folder / "street.mp4",
        detections=folder / "boxes.txt",
        static_camera=True,
        ground=folder / "ground.yaml",
        duration=3.0,
    )
    for frame in run:
        counter.update(frame)
        assert frame.ego_mps == 0.0
    assert run.summary["fixed_camera"]["ground"]["source"].endswith("points")
    assert len(counter.finish()) > 0


def test_options_of_a_fixed_camera_need_it(cli, tmp_path):
    status, _, errors = cli("--mono", "video.mp4", "--count-line", "a=1,2,3,4")
    assert status == 2
    assert "--static-camera" in errors
    status, _, errors = cli("--mono", "video.mp4", "--static-camera", "--zone", "a=1,2,3,4")
    assert status == 2
    assert "X3,Y3" in errors
    status, _, errors = cli("--mono", "video.mp4", "--static-camera", "--ego-speed", "10")
    assert status == 2
    assert "--ego-speed is for a camera that drives" in errors


def test_a_line_outside_of_the_video_is_refused(street):
    folder, _ = street
    run = tr.Run.mono(
        folder / "street.mp4",
        static_camera=True,
        count_line=("a=10,300,900,300",),
        detections=folder / "boxes.txt",
    )
    with pytest.raises(UsageError, match=r"line or zone a: .* 640x360"):
        next(iter(run))


@pytest.mark.parametrize(("known", "is_noted"), [(66, True), (20, False)])
def test_a_recording_that_stands_is_told_of_the_option(known, is_noted):
    speeds = [math.nan] * (70 - known) + [0.0] * known
    for extra in ([], [3.0] * 20):  # a drive that waits at a light
        rows = SimpleNamespace(
            ego_mps=speeds + extra, seconds=7.0, counter=SimpleNamespace(n_unsure={})
        )
        notes = FixedCamera(rows, None, is_static=False).notes()
        assert any("--static-camera" in note for note in notes) == (is_noted and not extra)


def test_measurements_that_are_none_are_refused(cli, street):
    folder, _ = street
    video = folder / "street.mp4"
    for given, word in (
        ([], "--known-point or --known-length"),
        (["--known-length", "1,2,3=4"], "X1,Y1,X2,Y2=METRES"),
        (["--known-length", "10,200,300,200=-4"], "above 0 m"),
        (["--known-point", "10,200=0,0"], "two or more points"),
        (["--known-length", "10,200,3000,200=4"], "640x360"),
        (["--known-length", "100,300,300,300=4"], "along the view"),
    ):
        status, _, errors = cli("calibrate", "ground", video, *given, "--out", folder / "no.yaml")
        assert status in (1, 2)
        assert word in errors
    assert not (folder / "no.yaml").exists()

"""Whole runs of the command line on a simulated drive and, where there are any, on real
recordings."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import yaml

from track_range.detection.boxes import iou
from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.results.progress_note import describe_progress
from track_range.results.rows.columns import column_names

TRACK_RANGE = Path(sys.executable).with_name("track-range")
STAGES = ["read", "detect", "track", "mono", "lane", "stereo", "sgbm", "fuse", "write"]
STEREO_METHODS = ["mono", "stereo", "sgbm", "fused", "mono_kf", "stereo_kf", "fused_kf"]


@pytest.fixture(scope="session")
def track_range(cli):
    """Runs a command that must succeed; returns its output."""

    def run(*arguments, **more):
        done = cli(*arguments, **more)
        assert done.status == 0, done.stderr
        return done.stdout

    return run


@pytest.fixture(scope="session")
def simulated_drive(render_drive):
    return render_drive(seed=3, seconds=1.6)


@pytest.fixture(scope="session")
def simulated_run(simulated_drive, track_range, tmp_path_factory):
    out = tmp_path_factory.mktemp("run") / "out"
    stereo = (
        "--stereo",
        simulated_drive.left,
        simulated_drive.right,
        "--detections",
        simulated_drive.detections,
    )
    printed = track_range(*stereo, "--truth", simulated_drive.truth, "--align", "off", "--out", out)
    return out, printed, json.loads((out / "summary.json").read_text())


def n_frames_of(video):
    with av.open(str(video)) as container:
        return sum(1 for _ in container.decode(video=0))


def n_playable_frames_of(video):
    """Frames before the first damaged one: a kill may stop the kernel within the write of the last
    fragment."""
    n = 0
    with av.open(str(video)) as container, suppress(av.error.InvalidDataError):
        for _ in container.decode(video=0):
            n += 1
    return n


def test_all_files_are_complete(simulated_run):
    out, _, _ = simulated_run
    rows = {"tracks.csv", "mot.txt", "tracks.parquet", "events.csv", "events.parquet", "poses.csv"}
    names = {"summary.json", "settings.yaml", "overlay.mp4", "report.html"}
    assert {file.name for file in out.iterdir()} == rows | names
    assert n_frames_of(out / "overlay.mp4") == 16
    with (out / "tracks.csv").open() as file:
        assert next(csv.reader(file)) == list(column_names())
    assert "<html" in (out / "report.html").read_text()


def test_summary_keys(simulated_run):
    _, _, summary = simulated_run
    assert summary["frames"] == 16
    assert set(STAGES) <= set(summary["stages_ms"])
    assert summary["stages_ms"]["sgbm"] > 0
    assert set(STEREO_METHODS) <= set(summary["methods"])
    for section in ("methods", "common"):
        for score in summary[section].values():
            assert 0 < score["coverage"] <= 1
            assert 0 <= score["within_1_sigma"] <= score["within_2_sigma"] <= 1
            assert {"n", "mean_relative_error_pct", "median_relative_error_pct", "bias_pct"} <= set(
                score
            )
            assert [band["from_m"] for band in score["bands"]] == [5, 10, 20, 30, 50]
    assert len({score["n"] for score in summary["common"].values()}) == 1
    assert {"n", "mota", "idf1", "idsw"} <= set(summary["tracks"])
    assert all(n > 0 for n in summary["stereo_unmatched"].values())


def test_errors_on_the_exact_world(simulated_run):
    _, _, summary = simulated_run
    methods = summary["methods"]
    assert methods["stereo"]["median_relative_error_pct"] < 2.0
    assert methods["sgbm"]["median_relative_error_pct"] < 3.0
    assert methods["mono"]["median_relative_error_pct"] < 12.0
    assert methods["fused"]["median_relative_error_pct"] < 3.0
    assert summary["tracks"]["mota"] > 30


@pytest.mark.slow
def test_truth_is_not_read_by_methods(simulated_drive, simulated_run, track_range, tmp_path):
    """The same files without the truth, in a folder where there is none: every measurement stays
    the same."""
    names = ("left", "right", "rig", "detections", "ego_speed")
    for name in names:
        shutil.copy(getattr(simulated_drive, name), tmp_path)
    left, right, rig, boxes, _ = (tmp_path / getattr(simulated_drive, name).name for name in names)
    track_range(
        "--stereo",
        left,
        right,
        "--rig",
        rig,
        "--detections",
        boxes,
        "--align",
        "off",
        "--no-overlay",
        "--out",
        tmp_path / "out",
    )
    without, with_truth = (
        read_tracks_csv(folder / "tracks.csv") for folder in (tmp_path / "out", simulated_run[0])
    )
    measured = [name for name in without if not name.startswith("truth")]
    assert {f"{name}_m" for name in STEREO_METHODS} <= set(measured)
    for name in measured:
        np.testing.assert_array_equal(without[name], with_truth[name])


def test_what_happened_is_printed_and_tables_with_verbose(
    simulated_run, simulated_drive, track_range, tmp_path
):
    brief = simulated_run[1]
    inputs = (
        "--stereo",
        simulated_drive.left,
        simulated_drive.right,
        "--detections",
        simulated_drive.detections,
        "--truth",
        simulated_drive.truth,
    )
    verbose = track_range(
        *inputs,
        "--align",
        "off",
        "--no-overlay",
        "--duration",
        0.3,
        "--verbose",
        "--out",
        tmp_path / "v",
    )
    assert "\r" not in brief
    for words in (
        "found next to the left video",
        "Road users",
        "Accuracy against the ground truth",
        "MOTA",
    ):
        assert words in brief
        assert words in verbose
    for words in ("fused_kf", "ms/frame", "common coverage"):
        assert words not in brief
        assert words in " ".join(verbose.split())


@pytest.mark.slow
def test_settings_repeat_the_run(simulated_run, track_range, tmp_path):
    out, _, summary = simulated_run
    track_range("--settings", out / "settings.yaml", "--out", tmp_path / "again", "--no-overlay")
    again = json.loads((tmp_path / "again" / "summary.json").read_text())
    assert again["methods"] == summary["methods"]
    assert again["tracks"] == summary["tracks"]
    assert (tmp_path / "again" / "tracks.csv").read_text() == (out / "tracks.csv").read_text()
    assert not (tmp_path / "again" / "overlay.mp4").exists()


def test_one_camera_with_classes_and_a_time_window(simulated_drive, track_range, tmp_path):
    options = (
        "--detections",
        simulated_drive.detections,
        "--classes",
        "car",
        "--start",
        "0.5",
        "--duration",
        "0.6",
    )
    track_range("--mono", simulated_drive.left, *options, "--out", tmp_path / "out")
    columns = read_tracks_csv(tmp_path / "out" / "tracks.csv")
    assert set(columns["class"]) == {"car"}
    assert (columns["frame"].min(), columns["frame"].max()) == (5, 10)
    assert np.isnan(columns["stereo_m"]).all()
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert {"fused", "fused_kf", "ground", "mono", "mono_kf"} <= set(summary["methods"])
    assert "stereo" not in summary["methods"]
    assert summary["methods"]["mono"]["bias_pct"] is None


def test_default_output_folder(simulated_drive, track_range, tmp_path):
    stereo = (
        "--stereo",
        simulated_drive.left,
        simulated_drive.right,
        "--detections",
        simulated_drive.detections,
        "--no-sgbm",
        "--no-overlay",
    )
    printed = track_range(*stereo, "--duration", "0.3", folder=tmp_path)
    assert (tmp_path / "left-track-range" / "summary.json").is_file()
    assert "left-track-range" in printed


@pytest.mark.slow
def test_image_folder_equals_video(simulated_drive, track_range, tmp_path):
    write_images(simulated_drive, tmp_path)
    options = (
        "--detections",
        simulated_drive.detections,
        "--rig",
        simulated_drive.rig,
        "--no-sgbm",
        "--no-overlay",
        "--align",
        "off",
    )
    track_range(
        "--stereo", tmp_path / "left", tmp_path / "right", *options, "--out", tmp_path / "images"
    )
    track_range(
        "--stereo",
        simulated_drive.left,
        simulated_drive.right,
        *options,
        "--out",
        tmp_path / "video",
    )
    images, video = (
        read_tracks_csv(tmp_path / name / "tracks.csv") for name in ("images", "video")
    )
    np.testing.assert_array_equal(images["track_id"], video["track_id"])
    np.testing.assert_allclose(images["stereo_m"], video["stereo_m"], atol=1e-3)


def write_images(drive, folder):
    """The videos of a drive as folders of images."""
    for side in ("left", "right"):
        (folder / side).mkdir()
        with av.open(str(getattr(drive, side))) as container:
            for number, frame in enumerate(container.decode(video=0)):
                cv2.imwrite(
                    str(folder / side / f"{number:06d}.png"), frame.to_ndarray(format="bgr24")
                )


@pytest.fixture(scope="session")
def long_drive(simulated_drive, tmp_path_factory):
    """The images of the drive 60 times over, so that a run does not end before it is stopped, on a
    busy machine too."""
    folder, n, n_rounds = tmp_path_factory.mktemp("long"), n_frames_of(simulated_drive.left), 60
    write_images(simulated_drive, folder)
    for side in ("left", "right"):
        for number in range(n, n * n_rounds):
            os.link(folder / side / f"{number % n:06d}.png", folder / side / f"{number:06d}.png")
    rows = [line.split(maxsplit=1) for line in simulated_drive.detections.read_text().splitlines()]
    shifted = [
        f"{int(frame) + n * turn} {rest}" for turn in range(n_rounds) for frame, rest in rows
    ]
    (folder / "detections.txt").write_text("\n".join(shifted))
    return replace(
        simulated_drive,
        left=folder / "left",
        right=folder / "right",
        detections=folder / "detections.txt",
    )


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_stopped_run_keeps_its_frames(long_drive, tmp_path, number):
    out = tmp_path / "out"
    files = ("--stereo", long_drive.left, long_drive.right, "--rig", long_drive.rig)
    quick = ("--align", "off", "--lanes", "off")
    process = subprocess.Popen(
        [TRACK_RANGE, *files, "--detections", long_drive.detections, *quick, "--out", out],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        wait_for(lambda: last_frame(out / "tracks.csv") >= 40, process)
        process.send_signal(number)
        _, stderr = process.communicate(timeout=300)
    finally:
        process.kill()
    columns = read_tracks_csv(out / "tracks.csv")
    assert 40 <= columns["frame"].max() < len(list(long_drive.left.iterdir())) - 1
    if number == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL
        assert columns["frame"].max() + 1 - n_playable_frames_of(out / "overlay.mp4") <= 5
        assert "killed" in describe_progress(out)
        return
    assert process.returncode == 1
    assert stderr.count("\n") == 1
    assert stderr.startswith("track-range: stopped by the user")
    summary = json.loads((out / "summary.json").read_text())
    assert summary["frames"] == n_frames_of(out / "overlay.mp4") == columns["frame"].max() + 1
    assert (out / "report.html").is_file()


@pytest.mark.slow
def test_killed_while_the_alignment_is_estimated(long_drive, tmp_path, cli):
    out = tmp_path / "out"
    options = ("--stereo", long_drive.left, long_drive.right, "--rig", long_drive.rig, "--out", out)
    process = subprocess.Popen(
        [TRACK_RANGE, *options, "--detections", long_drive.detections],
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
    )
    try:
        wait_for(lambda: "estimating the alignment" in (describe_progress(out) or ""), process)
        status, _, complaint = cli(*options)
        assert (status, f"process {process.pid}" in complaint) == (1, True)
        assert not (out / "tracks.csv").exists()
    finally:
        process.kill()
        process.communicate()
    assert (out / "settings.yaml").is_file()
    status, _, complaint = cli("report", out)
    assert (
        status,
        "killed while estimating the alignment" in complaint,
        complaint.count("\n"),
    ) == (1, True, 1)
    assert (
        cli(*options, "--duration", 0.2, "--detections", long_drive.detections, "--align", "off")[0]
        == 0
    )
    assert not (out / "progress.json").exists()


def last_frame(rows):
    """The last frame in a tracks.csv that is being written; -1 = none yet."""
    if not rows.is_file():
        return -1
    frames = [line.split(",")[0] for line in rows.read_text().splitlines()]
    return int(frames[-1]) if len(frames) > 1 and frames[-1].isdigit() else -1


def wait_for(condition, process, limit_s=600):
    """Poll until a condition holds; a process that ends first fails the test, and so does one that
    hangs."""
    end_s = time.monotonic() + limit_s
    while not condition():
        assert time.monotonic() < end_s, "the process hangs"
        assert process.poll() is None, process.stderr.read()
        time.sleep(0.05)


def test_installed_command():
    """The console script: what it prints, and its exit status."""

    def run(*arguments):
        return subprocess.run(
            [TRACK_RANGE, *arguments], capture_output=True, text=True, check=False
        )

    assert run("--version").stdout.startswith("track-range 0.")
    wrong = run("--colour", "red")
    assert (wrong.returncode, wrong.stdout, "--colour" in wrong.stderr) == (2, "", True)


def test_help_names_options_and_commands(track_range, cli):
    help_text = track_range("--help")
    for word in ("--stereo", "--mono", "--rig", "--detections", "demo", "fit", "Examples"):
        assert word in help_text
    assert "--focal-px" in track_range("run", "--help")
    assert "--seed" in track_range("demo", "--help")
    assert cli("--stereo", "one.mp4", "--stereo-layout", "diagonal").status == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("option", "boxes"), [((), "packaged detector"), (("--playback",), "true boxes with noise")]
)
def test_demo(tmp_path, track_range, option, boxes):
    printed = track_range("demo", "--out", tmp_path / "demo", "--seconds", "0.5", *option)
    assert boxes in printed
    assert (tmp_path / "demo" / "report.html").is_file()
    assert str(tmp_path / "demo" / "report.html") in printed
    assert len(printed.splitlines()) <= 26  # two notes, then one screen


# --- real video
# -------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="session", params=["0003", "0005"])
def kitti_run(request, shared_data, track_range, tmp_path_factory):
    drive = shared_data / "kitti_stereo" / request.param
    out = tmp_path_factory.mktemp("kitti") / request.param
    model = shared_data / "models/yolov5n_coco_640.onnx"
    stereo = ("--stereo", drive / "left.mp4", drive / "right.mp4", "--rig", drive / "calib.txt")
    track_range(*stereo, "--detector", model, "--truth", drive / "label.txt", "--out", out)
    return drive, out, json.loads((out / "summary.json").read_text())


def test_real_cars_are_tracked(kitti_run):
    """Every car at least 30 px high, not truncated, at most partly occluded: in a track in 80 % of
    those frames."""
    drive, out, _ = kitti_run
    labels, columns = read_kitti(drive / "label.txt"), read_tracks_csv(out / "tracks.csv")
    boxes = np.stack([columns[f"{edge}_px"] for edge in ("x1", "y1", "x2", "y2")], axis=1)
    high = labels.xyxy_px[:, 3] - labels.xyxy_px[:, 1] >= 30
    clear = (labels.kitti_type == "Car") & (labels.truncated == 0) & (labels.occluded <= 1) & high
    assert clear.sum() > 10
    for car in np.unique(labels.track_id[clear]):
        rows = np.flatnonzero(clear & (labels.track_id == car))
        is_tracked = [
            iou(labels.xyxy_px[[i]], boxes[columns["frame"] == labels.frame[i]]).max(initial=0)
            >= 0.5
            for i in rows
        ]
        assert np.mean(is_tracked) >= 0.8, f"car {car}: {sum(is_tracked)} of {len(is_tracked)}"


def test_real_stereo_error_below_three_per_cent(kitti_run):
    """Six matchers measure disparities half a pixel too small here; uncorrected medians are 3 to 4
    %."""
    _, _, summary = kitti_run
    methods, alignment = summary["methods"], summary["alignment"]
    assert alignment["is_applied"]
    assert 0.2 < alignment["offset_px"] < 0.7
    assert summary["calibration"] == "rig"
    for name in ("stereo", "sgbm"):
        assert 0.2 < methods[name]["median_relative_error_pct"] <= 3.0
    assert methods["stereo"]["bias_pct"] is not None
    assert methods["fused"]["median_relative_error_pct"] <= 10.0


def test_real_grey_pair_and_single_camera(shared_data, track_range, tmp_path):
    model = shared_data / "models/yolov5n_coco_dyn.onnx"
    grey = shared_data / "kitti_odometry/gray51"
    track_range(
        "--stereo",
        grey / "left.mp4",
        grey / "right.mp4",
        "--detector",
        model,
        "--out",
        tmp_path / "grey",
    )
    summary = json.loads((tmp_path / "grey/summary.json").read_text())
    assert summary["frames"] == 51
    assert summary["methods"]["stereo"]["coverage"] > 0.5
    assert yaml.safe_load((tmp_path / "grey/settings.yaml").read_text())["found"][
        "baseline_m"
    ] == pytest.approx(0.5371, abs=1e-3)
    film = shared_data / "dashcam/highway_two_cars.mp4"
    track_range("--mono", film, "--focal-px", 1150, "--detector", model, "--out", tmp_path / "mono")
    columns = read_tracks_csv(tmp_path / "mono/tracks.csv")
    assert (columns["class"] == "car").mean() > 0.8
    assert 10 < np.nanmedian(columns["mono_m"]) < 40


def scaled_labels(truth, scale, n_rounds=10):
    """KITTI rows of a drive with sizes and places multiplied, its frames repeated because a fit
    requires 100 boxes."""
    rows = [line.split() for line in truth.read_text().splitlines()]
    for turn in range(n_rounds):
        for frame, *rest in rows:
            lengths = [f"{scale * float(value):.4f}" for value in rest[9:15]]  # h w l x y z
            yield " ".join([str(int(frame) + 16 * turn), *rest[:9], *lengths, *rest[15:]])


@pytest.mark.slow
def test_fitted_curves_in_a_run(simulated_drive, track_range, cli, tmp_path):
    """`fit` on labels, and runs with its curves: of a drive, and of one in which everything is 1.2
    times as large."""
    (tmp_path / "calib").mkdir()
    (tmp_path / "calib/0000.txt").write_text(simulated_drive.rig.read_text())
    run = (
        "--mono",
        simulated_drive.left,
        "--detections",
        simulated_drive.detections,
        "--truth",
        simulated_drive.truth,
        "--no-overlay",
    )
    distances_m = []
    for scale in (1.0, 1.2):
        labels = tmp_path / f"labels{scale}"
        labels.mkdir()
        (labels / "0000.txt").write_text("\n".join(scaled_labels(simulated_drive.truth, scale)))
        fit = ("fit", "--labels", labels, "--calib", tmp_path / "calib", "--out")
        assert "car" in track_range(*fit, tmp_path / f"curves{scale}.json")
        track_range(
            *run, "--curves", tmp_path / f"curves{scale}.json", "--out", tmp_path / f"run{scale}"
        )
        columns = read_tracks_csv(tmp_path / f"run{scale}/tracks.csv")
        # later the drive corrects wrong sizes
        distances_m.append(columns["mono_m"][columns["frame"] < 3])
    assert np.nanmedian(distances_m[1] / distances_m[0]) == pytest.approx(1.2, rel=0.05)
    summary = json.loads((tmp_path / "run1.0/summary.json").read_text())
    assert summary["methods"]["mono"]["mean_relative_error_pct"] < 10
    for wrong, words in (
        ((*fit, tmp_path / "none" / "curves.json"), "curves.json"),
        ((*fit, tmp_path / "c.json", "--leave-out", "0009"), "0009"),
        (
            ("fit", "--labels", tmp_path, "--calib", tmp_path, "--out", tmp_path / "c.json"),
            "label files",
        ),
    ):
        failed = cli(*wrong)
        assert (failed.status, words in failed.stderr) == (1, True), failed.stderr


@pytest.mark.slow
def test_boxes_of_a_raw_video_are_rectified(simulated_drive, track_range, tmp_path):
    """With lens distortion, boxes in pixels of the video are converted to undistorted pixels."""
    rig = yaml.safe_load(simulated_drive.rig.read_text())
    rig["left"]["distortion"] = [-0.3, 0.1, 0, 0, 0]
    (tmp_path / "lens.yaml").write_text(yaml.safe_dump(rig))
    run = (
        "--mono",
        simulated_drive.left,
        "--detections",
        simulated_drive.detections,
        "--no-overlay",
        "--duration",
        "0.5",
        "--out",
    )
    track_range(*run, tmp_path / "raw", "--rig", tmp_path / "lens.yaml")
    track_range(*run, tmp_path / "ideal", "--rig", simulated_drive.rig)
    raw, ideal = (
        read_tracks_csv(tmp_path / name / "tracks.csv")["x2_px"] for name in ("raw", "ideal")
    )
    # undistortion moves points on the right further to the right
    assert raw.max() > ideal.max() + 10


def test_boxes_of_another_video(simulated_drive, track_range, tmp_path):
    rows = [line.split(maxsplit=1) for line in simulated_drive.detections.read_text().splitlines()]
    (tmp_path / "late.txt").write_text(
        "\n".join(f"{int(frame) + 500} {rest}" for frame, rest in rows)
    )
    run = (
        "--mono",
        simulated_drive.left,
        "--rig",
        simulated_drive.rig,
        "--detections",
        tmp_path / "late.txt",
        "--no-overlay",
    )
    printed = " ".join(track_range(*run, "--out", tmp_path / "out").split())
    assert "--detections has boxes for frames 500 to 515" in printed


def test_boxes_of_another_detector_on_real_video(shared_data, track_range, tmp_path):
    drive = shared_data / "kitti_stereo/0003"
    stereo = ("--stereo", drive / "left.mp4", drive / "right.mp4", "--no-sgbm", "--no-overlay")
    printed = track_range(
        *stereo,
        "--detections",
        drive / "regionlets.txt",
        "--truth",
        drive / "label.txt",
        "--out",
        tmp_path,
    )
    assert "sigmoid" in printed
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert summary["methods"]["stereo"]["n"] > 5

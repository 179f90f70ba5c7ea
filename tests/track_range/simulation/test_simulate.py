"""Tests of `track-range simulate`: drives and images, runs on them, and invalid options."""

import csv
import os

import cv2
import numpy as np
import pytest
import yaml

from track_range.recording.sources.open_video import open_video
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_rig

FILES = {
    "left.mp4",
    "right.mp4",
    "rig.yaml",
    "truth.txt",
    "truth.csv",
    "contacts.csv",
    "ego_speed.csv",
    "detections.txt",
}


def rig_file(path, *, width_px=310, height_px=94, baseline_m=0.54, distortion=(), rotation=None):
    camera = PinholeCamera(180.0, 180.0, 152.0, 43.0, width_px, height_px, distortion)
    motion = np.eye(4)
    motion[0, 3] = -baseline_m
    if rotation is not None:
        motion[:3, :3] = cv2.Rodrigues(np.array(rotation))[0]
    save_rig(StereoRig(camera, camera, motion), path)
    return path


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return rig_file(tmp_path_factory.mktemp("rig") / "rig.yaml")


@pytest.mark.slow
def test_drive_and_run_on_it(cli, rig, tmp_path):
    drive = tmp_path / "drive"
    status, printed, errors = cli(
        "simulate", "--out", drive, "--seconds", 0.3, "--rig", rig, "--seed", 3
    )
    assert status == 0, errors
    assert {path.name for path in drive.iterdir()} == FILES
    assert (
        f"--stereo {drive / 'left.mp4'} {drive / 'right.mp4'} --rig {drive / 'rig.yaml'}" in printed
    )
    with (drive / "truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["frame"] for row in rows} == {"0", "1", "2"}
    assert {row["class"] for row in rows} >= {"car", "person"}
    arguments = [
        "--stereo",
        drive / "left.mp4",
        drive / "right.mp4",
        "--rig",
        drive / "rig.yaml",
        "--no-sgbm",
    ]
    assert f"--truth {drive / 'truth.csv'}" in printed
    inputs = ["--truth", drive / "truth.csv", "--detections", drive / "detections.txt"]
    status, _, errors = cli(
        *arguments, *inputs, "--ego-speed", drive / "ego_speed.csv", "--out", tmp_path / "run"
    )
    assert status == 0, errors
    assert (tmp_path / "run" / "tracks.csv").stat().st_size > 100


@pytest.mark.slow
def test_seed(cli, rig, tmp_path):
    texts = []
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        arguments = ["--scenario", "queue", "--seconds", 0.1, "--rig", rig, "--seed", seed]
        assert cli("simulate", "--out", tmp_path / name, *arguments)[0] == 0
        texts.append([(tmp_path / name / file).read_bytes() for file in sorted(FILES)])
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


@pytest.mark.slow
def test_faults_reach_the_files(cli, rig, tmp_path):
    plain, faulty = tmp_path / "plain", tmp_path / "faulty"
    assert cli("simulate", "--out", plain, "--seconds", 0.2, "--rig", rig, "--noise", 0)[0] == 0
    faults = [
        "--gain",
        1.3,
        "--rain",
        0.2,
        "--blur",
        1,
        "--row-offset",
        2,
        "--disparity-offset",
        1,
        "--late",
        -0.05,
    ]
    more = ["--noise", 6, "--wrong-rig", "baseline", "--drop-frames", 0]
    status, _, errors = cli(
        "simulate", "--out", faulty, "--seconds", 0.2, "--rig", rig, *faults, *more
    )
    assert status == 0, errors
    means = [
        next(iter(open_video(folder / "right.mp4"))).image.mean() for folder in (plain, faulty)
    ]
    assert 1.15 < means[1] / means[0] < 1.4
    baselines = [
        yaml.safe_load((folder / "rig.yaml").read_text())["right_from_left"]["translation_m"][0]
        for folder in (plain, faulty)
    ]
    assert baselines == pytest.approx([-0.54, -0.567])
    assert (plain / "truth.txt").read_bytes() == (faulty / "truth.txt").read_bytes()


@pytest.mark.slow
def test_lossless_folders(cli, rig, tmp_path):
    arguments = [
        "--seconds",
        0.25,
        "--fps",
        20,
        "--rig",
        rig,
        "--lossless",
        "--disparity",
        "--scenario",
        "town",
    ]
    status, printed, errors = cli("simulate", "--out", tmp_path, *arguments)
    assert status == 0, errors
    assert printed.rstrip().endswith("--fps 20")
    assert (
        len(list((tmp_path / "left").iterdir()))
        == len(list((tmp_path / "disp_occ_0").iterdir()))
        == 5
    )


@pytest.mark.slow
def test_odd_image_size_grows_by_one(cli, tmp_path):
    rig = rig_file(tmp_path / "odd.yaml", width_px=311, height_px=93)
    status, printed, _ = cli("simulate", "--out", tmp_path / "d", "--seconds", 0.1, "--rig", rig)
    assert status == 0
    assert "312 x 94" in printed
    assert "odd.yaml" in printed
    assert yaml.safe_load((tmp_path / "d" / "rig.yaml").read_text())["left"]["width_px"] == 312


@pytest.mark.slow
def test_kitti_calibration_is_nearly_rectified(cli, tmp_path):
    projection = "721.5 0 609.6 {} 0 721.5 172.9 {} 0 0 1 {}"
    calib = tmp_path / "calib.txt"
    calib.write_text(
        f"P2: {projection.format(44.86, 0.216, 0.003)}\nP3: "
        f"{projection.format(-339.5, 2.2, 0.003)}\n"
    )
    status, printed, errors = cli(
        "simulate", "--out", tmp_path / "d", "--seconds", 0.1, "--rig", calib
    )
    assert status == 0, errors
    assert "1242 x 375" in printed
    assert "1242 x 376" in printed
    motion = yaml.safe_load((tmp_path / "d" / "rig.yaml").read_text())["right_from_left"][
        "translation_m"
    ]
    assert motion == pytest.approx([-0.5327, 0, 0], abs=1e-3)


@pytest.mark.slow
def test_training_images(cli, tmp_path):
    status, printed, errors = cli(
        "simulate", "--out", tmp_path / "sim", "--images", 2, "--frames", 1
    )
    assert status == 0, errors
    names = sorted(path.name for path in (tmp_path / "sim" / "images").iterdir())
    assert names == ["001000_00.jpg", "001001_00.jpg"]
    assert "2 images" in printed
    arguments = ("--images", 1, "--scenario", "night", "--seed", 3)
    assert cli("simulate", "--out", tmp_path / "night", *arguments)[0] == 0
    grey = [cv2.imread(str(path)).mean() for path in (tmp_path / "night/images").iterdir()]
    assert len(grey) == 1
    assert grey[0] < 50 < cv2.imread(str(tmp_path / "sim" / "images" / names[0])).mean()


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--scenario", "suburb"], "--scenario"),
        (["--seconds", 0], "--seconds"),
        (["--seconds", "nan"], "--seconds"),
        (["--seconds", 1e9], "--seconds"),
        (["--wrong-rig", "wheels"], "--wrong-rig"),
        (["--images", 2, "--scenario", "suburb"], "--scenario"),
        (["--images", 2, "--rain", 0.5], "--images"),
        (["--images", 2, "--noise", 2], "--images"),
    ],
)
def test_wrong_usage(cli, tmp_path, arguments, word):
    status, _, errors = cli("simulate", "--out", tmp_path / "d", *arguments)
    assert status == 2
    assert word in errors
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize(
    "rig", [{"rotation": (0.0, 0.02, 0.0)}, {"distortion": (-0.2, 0.05, 0.0, 0.0)}]
)
def test_rig_is_not_rectified(cli, tmp_path, rig):
    file = rig_file(tmp_path / "rig.yaml", **rig)
    status, _, errors = cli("simulate", "--out", tmp_path / "d", "--seconds", 0.1, "--rig", file)
    assert status == 1
    assert "rig.yaml: expected a rectified pair" in errors


def test_swapped_cameras(cli, rig, tmp_path):
    (tmp_path / "rig.yaml").write_text(rig.read_text().replace("-0.54", "0.54"))
    status, _, errors = cli(
        "simulate", "--out", tmp_path / "d", "--seconds", 0.1, "--rig", tmp_path / "rig.yaml"
    )
    assert status == 1
    assert "swap" in errors


def test_rig_file_of_one_camera_or_missing(cli, rig, tmp_path):
    mono = tmp_path / "mono.yaml"
    mono.write_text(
        yaml.safe_dump(
            {k: v for k, v in yaml.safe_load(rig.read_text()).items() if "right" not in k}
        )
    )
    for file, word in ((mono, "two cameras"), (tmp_path / "none.yaml", "none.yaml")):
        status, _, errors = cli(
            "simulate", "--out", tmp_path / "d", "--seconds", 0.1, "--rig", file
        )
        assert status == 1
        assert word in errors


@pytest.mark.slow
def test_unwritable_folder(cli, rig, tmp_path):
    (tmp_path / "file").write_text("in the way")
    status, _, errors = cli(
        "simulate", "--out", tmp_path / "file" / "d", "--seconds", 0.1, "--rig", rig
    )
    assert status == 1
    assert "written" in errors


@pytest.mark.skipif(
    os.name != "posix" or os.geteuid() == 0, reason="root can write to every folder"
)
def test_folder_without_permission(cli, rig, tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    status, _, errors = cli(
        "simulate", "--out", tmp_path / "locked" / "d", "--seconds", 0.1, "--rig", rig
    )
    assert status == 1
    assert "written" in errors

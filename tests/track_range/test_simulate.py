"""`track-range simulate`: drives and images from the command line, runs on them, and everything that can be wrong."""

import csv
import os

import cv2
import numpy as np
import pytest
import yaml

from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_rig
from track_range.video.reader import VideoReader

FILES = {"left.mp4", "right.mp4", "rig.yaml", "truth.txt", "truth.csv", "ego_speed.csv", "detections.txt"}


def rig_file(path, *, width_px=310, height_px=94, baseline_m=0.54, distortion=(), turn=None):
    camera = PinholeCamera(180.0, 180.0, 152.0, 43.0, width_px, height_px, distortion)
    motion = np.eye(4)
    motion[0, 3] = -baseline_m
    if turn is not None:
        motion[:3, :3] = cv2.Rodrigues(np.array(turn))[0]
    save_rig(StereoRig(camera, camera, motion), path)
    return path


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    return rig_file(tmp_path_factory.mktemp("rig") / "rig.yaml")


def test_a_drive_is_written_and_can_be_run_on(cli, rig, tmp_path):
    drive = tmp_path / "drive"
    status, printed, complaint = cli("simulate", "--out", drive, "--seconds", 0.3, "--rig", rig, "--seed", 3)
    assert status == 0, complaint
    assert {path.name for path in drive.iterdir()} == FILES
    assert f"--stereo {drive / 'left.mp4'} {drive / 'right.mp4'} --rig {drive / 'rig.yaml'}" in printed
    with (drive / "truth.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["frame"] for row in rows} == {"0", "1", "2"}
    assert {row["class"] for row in rows} >= {"car", "person"}
    arguments = ["--stereo", drive / "left.mp4", drive / "right.mp4", "--rig", drive / "rig.yaml", "--no-sgbm"]
    assert f"--truth {drive / 'truth.csv'}" in printed
    inputs = ["--truth", drive / "truth.csv", "--detections", drive / "detections.txt"]
    status, _, complaint = cli(*arguments, *inputs, "--ego-speed", drive / "ego_speed.csv", "--out", tmp_path / "run")
    assert status == 0, complaint
    assert (tmp_path / "run" / "tracks.csv").stat().st_size > 100


def test_the_same_seed_gives_the_same_truth_and_another_another(cli, rig, tmp_path):
    texts = []
    for name, seed in (("a", 7), ("b", 7), ("c", 8)):
        arguments = ["--scenario", "queue", "--seconds", 0.1, "--rig", rig, "--seed", seed]
        assert cli("simulate", "--out", tmp_path / name, *arguments)[0] == 0
        texts.append([(tmp_path / name / file).read_bytes() for file in sorted(FILES)])
    assert texts[0] == texts[1]
    assert texts[0] != texts[2]


def test_faults_reach_the_files(cli, rig, tmp_path):
    plain, faulty = tmp_path / "plain", tmp_path / "faulty"
    assert cli("simulate", "--out", plain, "--seconds", 0.2, "--rig", rig, "--noise", 0)[0] == 0
    faults = ["--gain", 1.3, "--rain", 0.2, "--blur", 1, "--row-offset", 2, "--disparity-offset", 1, "--late", -0.05]
    more = ["--noise", 6, "--wrong-rig", "baseline", "--drop-frames", 0]
    status, _, complaint = cli("simulate", "--out", faulty, "--seconds", 0.2, "--rig", rig, *faults, *more)
    assert status == 0, complaint
    means = [next(iter(VideoReader(folder / "right.mp4"))).image.mean() for folder in (plain, faulty)]
    assert 1.15 < means[1] / means[0] < 1.4
    baselines = [
        yaml.safe_load((folder / "rig.yaml").read_text())["right_from_left"]["translation_m"][0]
        for folder in (plain, faulty)
    ]
    assert baselines == pytest.approx([-0.54, -0.567])
    assert (plain / "truth.txt").read_bytes() == (faulty / "truth.txt").read_bytes()


def test_lossless_folders_can_be_run_on(cli, rig, tmp_path):
    arguments = ["--seconds", 0.25, "--fps", 20, "--rig", rig, "--lossless", "--disparity", "--scenario", "town"]
    status, printed, complaint = cli("simulate", "--out", tmp_path, *arguments)
    assert status == 0, complaint
    assert printed.rstrip().endswith("--folder-fps 20")
    assert len(list((tmp_path / "left").iterdir())) == len(list((tmp_path / "disp_occ_0").iterdir())) == 5


def test_an_odd_rig_is_drawn_one_row_and_column_larger(cli, tmp_path):
    rig = rig_file(tmp_path / "odd.yaml", width_px=311, height_px=93)
    status, printed, _ = cli("simulate", "--out", tmp_path / "d", "--seconds", 0.1, "--rig", rig)
    assert status == 0
    assert "Note: 312 x 94 is drawn, as videos need even sizes and odd.yaml has 311 x 93." in printed
    assert yaml.safe_load((tmp_path / "d" / "rig.yaml").read_text())["left"]["width_px"] == 312


def test_kittis_calibration_is_as_good_as_rectified(cli, tmp_path):
    projection = "721.5 0 609.6 {} 0 721.5 172.9 {} 0 0 1 {}"
    calib = tmp_path / "calib.txt"
    calib.write_text(f"P2: {projection.format(44.86, 0.216, 0.003)}\nP3: {projection.format(-339.5, 2.2, 0.003)}\n")
    status, printed, complaint = cli("simulate", "--out", tmp_path / "d", "--seconds", 0.1, "--rig", calib)
    assert status == 0, complaint
    assert "gives no image size; KITTI's 1242 x 375 is taken" in printed
    assert "1242 x 376 is drawn" in printed
    motion = yaml.safe_load((tmp_path / "d" / "rig.yaml").read_text())["right_from_left"]["translation_m"]
    assert motion == pytest.approx([-0.5327, 0, 0], abs=1e-3)


def test_images_to_train_with(cli, tmp_path):
    status, printed, complaint = cli("simulate", "--out", tmp_path / "sim", "--images", 2, "--frames", 1)
    assert status == 0, complaint
    names = sorted(path.name for path in (tmp_path / "sim" / "images").iterdir())
    assert names == ["001000_00.jpg", "001001_00.jpg"]
    assert "Written: 2 images" in printed


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--scenario", "suburb"], "--scenario suburb: no such scenario; there are town, highway, city, cut-in"),
        (["--seconds", 0], "--seconds 0: expected one frame, 0.1 s, to 600 s."),
        (["--seconds", "nan"], "--seconds nan: expected one frame"),
        (["--seconds", 1e9], "--seconds 1e+09: expected one frame"),
        (["--wrong-rig", "wheels"], "--wrong-rig wheels: expected one of baseline, focal, principal."),
        (["--images", 2, "--scenario", "city"], "--images are of towns, without faults"),
        (["--images", 2, "--rain", 0.5], "--images are of towns, without faults"),
    ],
)
def test_what_makes_no_sense_is_wrong_usage(cli, tmp_path, arguments, said):
    status, _, complaint = cli("simulate", "--out", tmp_path / "d", *arguments)
    assert status == 2
    assert said in complaint
    assert not (tmp_path / "d").exists()


@pytest.mark.parametrize(
    ("rig", "said"),
    [
        ({"turn": (0.0, 0.02, 0.0)}, "its cameras are not rectified, and the simulation draws rectified pairs only"),
        ({"distortion": (-0.2, 0.05, 0.0, 0.0)}, "its cameras are not rectified"),
    ],
)
def test_rigs_that_cannot_be_drawn(cli, tmp_path, rig, said):
    file = rig_file(tmp_path / "rig.yaml", **rig)
    status, _, complaint = cli("simulate", "--out", tmp_path / "d", "--seconds", 0.1, "--rig", file)
    assert status == 1
    assert said in complaint


def test_eyes_that_are_swapped(cli, rig, tmp_path):
    (tmp_path / "rig.yaml").write_text(rig.read_text().replace("-0.54", "0.54"))
    status, _, complaint = cli("simulate", "--out", tmp_path / "d", "--seconds", 0.1, "--rig", tmp_path / "rig.yaml")
    assert status == 1
    assert "swap left and right" in complaint


def test_a_rig_file_of_one_camera_or_none(cli, rig, tmp_path):
    mono = tmp_path / "mono.yaml"
    mono.write_text(yaml.safe_dump({k: v for k, v in yaml.safe_load(rig.read_text()).items() if "right" not in k}))
    for file, said in (
        (mono, "holds one camera only; a drive needs two cameras"),
        (tmp_path / "none.yaml", "none.yaml"),
    ):
        status, _, complaint = cli("simulate", "--out", tmp_path / "d", "--seconds", 0.1, "--rig", file)
        assert status == 1
        assert said in complaint


def test_a_folder_that_cannot_be_written(cli, rig, tmp_path):
    (tmp_path / "file").write_text("in the way")
    status, _, complaint = cli("simulate", "--out", tmp_path / "file" / "d", "--seconds", 0.1, "--rig", rig)
    assert status == 1
    assert "no results can be written there" in complaint


@pytest.mark.skipif(os.name != "posix" or os.geteuid() == 0, reason="root may write anywhere")
def test_a_folder_without_permission(cli, rig, tmp_path):
    (tmp_path / "locked").mkdir(mode=0o500)
    status, _, complaint = cli("simulate", "--out", tmp_path / "locked" / "d", "--seconds", 0.1, "--rig", rig)
    assert status == 1
    assert "no results can be written there" in complaint

"""`rig convert` and `rig show` through the command line."""

from __future__ import annotations

import pytest

from tests.stereo.board_scenes import CAMERA, rig
from track_range.stereo.rig_formats.reading import load_calibration, load_rig
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig

KITTI = "P0: 700 0 600 0 0 700 180 0 0 0 1 0\nP1: 700 0 600 -350 0 700 180 0 0 0 1 0\n"


def test_ours_to_opencv_and_back(tmp_path, cli):
    true = rig()
    ours, theirs, again = (tmp_path / name for name in ("rig.yaml", "cv.yml", "again.yaml"))
    save_rig(true, ours)
    assert cli("rig", "convert", ours, theirs, "--to", "opencv")[0] == 0
    status, told, _ = cli("rig", "convert", theirs, again)
    assert status == 0
    assert "two cameras" in told
    assert "chessboard's squares" in told
    found, _ = load_rig(again, size_px=(640, 360))
    assert (found.left, found.right) == (true.left, true.right)
    assert found.right_from_left == pytest.approx(true.right_from_left, abs=1e-12)


def test_one_camera(tmp_path, cli):
    save_camera(CAMERA, tmp_path / "a.yaml")
    assert "one camera" in cli("rig", "convert", tmp_path / "a.yaml", tmp_path / "b.yml", "--to", "opencv")[1]
    assert cli("rig", "convert", tmp_path / "b.yml", tmp_path / "c.yaml")[0] == 0
    assert load_calibration(tmp_path / "c.yaml")[0] == CAMERA
    status, told, _ = cli("rig", "show", tmp_path / "a.yaml")
    assert status == 0
    # 640 px at 520 px: atan(315.5 / 520) + atan(324.5 / 520)
    assert "63.2" in told
    assert "lens terms -0.12, 0.05, 0.001, -0.0005, 0" in told


def test_kitti_lacks_a_size(tmp_path, cli):
    calib = tmp_path / "calib.txt"
    calib.write_text(KITTI)
    status, _, complaint = cli("rig", "convert", calib, tmp_path / "rig.yaml")
    assert (status, "add --size WIDTHxHEIGHT" in complaint) == (1, True)
    status, told, _ = cli("rig", "convert", calib, tmp_path / "rig.yaml", "--size", "1242x375")
    assert (status, "labels" in told) == (0, False)
    assert load_rig(tmp_path / "rig.yaml", size_px=(1242, 375))[0].baseline_m == pytest.approx(0.5)


def test_that_kitti_labels_are_beside_its_colour_pair_is_told(tmp_path, cli):
    calib = tmp_path / "calib.txt"
    colour = KITTI.replace("P0", "P2").replace("600 0 0", "600 42 0").replace("P1", "P3")
    calib.write_text(KITTI + colour)
    status, told, complaint = cli("rig", "convert", calib, tmp_path / "rig.yaml", "--size", "1242x375")
    assert status == 0, complaint
    assert "KITTI's labels are given 0.060 m beside the left camera" in told  # 42 / 700


def test_what_a_rig_means(tmp_path, cli):
    calib = tmp_path / "calib.txt"
    calib.write_text(KITTI)
    for size in ((), ("--size", "1242x375")):
        status, told, _ = cli("rig", "show", calib, *size)
        assert status == 0
        assert "baseline 0.5000 m" in told
        assert "pitch 0.000, yaw 0.000, roll 0.000 degrees; rectified already" in told
        # f B / z = 700 * 0.5 / 10 = 35 px, 10 / 35 = 0.29 m per px; at 60 m 5.83 px, 10.29 m
        assert "35.00" in told
        assert "10.29" in told
    assert "cameras 0 and 1 used" in told


def test_a_turned_rig(tmp_path, cli):
    save_rig(rig(), tmp_path / "rig.yaml")
    status, told, _ = cli("rig", "show", tmp_path / "rig.yaml")
    assert status == 0
    assert "yaw -1.14" in told  # 0.02 rad
    assert "to be rectified" in told
    assert "60 m" in told


def test_wrong_usage(tmp_path, cli):
    (tmp_path / "a.yaml").write_text("x: 1\n")
    save_camera(CAMERA, tmp_path / "b.yaml")
    for arguments, status, said in (
        (("convert", tmp_path / "b.yaml", tmp_path / "b.yaml"), 2, "it is the file to convert"),
        (("convert", tmp_path / "b.yaml", tmp_path / "c.yaml", "--size", "12"), 2, "write it as WIDTHxHEIGHT"),
        (("show", tmp_path / "b.yaml", "--size", "0x3"), 2, "write it as WIDTHxHEIGHT"),
        (("show", tmp_path / "b.yaml", "--size", "64000x36000"), 2, "20000 px a side at most"),
        (("convert", tmp_path / "b.yaml", "."), 1, "it is a folder; name a file to write"),
        (("show", tmp_path / "a.yaml"), 1, "not a rig"),
        (("convert", tmp_path / "b.yaml", tmp_path / "c.yaml", "--to", "kitti"), 2, "ours, opencv"),
        (("show", tmp_path / "none.yaml"), 1, "no such file"),
        (("convert", tmp_path / "b.yaml", tmp_path / "none" / "c.yaml"), 1, "cannot be written"),
    ):
        found, _, complaint = cli("rig", *arguments)
        assert (found, said in complaint) == (status, True), complaint

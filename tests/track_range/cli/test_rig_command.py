"""`rig convert` and `rig show` through the command line."""

from __future__ import annotations

import pytest

from tests.support.images.board_scenes import CAMERA, rig
from tests.support.recordings.device_calibrations import ZED
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.reading import load_calibration, load_rig
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig

KITTI = "P0: 700 0 600 0 0 700 180 0 0 0 1 0\nP1: 700 0 600 -350 0 700 180 0 0 0 1 0\n"


def test_rig_yaml_to_opencv_and_back(tmp_path, cli):
    true = rig()
    yaml_file, opencv_file, second_yaml = (
        tmp_path / name for name in ("rig.yaml", "cv.yml", "again.yaml")
    )
    save_rig(true, yaml_file)
    assert cli("rig", "convert", yaml_file, opencv_file, "--to", "opencv")[0] == 0
    status, printed, _ = cli("rig", "convert", opencv_file, second_yaml)
    assert status == 0
    assert "two cameras" in printed
    assert "metres" in printed
    read, _ = load_rig(second_yaml, size_px=(640, 360))
    assert (read.left, read.right) == (true.left, true.right)
    assert read.right_from_left == pytest.approx(true.right_from_left, abs=1e-12)


def test_one_camera(tmp_path, cli):
    save_camera(CAMERA, tmp_path / "a.yaml")
    assert (
        "one camera"
        in cli("rig", "convert", tmp_path / "a.yaml", tmp_path / "b.yml", "--to", "opencv")[1]
    )
    assert cli("rig", "convert", tmp_path / "b.yml", tmp_path / "c.yaml")[0] == 0
    assert load_calibration(tmp_path / "c.yaml")[0] == CAMERA
    status, printed, _ = cli("rig", "show", tmp_path / "a.yaml")
    assert status == 0
    # 640 px at 520 px: atan(315.5 / 520) + atan(324.5 / 520)
    assert "63.2" in printed
    assert "-0.12, 0.05, 0.001, -0.0005, 0" in printed


def test_the_mounting_is_shown_as_it_is_given(tmp_path, cli):
    path = tmp_path / "a.yaml"
    save_camera(CAMERA, path)
    assert "--mount" not in cli("rig", "show", path)[1]
    save_camera(CAMERA, path, mounting=Mounting(yaw_deg=-58.0, z_m=1.5))
    assert "yaw=-58.0,pitch=0.0,roll=0.0,x=0.0,y=0.0,z=1.5,sigma=2.0" in cli("rig", "show", path)[1]


def test_kitti_lacks_a_size(tmp_path, cli):
    calib = tmp_path / "calib.txt"
    calib.write_text(KITTI)
    status, _, complaint = cli("rig", "convert", calib, tmp_path / "rig.yaml")
    assert (status, "--size WIDTHxHEIGHT" in complaint) == (1, True)
    status, printed, _ = cli("rig", "convert", calib, tmp_path / "rig.yaml", "--size", "1242x375")
    assert (status, "labels" in printed) == (0, False)
    assert load_rig(tmp_path / "rig.yaml", size_px=(1242, 375))[0].baseline_m == pytest.approx(0.5)


def test_reference_frame_of_kitti_labels(tmp_path, cli):
    calib = tmp_path / "calib.txt"
    colour = KITTI.replace("P0", "P2").replace("600 0 0", "600 42 0").replace("P1", "P3")
    calib.write_text(KITTI + colour)
    status, printed, complaint = cli(
        "rig", "convert", calib, tmp_path / "rig.yaml", "--size", "1242x375"
    )
    assert status == 0, complaint
    assert "0.060 m" in printed  # 42 / 700


def test_show_a_rig(tmp_path, cli):
    calib = tmp_path / "calib.txt"
    calib.write_text(KITTI)
    for size in ((), ("--size", "1242x375")):
        status, printed, _ = cli("rig", "show", calib, *size)
        assert status == 0
        assert "baseline 0.5000 m" in printed
        assert "pitch 0.000, yaw 0.000, roll 0.000 degrees; already rectified" in printed
        # f B / z = 700 * 0.5 / 10 = 35 px, 10 / 35 = 0.29 m per px; at 60 m 5.83 px, 10.29 m
        assert "35.00" in printed
        assert "10.29" in printed
    assert "cameras, 0 and 1," in printed


def test_show_a_rotated_rig(tmp_path, cli):
    save_rig(rig(), tmp_path / "rig.yaml")
    status, printed, _ = cli("rig", "show", tmp_path / "rig.yaml")
    assert status == 0
    assert "yaw -1.14" in printed  # 0.02 rad
    assert "not rectified" in printed
    assert "60 m" in printed


def test_wrong_usage(tmp_path, cli):
    (tmp_path / "a.yaml").write_text("x: 1\n")
    save_camera(CAMERA, tmp_path / "b.yaml")
    for arguments, status, message in (
        (("convert", tmp_path / "b.yaml", tmp_path / "b.yaml"), 2, "b.yaml: "),
        (("convert", tmp_path / "b.yaml", tmp_path / "c.yaml", "--size", "12"), 2, "WIDTHxHEIGHT"),
        (("show", tmp_path / "b.yaml", "--size", "0x3"), 2, "WIDTHxHEIGHT"),
        (("show", tmp_path / "b.yaml", "--size", "64000x36000"), 2, "20000 px"),
        (("convert", tmp_path / "b.yaml", "."), 1, "folder"),
        (("show", tmp_path / "a.yaml"), 1, "a.yaml: "),
        (("convert", tmp_path / "b.yaml", "c.yaml", "--to", "kitti"), 2, "'ours', 'opencv'"),
        (("show", tmp_path / "none.yaml"), 1, "no such file"),
        (("convert", tmp_path / "b.yaml", tmp_path / "none" / "c.yaml"), 1, "cannot be written"),
    ):
        actual_status, _, complaint = cli("rig", *arguments)
        assert (actual_status, message in complaint) == (status, True), complaint


def test_sections_units_and_recognition_are_shown(tmp_path, cli):
    zed = tmp_path / "SN1.conf"
    zed.write_text(ZED)
    status, printed, _ = cli("rig", "show", zed)
    assert (status, "672x376 px" in printed, "1280" in printed) == (0, True, True)
    assert "Recognised: ZED's SN*.conf; lengths in the file: millimetres." in printed
    assert "672x376 px (" not in cli("rig", "show", zed, "--size", "1280x720")[1]
    assert "baseline 1.2000 m" in cli("rig", "show", zed, "--unit", "cm")[1]
    status, _, complaint = cli("rig", "show", zed, "--unit", "ft")
    assert (status, "--unit ft" in complaint) == (2, True)
    assert cli("rig", "convert", zed, tmp_path / "rig.yaml", "--size", "672x376")[0] == 0
    assert load_rig(tmp_path / "rig.yaml", size_px=(672, 376))[0].right.fx_px == 351


def test_template(tmp_path, cli):
    source, out = tmp_path / "stereo.json", tmp_path / "rig.yaml"
    source.write_text(
        '{"K1": [[500, 0, 320], [0, 501, 240], [0, 0, 1]], "D1": [0.1, 0, 0, 0], '
        '"T": [-0.12, 0, 0]}'
    )
    status, printed, _ = cli("rig", "template", source)
    assert (status, "fx_px: 500.0" in printed, "no M2, D2, R" in printed) == (0, True, True)
    status, printed, _ = cli("rig", "template", source, "--out", out)
    assert (status, "11 blanks" in printed) == (0, True)
    with pytest.raises(RigError, match=r"left\.width_px"):
        load_calibration(out)
    source.write_text('{"image_size": [480, 640], ' + source.read_text()[1:])  # rows and columns
    assert "width_px: 640\n  height_px: 480" in cli("rig", "template", source)[1]
    source.write_text(KITTI)
    assert cli("rig", "template", source, "--out", out)[0] == 0
    text = out.read_text()
    assert text.count(":  #") == 5  # two sizes, and the heading
    out.write_text(
        text.replace("width_px:  #", "width_px: 1242  #").replace(
            "height_px:  #", "height_px: 375  #"
        )
    )
    assert load_rig(out, size_px=(1242, 375))[0].baseline_m == pytest.approx(0.5)
    assert cli("rig", "template", tmp_path / "absent.yml")[0] == 1

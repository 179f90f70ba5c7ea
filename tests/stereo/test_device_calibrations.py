"""Calibrations of devices, data sets and SLAM programs, with values by hand; and those of other
people."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.support.recordings.device_calibrations import (
    BODY_FROM,
    EXTRINSIC,
    MIDDLEBURY,
    REALSENSE,
    RIGHT_FROM_LEFT,
    ZED,
    euroc_camera,
    focal,
    oak,
    orb,
    ost,
    vins_camera,
)
from track_range.foundation.files.structured_text import yaml_text
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import load_calibration, load_rig


def test_zed(tmp_path):
    path = tmp_path / "SN123.conf"
    path.write_text(ZED)
    rig, notes = load_rig(path, size_px=(1280, 720))
    assert (rig.left.fx_px, rig.left.cy_px, rig.right.fy_px) == (700, 360, 703)
    assert rig.left.distortion == (-0.17, 0.02, 0.001, -0.002, 0.003)
    assert rig.right_from_left[:3, 3] == pytest.approx([-0.12, -0.0005, 0.00025])
    assert rig.right_from_left[:3, :3] == pytest.approx(
        cv2.Rodrigues(np.array([0.002, 0.01, -0.003]))[0]
    )
    assert "millimetres" in notes[0]
    assert load_rig(path, size_px=(672, 376))[0].right.fx_px == 351
    # resized from 1280x720, the next larger one
    assert load_rig(path, size_px=(640, 360))[0].left.fx_px == 350
    assert load_calibration(path)[0].left.size_px == (1280, 720)
    path.write_text(ZED.replace("fx=700", "fx=x"))
    with pytest.raises(RigError, match="LEFT_CAM_HD"):
        load_calibration(path)


def test_oak(tmp_path):
    path = tmp_path / "calib.json"
    path.write_text(
        json.dumps(oak(stereoRectificationData={"leftCameraSocket": 1, "rightCameraSocket": 2}))
    )
    rig, notes = load_rig(path, size_px=(1280, 800))
    assert (rig.left.fx_px, rig.right.fx_px, len(rig.left.distortion)) == (800, 810, 14)
    # -3.75 - 3.75 cm by way of the colour camera
    assert rig.right_from_left[:3, 3] == pytest.approx([-0.075, 0, 0])
    assert "0.0750 m from its calibrated" in notes[0]
    assert "0.09 m" in notes[0]
    rig, notes = load_rig(path, size_px=(640, 360))
    # 40 of 800 rows, then half the size
    assert (rig.left.fx_px, rig.left.cy_px) == (400, (400 - 40 + 0.5) / 2 - 0.5)
    assert any("lack rows" in note for note in notes)
    content = oak()
    content["cameraData"][0][1]["cameraType"] = 1
    path.write_text(json.dumps(content))
    assert load_calibration(path)[0].left.lens == "kannala-brandt"
    path.write_text(json.dumps(oak(cameraData=oak()["cameraData"][1:])))
    with pytest.raises(RigError, match="calibrations of the sockets 2, 0"):
        load_calibration(path)
    content["cameraData"][0][1]["extrinsics"]["toCameraSocket"] = -1
    path.write_text(json.dumps(content))
    with pytest.raises(RigError, match="extrinsics"):
        load_calibration(path)


def test_realsense(tmp_path):
    path = tmp_path / "rs.txt"
    path.write_text(REALSENSE + EXTRINSIC)
    rig, notes = load_rig(path, size_px=(1280, 720))
    assert rig.is_rectified
    assert (rig.left.fx_px, rig.left.cx_px) == (640.25, 641)
    assert rig.baseline_m == pytest.approx(0.049958598)
    assert "848x480, 1280x720" in notes[0]
    assert load_rig(path, size_px=(848, 480))[0].left.fx_px == 425.5
    path.write_text(REALSENSE)
    with pytest.raises(RigError, match="rs-enumerate-devices -c"):
        load_rig(path, size_px=(848, 480))
    with pytest.raises(RigError, match=r"--camera.*Depth, Infrared 1, Infrared 2"):
        load_calibration(path)


def test_realsense_json_uses_the_extrinsics_between_the_infrared_cameras(tmp_path):
    def intrinsics(focal_px: float) -> dict[str, Any]:
        return {
            "width": 848,
            "height": 480,
            "fx": focal_px,
            "fy": focal_px,
            "ppx": 424.5,
            "ppy": 240.0,
            "coeffs": [0.0] * 5,
        }

    def motion(x_m: float) -> dict[str, Any]:
        return {"rotation": np.eye(3).ravel().tolist(), "translation": [x_m, 0.0, 0.0]}

    content = {
        "color": intrinsics(600.0),
        "infrared1": intrinsics(425.0),
        "infrared2": intrinsics(426.0),
        "extrinsics": {"depth_to_color": motion(0.015), "infrared2_to_infrared1": motion(0.05)},
    }
    (tmp_path / "rs.json").write_text(json.dumps(content))
    rig, _ = load_calibration(tmp_path / "rs.json")
    assert (rig.left.fx_px, rig.right.fx_px, rig.left.size_px) == (425, 426, (848, 480))
    assert rig.right_from_left[0, 3] == pytest.approx(-0.05)


def check_body(rig: object) -> None:
    assert isinstance(rig, StereoRig)
    assert rig.right_from_left == pytest.approx(RIGHT_FROM_LEFT, abs=1e-12)
    assert (rig.left.fx_px, rig.right.fx_px) == (458, 459)
    assert rig.left.size_px == (752, 480)


@pytest.mark.parametrize(
    "names", [("mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml"), ("LeftCam.yaml", "RightCam.yaml")]
)
def test_euroc(tmp_path, names):
    for number, name in enumerate(names):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(yaml_text(euroc_camera(number)))
    for name in (*names, "mav0" if "/" in names[0] else ".", "."):
        check_body(load_calibration(tmp_path / name)[0])
    (tmp_path / names[1]).unlink()
    with pytest.raises(RigError, match=r"cam1/sensor\.yaml"):
        load_rig(tmp_path / names[0], size_px=(752, 480))


@pytest.mark.parametrize("model", ["PINHOLE", "MEI", "KANNALA_BRANDT"])
def test_vins(tmp_path, model):
    lines = [
        "%YAML:1.0",
        "",
        "num_of_cam: 2",
        'cam0_calib: "a.yaml"',
        'cam1_calib: "b.yaml"',
        "estimate_extrinsic: 1",
    ]
    for number in "01":
        data = ", ".join(f"{value!r}" for value in BODY_FROM[number].ravel().tolist())
        lines += [
            f"body_T_cam{number}: !!opencv-matrix",
            "   rows: 4",
            "   cols: 4",
            "   dt: d",
            f"   data: [{data}]",
        ]
    (tmp_path / "config.yaml").write_text("\n".join(lines) + "\n")
    for number, name in enumerate(("a.yaml", "b.yaml")):
        (tmp_path / name).write_text(vins_camera(number, model))
    for name in ("config.yaml", "a.yaml", "b.yaml"):
        rig, notes = load_calibration(tmp_path / name)
        check_body(rig)
        assert (
            rig.left.lens
            == {"PINHOLE": "pinhole", "MEI": "omni", "KANNALA_BRANDT": "kannala-brandt"}[model]
        )
        assert "initial guess" in notes[0]


SIZE = ["Camera.width: 752", "Camera.height: 480"]
TRANSFORM = (
    "Stereo.T_c1_c2: !!opencv-matrix\n   rows: 4\n   cols: 4\n   dt: d\n   data:["
    + ", ".join(map(repr, np.linalg.inv(RIGHT_FROM_LEFT).ravel().tolist()))
)


def test_orb_slam(tmp_path):
    path = tmp_path / "settings.yaml"
    path.write_text(orb(*focal("Camera", 718.856), "Camera.k1: 0.0", "Camera.bf: 386.1448"))
    rig, notes = load_calibration(path)
    assert rig.baseline_m == pytest.approx(386.1448 / 718.856)
    assert "metres" in notes[0]
    path.write_text(orb(*focal("Camera1", 718.856), *SIZE, "Stereo.b: 0.53716"))
    rig, _ = load_calibration(path)
    assert (rig.baseline_m, rig.left.size_px, rig.is_rectified) == (
        pytest.approx(0.53716),
        (752, 480),
        True,
    )
    distorted = [
        f"Camera{n}.{key}: {value}"
        for n in "12"
        for key, value in (("k1", -0.2), ("k2", 0.02), ("p1", 0), ("p2", 0))
    ]
    path.write_text(
        orb(*focal("Camera1", 458), *focal("Camera2", 459), *distorted, *SIZE, TRANSFORM + "]")
    )
    check_body(load_calibration(path)[0])
    fisheye = [f"Camera{n}.k{k}: 0.001" for n in "12" for k in "1234"]
    kind = 'Camera.type: "KannalaBrandt8"'
    path.write_text(
        orb(kind, *focal("Camera1", 458), *focal("Camera2", 459), *fisheye, *SIZE, TRANSFORM + "]")
    )
    rig, _ = load_calibration(path)
    check_body(rig)
    assert rig.left.lens == "kannala-brandt"
    path.write_text(
        orb(*focal("Camera", 517), "Camera.k1: 0.26", "Camera.bf: 40.0", "DepthMapFactor: 5000.0")
    )
    assert not isinstance(load_calibration(path)[0], StereoRig)  # a depth camera


def test_middlebury(tmp_path):
    path = tmp_path / "calib.txt"
    path.write_text(MIDDLEBURY)
    rig, notes = load_rig(path, size_px=(1920, 1080))
    assert (rig.left.cx_px, rig.right.cx_px) == (953.34, 963.34)
    assert rig.baseline_m == pytest.approx(0.11153)
    assert "millimetres" in notes[0]


def test_cityscapes(tmp_path):
    content = {
        "extrinsic": {"baseline": 0.21, "x": 1.7},
        "intrinsic": {"fx": 2262.5, "fy": 2265.3, "u0": 1096.98, "v0": 513.1},
    }
    (tmp_path / "camera.json").write_text(json.dumps(content))
    rig, notes = load_rig(tmp_path / "camera.json", size_px=(1024, 512))
    assert rig.left.fx_px == pytest.approx(1131.25)
    assert rig.baseline_m == pytest.approx(0.21)
    assert any("2048x1024" in note for note in notes)


def test_files_of_numbers(tmp_path):
    (tmp_path / "K.txt").write_text("754.5 0.0 489.25 0.0 754.5 265.125 0.0 0.0 1.0\n0.063\n")
    rig, _ = load_calibration(tmp_path / "K.txt")
    assert (rig.left.fx_px, rig.left.cy_px, rig.baseline_m) == (754.5, 265.125, 0.063)
    (tmp_path / "intrinsic.txt").write_text(
        "frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]\n0 0 725.0087 725.0087 620.5 187\n"
    )
    rig, notes = load_calibration(tmp_path / "intrinsic.txt")
    assert (rig.left.fx_px, rig.baseline_m, rig.left.size_px) == (725.0087, 0.532725, (1242, 375))
    assert any("assumed" in note for note in notes)


def test_other_numbers_of_cameras(tmp_path):
    (tmp_path / "calib.txt").write_text(
        "S_rect_101: 1762 800\nP_rect_101: 2000 0 880 0 0 2000 400 0 0 0 1 0\n"
        "S_rect_103: 1762 800\nP_rect_103: 2000 0 880 -1080 0 2000 400 0 0 0 1 0\n"
    )
    rig, _ = load_rig(tmp_path / "calib.txt", size_px=(881, 400))
    assert (rig.left.fx_px, rig.baseline_m) == (pytest.approx(1000), pytest.approx(0.54))


def test_ost(tmp_path):
    path = tmp_path / "ost.txt"
    path.write_text(ost(-108.0, ("narrow_stereo/left", "narrow_stereo/right")))
    rig, _ = load_rig(path, size_px=(1280, 720))
    assert rig.baseline_m == pytest.approx(0.12)
    assert rig.left.distortion == (-0.1, 0.01, 0.0, 0.0, 0.0)
    path.write_text(ost(0.0, ("narrow_stereo",)))
    assert load_calibration(path)[0].size_px == (1280, 720)
    path.write_text(
        ost(-384.0, ("a", "b")).replace("640.0 0.0\n0.0 900.0", "640.0 -384.0\n0.0 900.0")
    )
    with pytest.raises(RigError, match="-384 in both"):
        load_rig(path, size_px=(1280, 720))


SHARED = (  # file, baseline in metres (None = refused), a word of the notes or of the message
    ("oak/oak_d_pro_eeprom.json", 0.09356, "0.075"),
    ("zed/SN_zedmini.conf", 0.0629661, "millimetres"),
    ("euroc/mav0/cam0/sensor.yaml", 0.110078, "metres"),
    ("euroc/mav0", 0.110078, "metres"),
    ("kimera/Euroc/RightCameraParams.yaml", 0.110078, "metres"),
    ("orb2/EuRoC.yaml", 0.110078, "metres"),
    ("orb3/KITTI00-02.yaml", 0.53716, "metres"),
    ("vins/euroc/euroc_stereo_imu_config.yaml", 0.110078, "metres"),
    ("vins/euroc/cam1_pinhole.yaml", 0.110078, "metres"),
    ("vins/realsense_d435i/left.yaml", 0.060859, "initial guess"),
    ("cityscapes/camera.json", 0.209313, "2048x1024"),
    ("middlebury/calib.txt", 0.193001, "millimetres"),
    ("matlab/stereoParams.mat", 0.475149, "millimetres"),
    ("kitti_more/drivingstereo.txt", 0.540025, "1762x800"),
    ("kitti_more/perspective.txt", 0.594184, "1408x376"),
    ("kitti_more/vkitti_intrinsic.txt", 0.532725, "assumed"),
    ("npz/K.txt", 0.063, "FoundationStereo"),
    ("npz/tutorial.npz", 0.100556, "metres"),
    ("npz/multicam_calibration.json", 0.079038, "millimetres"),
    ("json_adrienne/stereo_calibration.json", 0.367786, "camera 2 is to the left"),
    ("opencv_thaytan/extrinsics.yml", 0.059837, "millimetres"),
    ("opencv_thaytan", 0.059837, "millimetres"),
    ("opencv_speedbump/intrinsics.yml", 0.102339, "millimetres"),
    *((f"opencv_more/{name}", 0.100556, "metres") for name in (
        "K_D4_pinhole.yml", "P_only.yml", "T_row.yml", "cm.yml", "d14.yml", "names_K_D.yml", "names_cameraMatrix.yml",
        "names_left_right.yml", "rvec.yml", "stereo.json", "stereo.xml",
    )),
    ("opencv_more/squares.yml", None, "--unit"),
    ("opencv_more/cm_zedmini.yml", None, "--unit"),
    ("opencv_more/imagelist.xml", None, "list images"),
    ("opencv_more/maps.xml", None, "remap tables"),
    ("npz/calib.pkl", None, "pickle"),
    ("npz/printed.txt", None, "no M2, D2"),
    ("npz/stereo_calibration.npz", None, "behind the other"),
)  # fmt: skip


@pytest.mark.real
@pytest.mark.parametrize(("name", "baseline_m", "word"), SHARED)
def test_calibrations_of_other_people(
    shared_data: Path, name: str, baseline_m: float | None, word: str
) -> None:
    path = shared_data / "calibrations" / name
    if baseline_m is None:
        with pytest.raises(RigError, match=word):
            load_calibration(path)
        return
    rig, notes = load_calibration(path)
    assert isinstance(rig, StereoRig)
    assert rig.baseline_m == pytest.approx(baseline_m, abs=1e-6)
    assert any(word in note for note in notes)

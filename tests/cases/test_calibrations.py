"""Calibrations that people own, each with what is right: the values of the camera or pair, or the words of
the refusal that says what to choose or to do."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.support.error_messages import error_message
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.reading import load_camera, load_rig


@dataclass(frozen=True, kw_only=True)
class One:
    """A file of the shared folder, and one camera of it."""

    file: str
    matrix: tuple[float, float, float, float]  # fx, fy, cx, cy in pixels
    distortion: tuple[float, ...]
    lens: str = "pinhole"
    size_px: tuple[int, int] = (1920, 1080)
    camera: Sequence[str] = ()  # as for --camera
    note: str = ""


K3 = (-0.34531, 0.1422, -0.000944, 0.00352, -0.00494)
ONES = (
    One(
        file="lens_flag_distortion_type/calib.json",
        matrix=(464.26, 463.02, 372.26, 235.05),
        distortion=(0.00384, 0.02507, -0.05228, 0.03636),
        lens="kannala-brandt",
        size_px=(752, 480),
    ),
    One(
        file="lens_flag_fisheye_true/calib.json",
        matrix=(721.86, 733.9, 957.38, 547.2),
        distortion=(0.05, -0.02, 0.01, -0.004),
        lens="kannala-brandt",
    ),
    One(
        file="lens_gyroflow_hero7/hero7_wide_1080p.json",
        matrix=(721.86, 733.91, 957.38, 547.23),
        distortion=(0.14634, 0.15525, -0.30899, 0.27135),
        lens="kannala-brandt",
    ),
    One(
        file="many_a2d2_front_only/cams_lidars.json",
        matrix=(1844.18, 1841.52, 964.43, 679.53),
        distortion=(-0.26113, 0.0, 0.0, 0.0, 0.0),
        size_px=(1920, 1208),
        note="CamMatrixOriginal, of the images as recorded",
    ),
    One(
        file="many_three_cameras/camera_intrinsics.json",
        matrix=(873.21, 881.11, 657.39, 341.10),
        distortion=(0.13033, -0.55975, -0.00161, 0.00827, 0.63207),
        size_px=(1280, 720),
        camera=("d435_color",),
    ),
    One(
        file="mono_of_four/camera_intrinsics.json",
        matrix=(680.22, 679.85, 701.35, 424.29),
        distortion=K3,
        size_px=(1280, 800),
        camera=("cam_2",),
    ),
    One(
        file="own_colmap/cameras.txt",
        matrix=(1430.15, 1431.02, 957.8, 541.2),
        distortion=(-0.118, 0.093, 0.0003, 0.0018),
    ),
    One(
        file="own_dair_cam_K/camera_intrinsic.json",
        matrix=(2183.375, 2329.297, 940.59, 567.57),
        distortion=(-0.48283, 0.50101, -0.001, 0.00029, 0.0),
    ),
    One(
        file="own_odm_normalised/cameras.json",
        matrix=(2338.4, 2338.4, 2004.3, 1487.1),
        distortion=(-0.0014, 0.0022, 0.0002, -0.0001, 0.0),
        size_px=(4000, 3000),
    ),
    One(
        file="own_zedx_no_stereo/SN1.conf",
        matrix=(735.327, 735.104, 978.117, 576.618),
        distortion=(-0.01663, -0.02736, 7e-05, 2e-05, 0.00696),
        size_px=(1920, 1200),
    ),
    One(
        file="metashape_2015/camera.xml",
        matrix=(4587.22, 4586.13, 4053.36, 2979.59),
        distortion=(-0.00837, -0.00249, -0.00047, -0.0014, 0.01201),
        size_px=(8176, 6132),
        note="r^8",
    ),
    One(
        file="metashape_gopro/camera.xml",
        matrix=(1430.15, 1430.15, 935.37, 557.05),
        distortion=(-0.11832, 0.29363, 0.00182, 0.00033),
        note="skew of -4.251 px",
    ),
    One(
        file="kitti_dsec/cam_to_cam.yaml",
        matrix=(556.72, 556.57, 342.42, 215.11),
        distortion=(-0.09798, 0.20979, -0.00036, 7e-05),
        size_px=(640, 480),
        note="camera cam0 of cam0, cam1, cam2",
    ),
    One(
        file="json_camera_info_roi/calib_cam_stereo_left.json",
        matrix=(2612.86, 2612.86, 966.525, 508.297),
        distortion=(-0.56757, 0.0, 0.0, 0.0, 0.0),
        size_px=(1920, 1024),
    ),
)


def check(camera: PinholeCamera, matrix: Sequence[float], distortion: Sequence[float]) -> None:
    found = (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px)
    assert found == pytest.approx(matrix, abs=0.01)
    assert camera.distortion == pytest.approx(distortion, abs=1e-5)


@pytest.mark.parametrize("case", ONES, ids=lambda case: case.file.split("/")[0])
def test_one_camera(shared_data: Path, case: One) -> None:
    path = shared_data / "cases" / case.file
    camera, notes = load_camera(path, size_px=case.size_px, cameras=case.camera)
    check(camera, case.matrix, case.distortion)
    assert (camera.lens, camera.size_px) == (case.lens, case.size_px)
    assert case.note in " ".join(notes)


@dataclass(frozen=True, kw_only=True)
class Pair:
    """A file of the shared folder with a pair of cameras."""

    file: str
    size_px: tuple[int, int]
    focal_px: tuple[float, float]  # fx of both
    distortion: tuple[float, ...]  # of the left one
    baseline_m: float
    lens: str = "pinhole"
    camera: Sequence[str] = ()


PAIRS = (
    Pair(
        file="own_stella_kitti/KITTI_stereo_00-02.yaml",
        size_px=(1241, 376),
        focal_px=(718.856, 718.856),
        distortion=(0.0,) * 5,
        baseline_m=0.5372,
    ),
    Pair(
        file="zeros_malaga/camera_params_raw_1024x768.txt",
        size_px=(1024, 768),
        focal_px=(839.162, 836.762),
        distortion=(-0.37476, 0.24685, 0.0, 0.0, -0.12814),
        baseline_m=0.1193,
    ),
    Pair(
        file="zeros_basalt_ds/calibration.json",
        size_px=(752, 480),
        focal_px=(349.756, 361.671),
        distortion=(-0.24096, 0.567),
        baseline_m=0.1102,
        lens="double-sphere",
    ),
    Pair(
        file="kitti_dsec/cam_to_cam.yaml",
        size_px=(1440, 1080),
        focal_px=(1188.247, 1235.569),
        distortion=(-0.42575, 0.18258, 0.00103, -0.00104),
        baseline_m=0.5092,
    ),
    Pair(
        file="json_camera_info_roi/calib_cam_stereo_left.json",
        size_px=(1920, 1024),
        focal_px=(2612.86, 2672.04),
        distortion=(-0.56757, 0.0, 0.0, 0.0, 0.0),
        baseline_m=0.2030,
    ),
)


@pytest.mark.parametrize("case", PAIRS, ids=lambda case: case.file.split("/")[0])
def test_pair(shared_data: Path, case: Pair) -> None:
    rig, _ = load_rig(shared_data / "cases" / case.file, size_px=case.size_px, cameras=case.camera)
    assert (rig.left.fx_px, rig.right.fx_px) == pytest.approx(case.focal_px, abs=0.01)
    assert rig.left.distortion == pytest.approx(case.distortion, abs=1e-5)
    assert (rig.left.lens, rig.right.lens) == (case.lens, case.lens)
    assert rig.baseline_m == pytest.approx(case.baseline_m, abs=1e-4)


@pytest.mark.parametrize(
    ("file", "size_px", "is_pair", "words"),
    [
        (
            "many_three_cameras/camera_intrinsics.json",
            (1280, 720),
            False,
            "NAME of one camera in --camera zed_left, zed_right, d435_color",
        ),
        (
            "many_three_cameras/camera_intrinsics.json",
            (1280, 720),
            True,
            "R and T only the cameras zed_left zed_right",
        ),
        (
            "mono_of_four/camera_intrinsics.json",
            (1280, 800),
            False,
            "NAME of one camera in --camera cam_0, cam_1, cam_2, cam_3",
        ),
        ("mono_of_four/camera_intrinsics.json", (1280, 800), True, "R and T only the cameras"),
        ("kitti_dsec/cam_to_cam.yaml", (1440, 1080), False, "--camera cam0, cam1, cam2"),
        ("own_zedx_no_stereo/SN1.conf", (1920, 1200), True, "section STEREO with Baseline"),
    ],
)
def test_questions(
    shared_data: Path, file: str, size_px: tuple[int, int], is_pair: bool, words: str
) -> None:
    load = load_rig if is_pair else load_camera
    message = error_message(RigError, load, shared_data / "cases" / file, size_px=size_px)
    assert all(word in message for word in words.split()), message

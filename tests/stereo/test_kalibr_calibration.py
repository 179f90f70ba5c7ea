"""Kalibr's camchain: its content, the order of the cameras, and errors in one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from tests.stereo.rig_texts import written
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.reading import load_calibration, load_camera, load_rig

SIZE = (752, 480)
CHAIN = """cam0:
  cam_overlaps: [1]
  camera_model: pinhole
  distortion_coeffs: [-0.28, 0.07, 0.0002, 1.8e-05]
  distortion_model: radtan
  intrinsics: [458.654, 457.296, 367.215, 248.375]
  resolution: [752, 480]
  rostopic: /cam0/image_raw
cam1:
  T_cn_cnm1:
  - [0.99999, 0.0, 0.004472, -0.11]
  - [0.0, 1.0, 0.0, 0.0004]
  - [-0.004472, 0.0, 0.99999, 0.0009]
  - [0.0, 0.0, 0.0, 1.0]
  cam_overlaps: [0]
  camera_model: pinhole
  distortion_coeffs: [-0.29, 0.08, 0.0, 0.0]
  distortion_model: radtan
  intrinsics: [457.587, 456.134, 379.999, 255.238]
  resolution: [752, 480]
  rostopic: /cam1/image_raw
"""


def chain(**changes: Any) -> dict[str, Any]:
    """The chain with replaced values of cam1 (or of cam0 with the prefix cam0_); None removes a
    key."""
    content = yaml.safe_load(CHAIN)
    for key, value in changes.items():
        name, block = (key[5:], "cam0") if key.startswith("cam0_") else (key, "cam1")
        content[block][name] = value
        if value is None:
            del content[block][name]
    return content


def camchain(folder: Path, content: object) -> Path:
    return written(folder, content, "camchain.yaml")


def test_the_pair_of_a_chain(tmp_path):
    rig, notes = load_rig(camchain(tmp_path, CHAIN), size_px=SIZE)
    assert (rig.left.fx_px, rig.left.cy_px, rig.left.distortion) == (
        458.654,
        248.375,
        (-0.28, 0.07, 0.0002, 1.8e-05),
    )
    assert (rig.right.width_px, rig.right.height_px) == SIZE
    assert rig.baseline_m == pytest.approx(0.110004, abs=1e-6)
    assert rig.right_from_left[0, 2] == 0.004472
    assert len(notes) == 1


def test_cameras_are_ordered_from_left_to_right(tmp_path):
    inverse = np.linalg.inv(np.array(yaml.safe_load(CHAIN)["cam1"]["T_cn_cnm1"]))
    rig, notes = load_rig(camchain(tmp_path, chain(T_cn_cnm1=inverse.tolist())), size_px=SIZE)
    assert rig.left.fx_px == 457.587
    assert rig.baseline_m == pytest.approx(0.110004, abs=1e-5)
    assert "used as the left camera" in notes[1]


def test_one_camera_and_three(tmp_path):
    content = chain()
    del content["cam1"]
    path = camchain(tmp_path, content)
    assert load_camera(path, size_px=SIZE)[0].fy_px == 457.296
    assert load_calibration(path)[0] == load_camera(path, size_px=SIZE)[0]
    with pytest.raises(RigError, match="cam1"):
        load_rig(path, size_px=SIZE)
    path = camchain(tmp_path, {**chain(), "cam2": chain()["cam1"]})
    with pytest.raises(RigError, match=r"names LEFT,RIGHT .*cam0, cam1, cam2"):
        load_rig(path, size_px=SIZE)
    rig, _ = load_rig(path, size_px=SIZE, cameras=("cam0", "cam2"))
    assert rig.baseline_m == pytest.approx(0.22, abs=1e-4)
    with pytest.raises(RigError, match=r"NAME of one camera in --camera.*cam0, cam1, cam2"):
        load_camera(path, size_px=SIZE)
    assert load_camera(path, size_px=SIZE, cameras=("cam2",))[0].fx_px == 457.587


def test_no_distortion(tmp_path):
    content = chain(cam0_distortion_model="none", cam0_distortion_coeffs=None)
    assert load_rig(camchain(tmp_path, content), size_px=SIZE)[0].left.distortion == ()


@pytest.mark.parametrize(
    ("content", "key_word"),
    [
        (chain(camera_model="omni"), "omni"),
        (chain(distortion_model="fov"), "fov"),
        (chain(T_cn_cnm1=None), "T_cn_cnm1"),
        (chain(cam0_intrinsics=[1, 2, 3]), "intrinsics"),
        (chain(cam0_intrinsics=[1, 2, 3, "x"]), "intrinsics"),
        (chain(cam0_intrinsics=[1, 2, 3, float("nan")]), "finite"),
        (chain(T_cn_cnm1=[[1, 0], [0, 1]]), "T_cn_cnm1"),
        (chain(resolution=[0, 480]), "image_width"),
        (chain(resolution=[640, 2147483648]), "image_width"),
        (chain(resolution=[640, "high"]), "resolution"),
        (chain(distortion_coeffs=[0.1]), "4, 5, 8, 12 or 14 finite distortion coefficients"),
        (chain(T_cn_cnm1=np.diag([1.0, 1.0, -1.0, 1.0]).tolist()), "rotation"),
        (chain(T_cn_cnm1=[[0, 0, 0, 0.1], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]]), "rotation"),
        (chain(T_cn_cnm1=[*np.eye(4).tolist()[:3], [0, 0, 0, 0]]), "last row"),
        ("cam1: {}\n", "matrix M1 of a camera"),
        ("cam0: [1\n", "YAML"),
    ],
)
def test_wrong_chains(tmp_path, content, key_word):
    path = camchain(tmp_path, content)
    with pytest.raises(RigError) as error:
        load_rig(path, size_px=SIZE)
    assert key_word in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)


WIDE = {
    "kannala-brandt": {
        "camera_model": "pinhole",
        "distortion_model": "equidistant",
        "intrinsics": [230.0, 231.0, 367.0, 248.0],
        "distortion_coeffs": [0.003, 0.0007, -0.002, 0.0002],
    },
    "omni": {
        "camera_model": "omni",
        "distortion_model": "radtan",
        "intrinsics": [1.6, 800.0, 801.0, 367.0, 248.0],
        "distortion_coeffs": [-0.1, 0.03, 0.001, -0.0005],
    },
    "double-sphere": {
        "camera_model": "ds",
        "distortion_model": "none",
        "intrinsics": [-0.2, 0.6, 240.0, 241.0, 367.0, 248.0],
        "distortion_coeffs": [],
    },
}


@pytest.mark.parametrize("lens", list(WIDE))
def test_wide_lenses(tmp_path, lens):
    camera, _ = load_camera(
        camchain(tmp_path, chain(**{f"cam0_{key}": value for key, value in WIDE[lens].items()})),
        size_px=SIZE,
    )
    assert camera.lens == lens
    focal_px, coefficients = WIDE[lens]["intrinsics"][-4:], WIDE[lens]["distortion_coeffs"]
    assert [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px] == focal_px
    assert list(camera.distortion) == [*WIDE[lens]["intrinsics"][:-4], *coefficients]


@pytest.mark.parametrize(
    ("lens", "changes", "key_word"),
    [
        ("omni", {"intrinsics": [800.0, 801.0, 367.0, 248.0]}, "5 coefficients"),
        (
            "double-sphere",
            {"intrinsics": [-0.2, 0.6, 240.0, 241.0, 367.0]},
            "numbers in cam0.intrinsics, found 5",
        ),
        ("double-sphere", {"intrinsics": [-0.2, 9.0, 240.0, 241.0, 367.0, 248.0]}, "double-sphere"),
        ("kannala-brandt", {"distortion_coeffs": [0.1]}, "distortion_coeffs"),
        ("kannala-brandt", {"distortion_coeffs": [0.0, 0.0, -90.0, 0.0]}, "kannala-brandt"),
        ("kannala-brandt", {"intrinsics": [-230.0, 231.0, 367.0, 248.0]}, "positive"),
    ],
)
def test_wrong_wide_lenses(tmp_path, lens, changes, key_word):
    block = WIDE[lens] | changes
    path = camchain(tmp_path, chain(**{f"cam0_{key}": value for key, value in block.items()}))
    with pytest.raises(RigError) as error:
        load_camera(path, size_px=SIZE)
    assert key_word in str(error.value)
    assert str(path) in str(error.value)


@pytest.mark.real
@pytest.mark.parametrize(
    ("name", "size_px", "lens", "baseline_m"),
    [
        ("tum_vi", (512, 512), "kannala-brandt", 0.10109),
        ("euroc_mav", (752, 480), "pinhole", 0.11008),
    ],
)
def test_files_of_openvins(shared_data, name, size_px, lens, baseline_m):
    rig, _ = load_rig(shared_data / "fisheye" / "kalibr" / f"{name}.yaml", size_px=size_px)
    assert (rig.left.lens, rig.right.lens) == (lens, lens)
    assert rig.baseline_m == pytest.approx(baseline_m, abs=1e-5)

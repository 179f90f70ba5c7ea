"""Kalibr's camchain: what it says, which eye is left, and every way to be wrong named in one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

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
    """The chain with values of cam1 (or, with the prefix cam0_, of cam0) replaced; None takes a key out."""
    content = yaml.safe_load(CHAIN)
    for key, value in changes.items():
        name, block = (key[5:], "cam0") if key.startswith("cam0_") else (key, "cam1")
        content[block][name] = value
        if value is None:
            del content[block][name]
    return content


def written(folder: Path, content: object) -> Path:
    path = folder / "camchain.yaml"
    path.write_text(content if isinstance(content, str) else yaml.safe_dump(content), encoding="utf-8")
    return path


def test_the_pair_of_a_chain(tmp_path):
    rig, notes = load_rig(written(tmp_path, CHAIN), size_px=SIZE)
    assert (rig.left.fx_px, rig.left.cy_px, rig.left.distortion) == (458.654, 248.375, (-0.28, 0.07, 0.0002, 1.8e-05))
    assert (rig.right.width_px, rig.right.height_px) == SIZE
    assert rig.baseline_m == pytest.approx(0.110004, abs=1e-6)
    assert rig.right_from_left[0, 2] == 0.004472
    assert notes == ()


def test_the_eye_that_stands_left_is_the_left_one(tmp_path):
    motion = np.linalg.inv(np.array(yaml.safe_load(CHAIN)["cam1"]["T_cn_cnm1"]))
    rig, notes = load_rig(written(tmp_path, chain(T_cn_cnm1=motion.tolist())), size_px=SIZE)
    assert rig.left.fx_px == 457.587
    assert rig.baseline_m == pytest.approx(0.110004, abs=1e-5)
    assert "cam1 stands left of cam0" in notes[0]


def test_one_camera_and_three(tmp_path):
    content = chain()
    del content["cam1"]
    path = written(tmp_path, content)
    assert load_camera(path, size_px=SIZE)[0].fy_px == 457.296
    assert load_calibration(path)[0] == load_camera(path, size_px=SIZE)[0]
    with pytest.raises(RigError, match="it lacks cam1"):
        load_rig(path, size_px=SIZE)
    _, notes = load_rig(written(tmp_path, {**chain(), "cam2": chain()["cam1"]}), size_px=SIZE)
    assert "cam0 and cam1 used, of 3 cameras" in notes[0]


def test_no_distortion(tmp_path):
    content = chain(cam0_distortion_model="none", cam0_distortion_coeffs=None)
    assert load_rig(written(tmp_path, content), size_px=SIZE)[0].left.distortion == ()


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (chain(camera_model="omni"), "cam1: the camera model is 'omni', only pinhole"),
        (chain(cam0_camera_model=None), "cam0: the camera model is 'None', only pinhole"),
        (chain(distortion_model="equidistant"), "cam1: the distortion model is 'equidistant', only radtan"),
        (chain(T_cn_cnm1=None), "cam1: the key 'T_cn_cnm1' is missing"),
        (chain(cam0_intrinsics=[1, 2, 3]), "cam0: 'intrinsics' must be 4 finite numbers"),
        (chain(cam0_intrinsics=[1, 2, 3, "x"]), "cam0: 'intrinsics' is not made of numbers"),
        (chain(cam0_intrinsics=[1, 2, 3, float("nan")]), "must be 4 finite numbers"),
        (chain(T_cn_cnm1=[[1, 0], [0, 1]]), "'T_cn_cnm1' must be 4 x 4 finite numbers"),
        (chain(resolution=[0, 480]), "the resolution is 0x480"),
        (chain(distortion_coeffs=[0.1]), "'distortion_coeffs' must be 4 finite numbers"),
        (chain(T_cn_cnm1=np.diag([1.0, 1.0, -1.0, 1.0]).tolist()), "the rotation of right_from_left is none"),
        (
            chain(T_cn_cnm1=[[0, 0, 0, 0.1], *[[0, 0, 0, 0]] * 2, [0, 0, 0, 1]]),
            "the rotation of right_from_left is none",
        ),
        (chain(T_cn_cnm1=[*np.eye(4).tolist()[:3], [0, 0, 0, 0]]), "the last row of 'T_cn_cnm1' must be 0, 0, 0, 1"),
        ("cam1: {}\n", "it has no block cam0"),
        ("cam0: [1\n", "not readable as YAML"),
    ],
)
def test_wrong_chains(tmp_path, content, said):
    path = written(tmp_path, content)
    with pytest.raises(RigError) as error:
        load_rig(path, size_px=SIZE)
    assert said in str(error.value)
    assert str(path) in str(error.value)
    assert "\n" not in str(error.value)

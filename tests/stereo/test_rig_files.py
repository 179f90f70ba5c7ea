"""rig.yaml, what all formats have in common, and errors in one sentence."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.stereo.rig_texts import SIZE, refused, written
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import check_rig
from track_range.stereo.rig_formats.reading import find_rig, load_camera, load_rig
from track_range.stereo.rig_formats.rig_yaml import save_rig

KITTI = """P0: 700 0 640 0 0 700 360 0 0 0 1 0
P1: 700 0 640 -350 0 700 360 0 0 0 1 0
P2: 1000 0 650 50 0 1000 350 2 0 0 1 0.004
P3: 1000 0 650 -450 0 1000 350 3 0 0 1 0.004
Tr_velo_cam 1 0 0 0 0 1 0 0 0 0 1 0
"""


def rig_content() -> dict[str, Any]:
    camera = {
        "fx_px": 1000.0,
        "fy_px": 1001.0,
        "cx_px": 639.5,
        "cy_px": 359.5,
        "width_px": 1280,
        "height_px": 720,
    }
    identity = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
    return {
        "track_range_rig": 1,
        "left": {**camera, "distortion": [0.1, -0.2, 0.001, 0.002, 0.03]},
        "right": dict(camera),
        "right_from_left": {"rotation": identity, "translation_m": [-0.5, 0, 0]},
    }


def test_rig_yaml(tmp_path: Path) -> None:
    rig, notes = load_rig(written(tmp_path, rig_content()), size_px=SIZE)
    assert rig.left == PinholeCamera(
        1000, 1001, 639.5, 359.5, 1280, 720, (0.1, -0.2, 0.001, 0.002, 0.03)
    )
    assert rig.right.distortion == ()
    assert rig.baseline_m == pytest.approx(0.5)
    assert notes == ()


def test_a_saved_rig_is_read_back_equal(tmp_path: Path) -> None:
    rotation, _ = cv2.Rodrigues(np.array([0.01, -0.02, 0.003]))
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = rotation, (-0.31, 0.002, 1e-9)
    left = PinholeCamera(
        1000.123456789, 999.5, 640.1, 359.9, 1280, 720, (0.1, 1e-9, 0.0, -3e-5, 0.0)
    )
    rig = StereoRig(left, PinholeCamera(990.0, 991.0, 650.0, 350.0, 1280, 720), motion)
    path = tmp_path / "rig.yaml"
    save_rig(rig, path)
    again, notes = load_rig(path, size_px=SIZE)
    assert (again.left, again.right) == (rig.left, rig.right)
    assert np.array_equal(again.right_from_left, rig.right_from_left)
    assert notes == ()
    assert os.listdir(tmp_path) == ["rig.yaml"]


def test_mono_uses_the_left_camera(tmp_path: Path) -> None:
    content = rig_content()
    del content["right"], content["right_from_left"]
    path = written(tmp_path, content)
    camera, notes = load_camera(path, size_px=SIZE)
    assert camera.fy_px == 1001
    assert notes == ()
    assert "'right'" in refused(path)


def test_size_equal_cropped_scaled_or_refused(tmp_path: Path) -> None:
    path = written(tmp_path, rig_content())
    cropped, notes = load_rig(path, size_px=(1280, 718))
    assert (cropped.left.height_px, cropped.left.cy_px, notes) == (718, 359.5, ())
    scaled, notes = load_rig(path, size_px=(640, 360))
    assert scaled.left.fx_px == pytest.approx(500)
    # the principal point stays at the image centre
    assert scaled.left.cx_px == pytest.approx(319.5)
    assert scaled.left.distortion == cropped.left.distortion
    assert len(notes) == 1  # the same of both cameras
    assert "scaled from 1280x720 px" in notes[0]
    message = refused(path, size_px=(640, 480))
    assert "1280x720" in message
    assert "640x480" in message


@pytest.mark.parametrize(
    ("keys", "value", "key_word"),
    [
        (("right_from_left", "translation_m"), [-540, 0, 0], "540"),
        (("left", "cx_px"), 0, "principal point"),
        (("right", "cy_px"), 1e-300, "principal point"),
        (("right_from_left", "translation_m"), [-0.001, 0, 0], "0.001"),
        (("right_from_left", "translation_m"), [0, 0, 0], "baseline"),
        (("right_from_left", "translation_m"), [0.5, 0, 0], "swap"),
        (("right_from_left", "translation_m"), [0, 0.5, 0], "--mono"),
        (("right_from_left", "translation_m"), [0.5, 0], "'right_from_left.translation_m'"),
        (("right_from_left", "rotation"), [[1, 0, 0], [0, 1, 0], [0, 0, 1.1]], "R^T R"),
        (("right_from_left", "rotation"), [[1, 0, 0], [0, 1, 0], [0, 0, -1]], "determinant of -1"),
        (("left", "fx_px"), -3.0, "'left.fx_px'"),
        (("left", "fx_px"), 0, "'left.fx_px'"),
        (("right", "fy_px"), float("nan"), "'right.fy_px'"),
        (("right", "fy_px"), "long", "'right.fy_px'"),
        (("left", "fx_px"), 6.0, "millimetres"),
        (("left", "width_px"), 0, "'left.width_px'"),
        (("left", "distortion"), [0.1, 0.2], "[0.1, 0.2]"),
        (("left", "focal"), 1000, "'left.focal'"),
        (("track_range_rig",), 2, "track_range_rig"),
        (("track_range_rig",), "one", "'one'"),
    ],
)
def test_wrong_values(tmp_path: Path, keys: tuple[str, ...], value: object, key_word: str) -> None:
    content = rig_content()
    block = content
    for key in keys[:-1]:
        block = block[key]
    block[keys[-1]] = value
    assert key_word in refused(written(tmp_path, content))


@pytest.mark.parametrize("key", ["left", "left.cx_px", "right_from_left.rotation"])
def test_missing_keys(tmp_path: Path, key: str) -> None:
    content = rig_content()
    block = content
    *parents, last = key.split(".")
    for parent in parents:
        block = block[parent]
    del block[last]
    assert f"'{key}'" in refused(written(tmp_path, content))


@pytest.mark.parametrize(
    ("text", "key_word"),
    [
        ("", "track_range_rig"),
        ("hello\n", "track_range_rig"),
        ("- 1\n- 2\n", "track_range_rig"),
        ("track_range_rig: 1\na: [1, 2\nb: 3\n", "line 3"),
        ("%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: 3\n", "M1"),
        ("%YAML:1.0\n---\nM1: !!opencv-matrix [\n", "M1"),
    ],
)
def test_files_of_other_kinds(tmp_path: Path, text: str, key_word: str) -> None:
    assert key_word in refused(written(tmp_path, text))


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    assert "no such file" in refused(tmp_path / "absent.yaml")
    assert "folder" in refused(tmp_path)
    binary = tmp_path / "left.mp4"
    binary.write_bytes(bytes(range(256)))
    assert "binary" in refused(binary)
    binary.write_bytes(b"#" * 1_000_001)
    assert "1 MB" in refused(binary)


def test_rigs_that_cannot_be_written(tmp_path: Path) -> None:
    rig = StereoRig.rectified(PinholeCamera(1000, 1000, 640, 360, 1280, 720), 0.5)
    with pytest.raises(RigError, match="written"):
        save_rig(rig, tmp_path / "absent" / "rig.yaml")
    with pytest.raises(RigError, match="500 m"):
        save_rig(StereoRig.rectified(rig.left, 500.0), tmp_path / "rig.yaml")
    assert list(tmp_path.iterdir()) == []


def test_infinite_values_are_refused() -> None:
    good = PinholeCamera(1000, 1000, 640, 360, 1280, 720)
    motion = np.eye(4)
    motion[0, 3] = np.nan
    with pytest.raises(RigError, match="finite"):
        check_rig(StereoRig(good, good, motion), "rig")
    wrong = PinholeCamera(1000, 1000, float("nan"), 360, 1280, 720)
    with pytest.raises(RigError, match="principal point"):
        check_rig(StereoRig.rectified(wrong, 0.5), "rig")
    infinite = PinholeCamera(float("inf"), 1000, 640, 360, 1280, 720)
    with pytest.raises(RigError, match="fx_px"):
        check_rig(StereoRig.rectified(infinite, 0.5), "rig")


def test_find_rig(tmp_path: Path) -> None:
    video = tmp_path / "left.mp4"
    video.touch()
    assert find_rig(video) is None
    calib = written(tmp_path, KITTI, "calib.txt")
    assert find_rig(video) == calib
    rig = written(tmp_path, rig_content())
    assert find_rig(video) == rig
    images = tmp_path / "image_2"
    images.mkdir()
    assert find_rig(images) == rig
    inside = written(images, KITTI, "calib.txt")
    assert find_rig(images) == inside

"""Written rigs are read back, by track-range and by OpenCV."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.images.board_scenes import CAMERA, rig
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.opencv import save_opencv
from track_range.stereo.rig_formats.reading import (
    RIG_FORMATS,
    load_calibration,
    load_camera,
    load_rig,
    rig_writers,
)
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig

SIZE = (640, 360)
TRUE = rig()


def test_camera_is_read_back_equal(tmp_path):
    path = tmp_path / "rig.yaml"
    save_camera(CAMERA, path, comments=["18 views", "two\nlines"])
    assert load_camera(path, size_px=SIZE) == (CAMERA, ())
    assert load_calibration(path) == (CAMERA, ())
    assert path.read_text().startswith("# 18 views\n# two\n# lines\ntrack_range_rig: 1\n")
    with pytest.raises(RigError, match="'right'"):
        load_rig(path, size_px=SIZE)


def test_a_rig_with_comments_is_read_back_equal(tmp_path):
    save_rig(TRUE, tmp_path / "rig.yaml", comments=["29 pairs"])
    again, _ = load_calibration(tmp_path / "rig.yaml")
    assert (again.left, again.right) == (TRUE.left, TRUE.right)
    assert np.array_equal(again.right_from_left, TRUE.right_from_left)
    assert os.listdir(tmp_path) == ["rig.yaml"]


@pytest.mark.parametrize("name", ["stereo.yml", "stereo.yaml", "stereo.xml", "stereo"])
def test_opencv_format_of_a_rig(tmp_path, name):
    path = tmp_path / name
    save_opencv(TRUE, path)
    again, notes = load_calibration(path)
    assert (again.left, again.right) == (TRUE.left, TRUE.right)
    assert np.allclose(again.right_from_left, TRUE.right_from_left, atol=1e-12)
    assert "0.12 m" in notes[0]
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_READ)
    p2, q = storage.getNode("P2").mat(), storage.getNode("Q").mat()
    assert -p2[0, 3] / p2[0, 0] == pytest.approx(TRUE.baseline_m)
    assert 1 / q[3, 2] == pytest.approx(TRUE.baseline_m)
    assert storage.getNode("image_width").real() == 640


def test_opencv_format_of_a_camera(tmp_path):
    path = tmp_path / "camera.yml"
    save_opencv(CAMERA, path)
    assert load_calibration(path) == (CAMERA, ())


def test_no_distortion_is_written_as_zeros(tmp_path):
    plain = StereoRig.rectified(dataclasses.replace(CAMERA, distortion=()), 0.3)
    save_opencv(plain, tmp_path / "a.yml")
    assert load_calibration(tmp_path / "a.yml")[0].left.distortion == (0.0,) * 5


def test_cameras_that_cannot_be_written(tmp_path):
    bad = dataclasses.replace(CAMERA, fx_px=-1.0)
    for write in (save_camera, save_opencv):
        with pytest.raises(RigError, match="fx_px"):
            write(bad, tmp_path / "a.yaml")
        with pytest.raises(RigError, match="written"):
            write(CAMERA, tmp_path / "absent" / "a.yaml")
        with pytest.raises(RigError, match="folder"):
            write(CAMERA, Path())
    far = StereoRig.rectified(CAMERA, 500.0)
    for write in (save_rig, save_opencv):
        with pytest.raises(RigError, match="500 m"):
            write(far, tmp_path / "a.yaml")
    two_sizes = StereoRig.rectified(CAMERA, 0.1)
    two_sizes = dataclasses.replace(two_sizes, right=dataclasses.replace(CAMERA, width_px=642))
    with pytest.raises(RigError, match="image size"):
        save_opencv(two_sizes, tmp_path / "a.yaml")
    assert os.listdir(tmp_path) == []


def test_a_calibration_is_fitted_to_a_size(tmp_path):
    save_rig(TRUE, tmp_path / "rig.yaml")
    save_camera(CAMERA, tmp_path / "mono.yaml")
    half_size_rig, notes = load_calibration(tmp_path / "rig.yaml", size_px=(320, 180))
    assert half_size_rig.left.fx_px == pytest.approx(260)
    assert len(notes) == 1
    assert load_calibration(tmp_path / "mono.yaml", size_px=(320, 180))[0].fx_px == pytest.approx(
        260
    )
    wrong = tmp_path / "wrong.yaml"
    wrong.write_text(
        (tmp_path / "rig.yaml").read_text().replace("translation_m: [-0.1", "translation_m: [-10.1")
    )
    with pytest.raises(RigError, match=r"wrong\.yaml.*baseline"):
        load_calibration(wrong)


@pytest.mark.parametrize("cameras", [TRUE, CAMERA])
@pytest.mark.parametrize("name", rig_writers())
def test_written_files_are_recognised(tmp_path, name, cameras):
    path = tmp_path / "rig.yml"
    rig_writers()[name](cameras, path, ["2 views"])
    text = path.read_text()
    assert (
        next(
            rig_format.name for rig_format in RIG_FORMATS.by_priority if rig_format.recognises(text)
        )
        == name
    )
    again, _ = load_calibration(path)
    assert type(again) is type(cameras)


def test_number_of_rig_formats():
    assert len(RIG_FORMATS.usable) == 33

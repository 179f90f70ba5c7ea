"""ROS's camera_info: both layouts, two files or documents, the order of the cameras, and errors in
one sentence."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from tests.stereo.rig_texts import SIZE, refused
from tests.support.recordings.calibration_files import calibration_yaml as calibration
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import stereo_rectification
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_calibration, load_camera, load_rig


def raw_rig() -> StereoRig:
    """Two different cameras with distortion, 0.12 m apart."""
    right_from_left = np.eye(4)
    right_from_left[:3, :3], _ = cv2.Rodrigues(np.array([0.01, -0.02, 0.005]))
    right_from_left[:3, 3] = (-0.12, 0.002, -0.001)
    return StereoRig(
        PinholeCamera(900.0, 905.0, 640.0, 350.0, *SIZE, (-0.3, 0.1, 0.001, -0.0005, 0.0)),
        PinholeCamera(910.0, 908.0, 650.0, 365.0, *SIZE, (-0.31, 0.09, 0.0, 0.0005, 0.01)),
        right_from_left,
    )


def messages(rig: StereoRig) -> tuple[dict[str, Any], dict[str, Any]]:
    """camera_info of the left and right camera as ROS 2 prints them."""
    r1, r2, p1, p2, _ = stereo_rectification(rig)
    left, right = (
        {
            "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "optical"},
            "height": SIZE[1],
            "width": SIZE[0],
            "distortion_model": "plumb_bob",
            "d": list(camera.distortion),
            "k": camera.matrix.ravel().tolist(),
            "r": np.ravel(r).tolist(),
            "p": np.ravel(p).tolist(),
            "binning_x": 0,
            "binning_y": 0,
            "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
        }
        for camera, r, p in ((rig.left, r1, p1), (rig.right, r2, p2))
    )
    return left, right


LEFT, RIGHT = messages(raw_rig())


def camera_info(path: Path, *documents: dict[str, Any]) -> Path:
    path.parent.mkdir(exist_ok=True)
    path.write_text("---\n".join(yaml.safe_dump(document) for document in documents))
    return path


def check(rig: StereoRig, notes: tuple[str, ...]) -> None:
    expected = raw_rig()
    assert (rig.left, rig.right) == (expected.left, expected.right)
    assert np.allclose(rig.right_from_left, expected.right_from_left, atol=1e-9)
    assert len(notes) == 1
    assert "raw" in notes[0]


@pytest.mark.parametrize("layout", [dict, calibration])
@pytest.mark.parametrize(
    "names", [("left.yaml", "right.yaml"), ("left/ost.yaml", "right/ost.yaml")]
)
def test_file_beside_the_given_one(tmp_path, layout, names):
    left, right = (
        camera_info(tmp_path / name, layout(content))
        for name, content in zip(names, (LEFT, RIGHT), strict=True)
    )
    for path in (left, right):
        check(*load_rig(path, size_px=SIZE))
    assert load_camera(right, size_px=SIZE)[0] == raw_rig().right


@pytest.mark.parametrize("is_swapped", [False, True])
def test_documents_of_one_file(tmp_path, is_swapped):
    pair = (RIGHT, LEFT) if is_swapped else (LEFT, RIGHT)
    repeated = (*pair, {**pair[0], "header": {"stamp": {"sec": 9, "nanosec": 0}}})
    path = camera_info(tmp_path / "echo.yaml", *repeated)
    path.write_text("---\n" + path.read_text() + "---\n")
    rig, notes = load_rig(path, size_px=SIZE)
    check(rig, notes)
    assert f"first document is the {'right' if is_swapped else 'left'}" in notes[0]


def test_ros1_keys(tmp_path):
    def ros1(message: dict[str, Any]) -> dict[str, Any]:
        return {key.upper() if len(key) == 1 else key: value for key, value in message.items()}

    check(*load_rig(camera_info(tmp_path / "echo.yaml", ros1(LEFT), ros1(RIGHT)), size_px=SIZE))


def test_folder(tmp_path):
    camera_info(tmp_path / "a.yaml", RIGHT)
    assert "found 1" in refused(tmp_path)
    camera_info(tmp_path / "b.yml", LEFT)
    (tmp_path / "notes.yaml").write_text("speed: 3\n")
    rig, notes = load_rig(tmp_path, size_px=SIZE)
    check(rig, notes)
    assert "a.yaml is the right" in notes[0]
    check(*load_calibration(tmp_path))


def test_rectified_images(tmp_path):
    keys = ("image_width", "image_height", "projection_matrix")
    only_p = [{key: calibration(message)[key] for key in keys} for message in (LEFT, RIGHT)]
    rig, notes = load_rig(camera_info(tmp_path / "p.yaml", *only_p), size_px=SIZE)
    assert rig.is_rectified
    assert rig.baseline_m == pytest.approx(raw_rig().baseline_m)
    assert "rectified" in notes[0]
    assert "K" in refused(camera_info(tmp_path / "mixed.yaml", calibration(LEFT), only_p[1]))


def changed(message: dict[str, Any], **changes: Any) -> dict[str, Any]:
    return {**message, **changes}


@pytest.mark.parametrize(
    ("documents", "key_word"),
    [
        ((LEFT,), "second file"),
        ((LEFT, changed(RIGHT, p=LEFT["p"])), "baseline"),
        (
            (
                LEFT,
                changed(RIGHT, p=[*RIGHT["p"][:3], 0.0, *RIGHT["p"][4:7], -100.0, *RIGHT["p"][8:]]),
            ),
            "above",
        ),
        ((LEFT, changed(RIGHT, p=[*RIGHT["p"][:3], -1e6, *RIGHT["p"][4:]])), "metres"),
        ((LEFT, changed(RIGHT, k=[0.0] * 9)), "calibrated"),
        ((LEFT, changed(RIGHT, k=[1.0] * 8)), "camera_matrix"),
        ((LEFT, changed(RIGHT, d=None)), "distortion"),
        ((LEFT, changed(RIGHT, distortion_model="equidistant")), "equidistant"),
        ((LEFT, changed(RIGHT, p=[float("inf")] * 12)), "projection_matrix"),
        ((LEFT, changed(RIGHT, r=[2.0] * 9)), "rotation"),
        ((LEFT, changed(RIGHT, roi={"x_offset": 10})), "region"),
        ((LEFT, RIGHT, changed(LEFT, width=640)), "found 3"),
        ((LEFT, {"k": [1, 2]}), "image_width"),
    ],
)
def test_wrong_files(tmp_path, documents, key_word):
    assert key_word in refused(camera_info(tmp_path / "rig.yaml", *documents))


def test_missing_partner_is_named(tmp_path):
    path = camera_info(tmp_path / "left.yaml", LEFT)
    assert "right.yaml" in refused(path)
    camera, notes = load_camera(path, size_px=SIZE)
    assert camera == raw_rig().left
    assert len(notes) == 1


def test_line_of_a_damaged_second_document(tmp_path):
    path = camera_info(tmp_path / "echo.yaml", LEFT, RIGHT)
    text = path.read_text() + "  bad: [\n"
    path.write_text(text)
    assert f"line {text.count(chr(10))}" in refused(
        path
    ) or f"line {text.count(chr(10)) + 1}" in refused(path)


@pytest.mark.parametrize("model", ["equidistant", "fisheye"])
def test_fisheye_model(tmp_path, model):
    fisheye = calibration(LEFT) | {
        "distortion_model": model,
        "distortion_coefficients": {"rows": 1, "cols": 4, "data": [0.1, 0.01, 0.0, 0.0]},
    }
    camera, _ = load_camera(camera_info(tmp_path / "camera.yaml", fisheye), size_px=SIZE)
    assert (camera.lens, camera.distortion) == ("kannala-brandt", (0.1, 0.01, 0.0, 0.0))

"""Of several cameras in a file, one is chosen by its name, by the size of the images or as the left one of
the only pair; otherwise the names are asked for."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import track_range as tr
from tests.support.error_messages import error_message
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.reading import load_calibration, load_camera, load_rig

SIZE = (1280, 720)


def block(focal_px: float, size_px: tuple[int, int] | None = SIZE, **more: Any) -> dict[str, Any]:
    """A camera; its first coefficient is its focal length / 10,000."""
    width_px, height_px = size_px or SIZE
    matrix = [[focal_px, 0, width_px / 2], [0, focal_px, height_px / 2], [0, 0, 1]]
    size = {} if size_px is None else {"image_size": list(size_px)}
    return {"camera_matrix": matrix, "dist_coeffs": [focal_px / 1e4, 0, 0, 0, 0], **size, **more}


def written(folder: Path, content: dict[str, Any]) -> Path:
    path = folder / "cameras.json"
    path.write_text(json.dumps(content))
    return path


def test_a_name_for_a_file_of_one_camera(tmp_path: Path) -> None:
    path = written(tmp_path, {"front": block(700.0)})
    message = error_message(RigError, load_camera, path, size_px=SIZE, cameras=("rear",))
    assert "a file of one camera, found 'rear'; omit it" in message


@pytest.mark.parametrize(
    "names",
    [
        ("zed_left", "zed_right", "d435"),
        ("cam_0", "cam_1", "cam_2"),
        ("front", "rear", "side"),
        ("left_1080", "left_720", "right"),
        ("cam0", "camera0", "rgb"),
    ],
)
def test_each_camera_by_its_name(tmp_path: Path, names: tuple[str, ...]) -> None:
    focal_px = dict(zip(names, (700.0, 800.0, 900.0), strict=True))
    path = written(tmp_path, {"cameras": {name: block(f) for name, f in focal_px.items()}})
    for name, expected_px in focal_px.items():
        camera, _ = load_camera(path, size_px=SIZE, cameras=(name,))
        assert (camera.fx_px, camera.distortion[0]) == (expected_px, expected_px / 1e4)
    message = error_message(RigError, load_camera, path, size_px=SIZE)
    assert all(name in message for name in ("--camera", *names))
    for wrong in (("other",), names[:2], names):
        message = error_message(RigError, load_camera, path, size_px=SIZE, cameras=wrong)
        assert all(name in message for name in ("--camera", *names))


def test_the_size_of_the_images_decides(tmp_path: Path) -> None:
    sizes = {"front": (1920, 1080), "rear": (1280, 720), "side": (640, 480)}
    path = written(tmp_path, {name: block(1000, size) for name, size in sizes.items()})
    camera, notes = load_camera(path, size_px=(640, 480))
    assert camera.size_px == (640, 480)
    assert notes == ()
    content = {name: block(size[0], size) for name, size in sizes.items()}
    camera, notes = load_camera(written(tmp_path, content), size_px=(1920, 1080))
    assert camera.fx_px == 1920
    assert "camera front of front, rear, side" in notes[0]
    modes = {f"{w}x{h}": block(w, None) for w, h in sizes.values()}
    assert load_camera(written(tmp_path, modes), size_px=SIZE)[0].fx_px == 1280
    assert "1920x1080" in error_message(RigError, load_camera, path, size_px=(960, 540))


def test_a_matrix_and_a_distortion_are_of_one_camera(tmp_path: Path) -> None:
    front, rear = block(700), block(800)
    del rear["dist_coeffs"]
    path = written(tmp_path, {"front": front, "rear": rear})
    message = error_message(RigError, load_camera, path, size_px=SIZE, cameras=("rear",))
    assert "distortion coefficients" in message


def test_one_camera_of_several_needs_no_pair(tmp_path: Path) -> None:
    for content in (
        {"K1": [[700, 0, 640], [0, 700, 360], [0, 0, 1]], "D1": [0.1, 0, 0, 0, 0]},
        {"left": block(700), "right": block(700.5)},
        {"cam0": block(700), "cam1": block(700.5), "R": np.eye(3).tolist()},
    ):
        camera, notes = load_camera(written(tmp_path, content), size_px=SIZE)
        assert (camera.fx_px, [note for note in notes if "--camera" in note]) == (700, [])
    path = written(tmp_path, {"left": block(700), "right": block(800)})
    camera, notes = load_camera(path, size_px=SIZE)
    assert camera.fx_px == 700
    assert "camera left of left, right is used" in notes[0]
    assert load_camera(path, size_px=SIZE, cameras=("right",))[0].fx_px == 800
    assert "R and T" in error_message(RigError, load_rig, path, size_px=SIZE)


def with_poses(folder: Path) -> Path:
    """Three cameras in a row, 0.2 m apart, the last one on the left."""
    cameras = {
        f"cam{n}": block(700 + n, R=np.eye(3).tolist(), T=[x_m, 0.0, 0.0])
        for n, x_m in enumerate((0.0, -0.2, 0.2))
    }
    return written(folder, cameras)


def test_pairs_by_their_names(tmp_path: Path) -> None:
    path = with_poses(tmp_path)
    assert "LEFT,RIGHT" in error_message(RigError, load_rig, path, size_px=SIZE)
    for names, baseline_m in ((("cam0", "cam1"), 0.2), (("cam2", "cam1"), 0.4)):
        rig, _ = load_rig(path, size_px=SIZE, cameras=names)
        assert rig.baseline_m == pytest.approx(baseline_m)
        assert rig.left.fx_px == 700 + int(names[0][-1])
        assert tr.load_rig(path, camera=",".join(names)).left == rig.left
    message = error_message(RigError, load_rig, path, size_px=SIZE, cameras=("cam1", "cam0"))
    assert "swap left and right" in message
    assert load_calibration(path, cameras=("cam1",))[0].fx_px == 701


def test_the_pair_of_a_file_with_a_third_camera(tmp_path: Path) -> None:
    cameras = {"left": block(700), "right": block(701), "rgb": block(900)}
    content = {**cameras, "R": np.eye(3).tolist(), "T": [-0.12, 0, 0]}
    path = written(tmp_path, content)
    rig, _ = load_rig(path, size_px=SIZE)
    assert (rig.left.fx_px, rig.right.fx_px) == (700, 701)
    assert "left, right, rgb" in error_message(RigError, load_camera, path, size_px=SIZE)
    assert load_camera(path, size_px=SIZE, cameras=("rgb",))[0].fx_px == 900


def test_recorded_and_rectified_cameras_are_not_mixed(tmp_path: Path) -> None:
    recorded, rectified = block(700), block(800, is_rectified=True)
    del rectified["dist_coeffs"]
    path = written(tmp_path, {"cam0": recorded, "camRect0": rectified})
    camera, _ = load_camera(path, size_px=SIZE)
    assert (camera.fx_px, camera.distortion[0]) == (700, 0.07)
    camera, _ = load_camera(written(tmp_path, {"camRect0": rectified}), size_px=SIZE)
    assert (camera.fx_px, camera.distortion) == (800, ())


def test_equal_cameras_of_all_images_are_one(tmp_path: Path) -> None:
    frames = [{"file_path": f"{n}.png", "fl_x": 700.0, "cx": 640.5, "cy": 360.5} for n in range(3)]
    content = {"camera_model": "OPENCV", "w": 1280, "h": 720, "frames": frames}
    camera, _ = load_camera(written(tmp_path, content), size_px=SIZE)
    assert (camera.fx_px, camera.cx_px) == (700, 640)

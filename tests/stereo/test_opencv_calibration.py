"""Files of OpenCV's calibration samples, single and in pairs, and wrong files."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.stereo.rig_texts import SIZE, refused, written
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.opencv import save_opencv
from track_range.stereo.rig_formats.reading import left_from_reference_m, load_camera, load_rig


def opencv_files(
    folder: Path, *, baseline: float = 0.12, size: tuple[int, int] | None = None
) -> tuple[Path, Path]:
    """The two files that OpenCV's stereo_calib sample writes."""
    intrinsics, extrinsics = folder / "intrinsics.yml", folder / "extrinsics.yml"
    storage = cv2.FileStorage(str(intrinsics), cv2.FILE_STORAGE_WRITE)
    for number in "12":
        storage.write(f"M{number}", np.array([[1000.0, 0, 640], [0, 1000, 360], [0, 0, 1]]))
        storage.write(f"D{number}", np.array([[0.1, 0.01, 0, 0, 0.0]]))
    if size is not None:
        storage.write("image_width", size[0])
        storage.write("image_height", size[1])
    storage.release()
    storage = cv2.FileStorage(str(extrinsics), cv2.FILE_STORAGE_WRITE)
    storage.write("R", np.asarray(cv2.Rodrigues(np.array([0.0, 0.01, 0.0]))[0]))
    storage.write("T", np.array([[-baseline], [0.0], [0.0]]))
    storage.write("Q", np.eye(4))
    storage.release()
    return intrinsics, extrinsics


@pytest.mark.parametrize("given", [0, 1])
def test_opencv_files_find_each_other(tmp_path: Path, given: int) -> None:
    path = opencv_files(tmp_path)[given]
    rig, notes = load_rig(path, size_px=SIZE)
    assert rig.baseline_m == pytest.approx(0.12)
    assert rig.left.distortion == (0.1, 0.01, 0.0, 0.0, 0.0)
    assert rig.right_from_left[0, 2] == pytest.approx(np.sin(0.01))
    assert (rig.left.width_px, rig.left.height_px) == SIZE
    assert "0.12 m" in notes[0]
    assert np.array_equal(left_from_reference_m(path, is_grey=False), np.zeros(3))


def test_opencv_in_one_file_of_the_old_yaml_dialect(tmp_path: Path) -> None:
    intrinsics, extrinsics = opencv_files(tmp_path)
    body = [path.read_text().split("---\n", 1)[1] for path in (intrinsics, extrinsics)]
    single = written(tmp_path, "%YAML:1.0\n---\n" + "".join(body), "stereo.yml")
    intrinsics.unlink()
    extrinsics.unlink()
    assert load_rig(single, size_px=SIZE)[0].baseline_m == pytest.approx(0.12)


def test_opencv_with_a_size_is_scaled(tmp_path: Path) -> None:
    path, _ = opencv_files(tmp_path, size=(2560, 1440))
    rig, notes = load_rig(path, size_px=SIZE)
    assert rig.left.fx_px == pytest.approx(500)
    assert len(notes) == 3


def test_opencv_file_of_one_camera(tmp_path: Path) -> None:
    path = tmp_path / "camera.yml"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 1280)
    storage.write("image_height", 720)
    storage.write("camera_matrix", np.array([[1100.0, 0, 640], [0, 1100, 360], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.zeros((5, 1)))
    storage.release()
    camera, _ = load_camera(path, size_px=SIZE)
    assert camera.fx_px == 1100
    assert "M2, D2, R and T" in refused(path)


def test_incomplete_opencv_files(tmp_path: Path) -> None:
    intrinsics, extrinsics = opencv_files(tmp_path)
    alone = tmp_path / "alone"
    alone.mkdir()
    for source, key_word in ((intrinsics, "R and T"), (extrinsics, "M1")):
        path = alone / source.name
        path.write_bytes(source.read_bytes())
        assert key_word in refused(path)
        path.unlink()
    text = intrinsics.read_text() + extrinsics.read_text().split("---\n", 1)[1]
    vector = text.replace(
        "R: !!opencv-matrix\n   rows: 3\n   cols: 3", "R: !!opencv-matrix\n   rows: 1\n   cols: 4"
    )
    head, tail = vector.split("R: !!opencv-matrix", 1)
    data_from, data_to = tail.index("data: ["), tail.index("]")
    vector = (
        head
        + "R: !!opencv-matrix"
        + tail[:data_from]
        + "data: [ 0., 0.01, 0., 1. "
        + tail[data_to:]
    )
    assert "9 numbers in R" in refused(written(alone, vector, "both.yml"))


@pytest.mark.parametrize("missing", ["M2", "D2", "R", "T"])
def test_opencv_pair_without_a_matrix(tmp_path: Path, missing: str) -> None:
    for path in opencv_files(tmp_path):
        path.write_text(
            path.read_text().replace(f"{missing}: !!opencv-matrix", f"X{missing}: !!opencv-matrix")
        )
    for name in ("intrinsics.yml", "extrinsics.yml"):
        with pytest.raises(RigError, match=rf"{name}: .*found no {missing};"):
            load_rig(tmp_path / name, size_px=SIZE)
        if missing != "D2":  # of a camera that may be meant
            assert load_camera(tmp_path / name, size_px=SIZE)[0].fx_px == 1000  # needs no pair


def test_opencv_left_camera_only(tmp_path: Path) -> None:
    intrinsics, extrinsics = opencv_files(tmp_path)
    text = intrinsics.read_text()
    left = written(tmp_path, text[: text.index("M2:")], "left.yml")
    assert load_camera(left, size_px=SIZE)[0].fx_px == 1000
    intrinsics.write_text(left.read_text())
    with pytest.raises(RigError, match=r"intrinsics.yml: .*M2"):
        load_rig(intrinsics, size_px=SIZE)
    assert load_camera(intrinsics, size_px=SIZE)[0].fx_px == 1000
    extrinsics.unlink()
    assert load_camera(intrinsics, size_px=SIZE)[0].fx_px == 1000


def test_opencv_baseline_in_millimetres(tmp_path: Path) -> None:
    rig, notes = load_rig(opencv_files(tmp_path, baseline=120.0)[0], size_px=SIZE)
    assert rig.baseline_m == pytest.approx(0.12)
    assert "is taken to be in millimetres" in notes[0]


def fisheye_file(path: Path, names: tuple[str, str], *, flag: int | None) -> Path:
    """A rig of cv::fisheye with camera matrices under these names and, with a flag, the key
    fisheye_model."""
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for name, number in zip(names, "12", strict=True):
        storage.write(name, np.array([[400.0, 0, 640], [0, 400, 360], [0, 0, 1]]))
        storage.write(f"D{number}", np.array([[0.1], [0.01], [0.0], [0.0]]))
    if flag is not None:
        storage.write("fisheye_model", flag)
    storage.write("R", np.eye(3))
    storage.write("T", np.array([[-0.12], [0.0], [0.0]]))
    storage.release()
    return path


@pytest.mark.parametrize(
    ("names", "flag", "lens"),
    [
        (("M1", "M2"), 1, "kannala-brandt"),
        (("K1", "K2"), 1, "kannala-brandt"),
        (("K1", "K2"), None, "kannala-brandt"),
        (("K1", "K2"), 0, "pinhole"),
        (("M1", "M2"), None, "pinhole"),
    ],
)
def test_fisheye_files(tmp_path, names, flag, lens):
    rig, notes = load_rig(fisheye_file(tmp_path / "rig.yml", names, flag=flag), size_px=SIZE)
    assert (rig.left.lens, rig.right.lens) == (lens, lens)
    assert rig.left.distortion == (0.1, 0.01, 0.0, 0.0)
    assert any("fisheye model" in note for note in notes) == (names[0] == "K1" and flag is None)


def test_fisheye_of_the_calibration_sample(tmp_path):
    path = written(
        tmp_path,
        "%YAML:1.0\n---\nimage_width: 1280\nimage_height: 720\nfisheye_model: 1\ncamera_matrix: "
        "!!opencv-matrix {rows: 3, cols: 3, dt: d, data: [400., 0., 640., 0., 400., 360., 0., 0., "
        "1.]}\ndistortion_coefficients: !!opencv-matrix {rows: 4, cols: 1, dt: d, data: [0.1, 0., "
        "0., 0.]}\n",
        "camera.yml",
    )
    assert load_camera(path, size_px=SIZE)[0].lens == "kannala-brandt"


def test_wide_lenses_are_written_as_fisheye_or_refused(tmp_path):
    rig = StereoRig.rectified(
        PinholeCamera(400.0, 400.0, 640.0, 360.0, *SIZE, (0.1, 0.0, 0.0, 0.0), "kannala-brandt"),
        0.2,
    )
    save_opencv(rig, tmp_path / "rig.yml")
    again, _ = load_rig(tmp_path / "rig.yml", size_px=SIZE)
    assert (again.left, again.right) == (rig.left, rig.right)
    with pytest.raises(RigError, match="double-sphere"):
        save_opencv(
            PinholeCamera(400.0, 400.0, 640.0, 360.0, *SIZE, (0.0, 0.5), "double-sphere"),
            tmp_path / "ds.yml",
        )

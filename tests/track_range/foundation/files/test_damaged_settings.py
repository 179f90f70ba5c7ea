"""Damaged files in YAML, JSON and FileStorage: each reader returns, or names the file and the
reason."""

from __future__ import annotations

import json
import struct
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as st
from scipy.io import savemat

from tests.support.damaged_text import check_damaged, damaged
from tests.support.recordings import device_calibrations as device
from tests.support.recordings.calibration_files import NAMES
from tests.support.recordings.calibration_matrices import matlab, plain, values
from track_range.detection.formats.tables.class_names import names_for_folder
from track_range.detection.training.data_yaml import read_data_yaml
from track_range.detection.yolo.metadata import ModelOptions, read_metadata
from track_range.foundation.errors import UserError
from track_range.foundation.files.structured_text import yaml_text
from track_range.ranging.size_models.curve import load_curves
from track_range.run.options.precedence import settings_from
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.rig_formats.reading import load_calibration

CAMERA = {
    "fx_px": 700.0,
    "fy_px": 701.0,
    "cx_px": 320.0,
    "cy_px": 180.0,
    "width_px": 640,
    "height_px": 360,
}
RIG = {
    "track_range_rig": 1,
    "left": CAMERA,
    "right": {**CAMERA, "distortion": [0.1, 0.0, 0.0, 0.0]},
    "right_from_left": {"rotation": np.eye(3).tolist(), "translation_m": [-0.5, 0.0, 0.0]},
}
KALIBR = {
    "cam0": {
        "camera_model": "pinhole",
        "intrinsics": [700.0, 700.0, 320.0, 180.0],
        "resolution": [640, 360],
    },
    "cam1": {
        "camera_model": "pinhole",
        "distortion_model": "radtan",
        "distortion_coeffs": [0.1, 0.0, 0.0, 0.0],
        "intrinsics": [700.0, 700.0, 320.0, 180.0],
        "resolution": [640, 360],
        "T_cn_cnm1": [[1.0, 0, 0, -0.5], [0, 1.0, 0, 0], [0, 0, 1.0, 0], [0, 0, 0, 1.0]],
    },
}
ALIGNMENT = {
    "track_range_align": 1,
    "offset_px": 0.5,
    "bow_px": 1.0,
    "residual_px": 0.2,
    "source": "this drive",
}
FACTS = {
    "names": ["person", "car"],
    "anchors": [[[10, 13]], [[30, 61]]],
    "letterbox": "centred-114",
    "divisor": 255,
}
DATA = {
    "path": "..",
    "train": "images/train",
    "val": ["images/val"],
    "names": {0: "car"},
    "labels": "labels",
}
SETTINGS = {
    "track_range_settings": 1,
    "run": {"mono": "a.mp4", "focal_px": 700.0, "classes": ["car"], "sgbm": False},
}
TABLE = {
    "log_size": [-4.0, -2.0],
    "log_distance": [5.0, 3.0],
    "sigma_relative": 0.1,
    "n": 5,
    "source": "drives",
}
CURVES = {
    "track_range_size_curves": 2,
    "kind": "table",
    "measure": "height",
    "classes": {"car": TABLE},
}
LINE = {"intercept": 0.4, "per_log_height": -1.0, "per_log_width": 0.0, "per_bearing": 0.0}
LINES = {"car": {**LINE, "sigma_relative": 0.1, "n": 5, "source": "drives"}}
LOG_LINEAR = {
    "track_range_size_curves": 2,
    "kind": "log-linear",
    "whole": LINES,
    "height_only": LINES,
}


def opencv_text(suffix: str) -> str:
    """A stereo calibration of OpenCV in YAML, XML or JSON."""
    storage = cv2.FileStorage(suffix, cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", 640)
    storage.write("image_height", 360)
    for number in "12":
        storage.write(f"M{number}", np.array([[700.0, 0, 320], [0, 700, 180], [0, 0, 1]]))
        storage.write(f"D{number}", np.array([[0.1, 0.01, 0, 0, 0.0]]))
    storage.write("R", np.eye(3))
    storage.write("T", np.array([[-0.5], [0], [0]]))
    text: str = storage.releaseAndGetString()
    return text


READERS: dict[str, tuple[str, str, Callable[[Path], object]]] = {
    "rig": ("rig.yaml", yaml_text(RIG), load_calibration),
    "kalibr": ("camchain.yaml", yaml_text(KALIBR), load_calibration),
    "opencv YAML": ("stereo.yml", opencv_text(".yml"), load_calibration),
    "opencv XML": ("stereo.xml", opencv_text(".xml"), load_calibration),
    "opencv JSON": ("stereo.json", opencv_text(".json"), load_calibration),
    "kitti": (
        "calib.txt",
        "P2: 700 0 320 0 0 700 180 0 0 0 1 0\nP3: 700 0 320 -350 0 700 180 0 0 0 1 0\nS_rect_02: "
        "6.4e+02 3.6e+02\n",
        load_calibration,
    ),
    **{
        name: (file, text, load_calibration)
        for name, file, text in (
            ("zed", "SN1.conf", device.ZED),
            ("oak", "calib.json", json.dumps(device.oak())),
            ("realsense", "rs.txt", device.REALSENSE + device.EXTRINSIC),
            ("ost", "ost.txt", device.ost(-108.0, ("narrow_stereo/left", "narrow_stereo/right"))),
            ("euroc", "sensor.yaml", yaml_text(device.euroc_camera(0))),
            ("vins", "camera.yaml", device.vins_camera(0, "MEI")),
            (
                "orb-slam",
                "settings.yaml",
                device.orb(*device.focal("Camera1", 718.856), "Stereo.b: 0.53716"),
            ),
            ("middlebury", "calib.txt", device.MIDDLEBURY),
            ("K.txt", "K.txt", "754.5 0.0 489.25 0.0 754.5 265.125 0.0 0.0 1.0\n0.063\n"),
            ("names in JSON", "stereo.json", json.dumps(plain(values(NAMES[4])))),
            (
                "printed",
                "stereo.txt",
                "\n".join(f"{name}:\n{np.asarray(v)}" for name, v in values(NAMES[0]).items()),
            ),
        )
    },
    "alignment": ("align.yaml", yaml_text(ALIGNMENT), load_alignment),
    "table": ("curves.json", json.dumps(CURVES), load_curves),
    "log-linear": ("curves.json", json.dumps(LOG_LINEAR), load_curves),
    "model": (
        "m.yaml",
        yaml_text(FACTS),
        lambda path: read_metadata(path.with_suffix(".onnx"), {}, ModelOptions()),
    ),
    "names": ("data.yaml", yaml_text(DATA), lambda path: names_for_folder(path.parent)),
    "settings": ("settings.yaml", yaml_text(SETTINGS), lambda path: settings_from({}, path)),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder for the files of all examples."""
    return tmp_path_factory.mktemp("damaged")


@pytest.mark.parametrize("kind", READERS)
@settings(max_examples=15, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damaged_files(folder: Path, kind: str, data: st.DataObject) -> None:
    name, text, read = READERS[kind]
    check_damaged(read, folder / name, data.draw(damaged(text.encode())))


@pytest.mark.parametrize("kind", READERS)
def test_valid_files(tmp_path: Path, kind: str) -> None:
    name, text, read = READERS[kind]
    (tmp_path / name).write_text(text)
    assert read(tmp_path / name) is not None


@pytest.mark.parametrize("kind", ["opencv YAML", "opencv XML", "opencv JSON"])
def test_truncated_opencv_files(tmp_path: Path, kind: str) -> None:
    name, text, read = READERS[kind]
    for length in range(0, len(text) - 40, 20):
        error = check_damaged(read, tmp_path / name, text[:length].encode())
        assert error is not None or kind == "opencv YAML"  # YAML may end after any matrix


def binary_files(folder: Path) -> dict[str, bytes]:
    """A calibration in NumPy's and MATLAB's formats."""
    np.savez(folder / "a.npz", **values(NAMES[0]))
    np.savez_compressed(folder / "b.npz", **values(NAMES[0]))
    np.save(folder / "c.npy", np.eye(3))
    savemat(folder / "d.mat", matlab(True))
    savemat(folder / "e.mat", matlab(True), do_compression=True)
    return {file.name: file.read_bytes() for file in sorted(folder.iterdir())}


@pytest.mark.parametrize("number", range(5))
@settings(max_examples=40, deadline=None, suppress_health_check=list(HealthCheck))
@given(data=st.data())
def test_damaged_binary_calibrations(folder: Path, number: int, data: st.DataObject) -> None:
    (folder / "binary").mkdir(exist_ok=True)
    name, content = list(binary_files(folder / "binary").items())[number]
    place = data.draw(st.integers(0, len(content) - 1))
    byte = data.draw(st.binary(min_size=0, max_size=9))
    check_damaged(
        load_calibration,
        folder / f"{number}{name[1:]}",
        content[:place] + byte + content[place + len(byte) :],
    )
    check_damaged(load_calibration, folder / f"{number}{name[1:]}", content[:place])


def test_large_content_is_not_unpacked(tmp_path: Path) -> None:
    """100 MB of zeros in a .mat, and an .npz that announces more than it has."""
    element = zlib.compress(bytes(100_000_000))
    bomb = (
        b"MATLAB 5.0 MAT-file".ljust(124)
        + b"\x00\x01IM"
        + struct.pack("<II", 15, len(element))
        + element
    )
    error = check_damaged(load_calibration, tmp_path / "a.mat", bomb)
    assert "64 MB" in str(error)
    np.savez_compressed(tmp_path / "b.npz", **values(NAMES[0]) | {"K1": np.zeros((4000, 4000))})
    error = check_damaged(load_calibration, tmp_path / "b.npz", (tmp_path / "b.npz").read_bytes())
    assert "M1" in str(error)  # 128 MB, left out


MATRIX = "%YAML:1.0\n---\nM1: !!opencv-matrix\n   rows: {}\n   cols: {}\n   dt: {}\n   data: {}\n"


@pytest.mark.parametrize(
    ("text", "key_word"),
    [
        (MATRIX.format(100000, 100000, "d", "[1.]"), "rows"),
        (MATRIX.format(-1, 3, "d", "[1.]"), "rows"),
        (MATRIX.format(3, 3, "99d", "[1.]"), "dt"),
        (MATRIX.format(3, 3, "d", "[1.]"), "3 x 3"),
        (MATRIX.format(3, 3, "d", "!!binary |\n      AAAA"), "binary"),
        (MATRIX.format(3, 3, "d", "[.Nan, 0, 0, 0, 1, 0, 0, 0, 1]"), "data"),
        (MATRIX.format(3, 3, "d", "[1, 0, 0, 0, 1, 0, 0, 0, 2]"), "last row"),
        (MATRIX.format(3, 3, "d", "[1, 0, 0, 0, 1, 0, 0, 0, 1]"), "D1"),
        ("%YAML:1.0\n---\n# opencv-matrix\nM1: " + "[" * 100_000, "nested"),
        ("%YAML:1.0\n---\n# opencv-matrix\nM1: 5\n", "M1"),
        ("%YAML:1.0\n---\n# opencv-matrix\n- 1\n", "expected"),
        ("<opencv_storage>" + "<a>" * 50_000, "XML"),
        (
            "<!DOCTYPE a [<!ENTITY a 'b'>]><opencv_storage><M1>&a;</M1></opencv_storage>",
            "document type",
        ),
        ("<opencv_storage><M1>1</M1><M1>1</M1></opencv_storage>", "M1"),
        ('{"opencv-matrix": ' + "[" * 100_000, "nested"),
        ('{"opencv-matrix": 1, "M1": "$base64$AAAA"}', "M1"),
        (opencv_text(".yml").replace("image_width: 640", "image_width: 2147483648"), "image_width"),
        (opencv_text(".yml").replace("D2:", "D3:"), "D2"),
        (opencv_text(".json").replace("-0.5", "-1e200"), "at least -1"),
        (json.dumps(plain(values(NAMES[3], np.full((3, 1), -1e200)))), "no T"),
    ],
)
def test_wrong_opencv_files(tmp_path: Path, text: str, key_word: str) -> None:
    error = check_damaged(load_calibration, tmp_path / "stereo.yml", text.encode())
    assert key_word in str(error)


@pytest.mark.parametrize(
    ("name", "read", "content"),
    [
        (
            "rig.yaml",
            load_calibration,
            {"track_range_rig": 1, "left": {**CAMERA, "width_px": 40000}},
        ),
        (
            "rig.yaml",
            load_calibration,
            {"track_range_rig": 1, "left": {**CAMERA, "width_px": True}},
        ),
        ("align.yaml", load_alignment, {**ALIGNMENT, "bow_px": 1e9}),
        (
            "settings.yaml",
            lambda path: settings_from({}, path),
            {**SETTINGS, "run": {"mono": "a", "focal_px": "x"}},
        ),
    ],
)
def test_key_is_named(
    tmp_path: Path, name: str, read: Callable[[Path], object], content: dict[str, Any]
) -> None:
    error = check_damaged(read, tmp_path / name, yaml_text(content).encode())
    assert any(key in str(error) for key in ("left.width_px", "bow_px", "run.focal_px"))


@pytest.mark.parametrize(
    ("run", "options", "key_word"),
    [
        ({"mono": "a", "duration_s": -1}, {}, "duration_s"),
        ({"mono": "a", "duration_s": -1}, {"start_s": 1.0}, "duration_s"),
        ({"mono": "a", "lane_width_m": [3.5]}, {}, "lane_width_m"),
        ({"mono": "a", "threads": 2**63 - 1}, {}, "threads"),
        ({"mono": "a", "tracker": "none"}, {}, "tracker"),
        ({"mono": "a", "rig": "r.yaml", "focal_px": 700}, {}, "--rig or --focal-px"),
        ({"mono": "a", "disparity": True}, {}, "--disparity"),
        ({"mono": "a"}, {"disparity": True}, "settings of"),
        ({}, {}, "--mono"),
    ],
)
def test_settings_errors_name_the_file(
    tmp_path: Path, run: dict[str, Any], options: dict[str, Any], key_word: str
) -> None:
    path = tmp_path / "settings.yaml"
    path.write_text(yaml_text({"track_range_settings": 1, "run": run}))
    with pytest.raises(UserError, match=r"settings\.yaml") as raised:
        settings_from(options, path)
    assert key_word in str(raised.value)


@pytest.mark.parametrize("nc", [1, 10**12])
def test_data_yaml_entries(tmp_path: Path, nc: int) -> None:
    for entry in (None, 3, [], [None], {"a": 1}, "\0", "x" * 5000, float("nan")):
        content = {"names": ["car"], "train": entry, "val": "images", "nc": nc}
        assert check_damaged(read_data_yaml, tmp_path / "data.yaml", yaml_text(content).encode())

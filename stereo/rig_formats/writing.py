"""Rig files as they are written: our own rig.yaml, and the file of OpenCV's stereo_calib sample.

    ours     track_range_rig left [right right_from_left]         read back by `rig_files`, to the last digit
    OpenCV   M1 D1 M2 D2 R T, with R1 R2 P1 P2 Q                  one camera: camera_matrix distortion_coefficients

Files are written atomically.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import yaml

from track_range.foundation.arrays import FloatArray
from track_range.foundation.atomic_files import describe, write_text
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import lens_terms, turns_of
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import check_camera, check_rig

VERSION = 1
"""Of our format."""


def save_rig(rig: StereoRig, path: Path, *, comments: Sequence[str] = ()) -> None:
    """Write a rig in our format, with lines of comment above it.

    Raises:
        RigError: the rig is implausible, or the file cannot be written.
    """
    check_rig(rig, path)
    motion = {
        "rotation": rig.right_from_left[:3, :3].tolist(),
        "translation_m": rig.right_from_left[:3, 3].tolist(),
    }
    content = {
        "track_range_rig": VERSION,
        "left": _camera_content(rig.left),
        "right": _camera_content(rig.right),
        "right_from_left": motion,
    }
    write_whole(path, _commented(comments) + _yaml(content))


def save_camera(camera: PinholeCamera, path: Path, *, comments: Sequence[str] = ()) -> None:
    """Write one camera in our format, with lines of comment above it; it serves --mono.

    Raises:
        RigError: the camera is implausible, or the file cannot be written.
    """
    check_camera(camera, path)
    write_whole(path, _commented(comments) + _yaml({"track_range_rig": VERSION, "left": _camera_content(camera)}))


def save_opencv(cameras: StereoRig | PinholeCamera, path: Path) -> None:
    """Write a rig as OpenCV's stereo_calib sample does, or one camera as calibration.cpp does; lengths in metres.

    Raises:
        RigError: implausible, of images of two sizes, or the file cannot be written.
    """
    if isinstance(cameras, StereoRig):
        check_rig(cameras, path)
        left, right = cameras.left, cameras.right
        if (left.width_px, left.height_px) != (right.width_px, right.height_px):
            raise RigError(
                f"{path}: OpenCV's file holds one size of images, and these cameras have {left.width_px}x"
                f"{left.height_px} and {right.width_px}x{right.height_px} px; write ours."
            )
        matrices = _rig_matrices(cameras)
    else:
        check_camera(cameras, path)
        matrices = {"camera_matrix": cameras.matrix, "distortion_coefficients": _lens_row(cameras)}
        left = cameras
    storage = cv2.FileStorage(path.suffix or ".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", left.width_px)
    storage.write("image_height", left.height_px)
    for key, matrix in matrices.items():
        storage.write(key, np.asarray(matrix, np.float64))
    write_whole(path, storage.releaseAndGetString())


def _rig_matrices(rig: StereoRig) -> Mapping[str, npt.ArrayLike]:
    rotation, shift_m = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3:]
    left, right = _lens_row(rig.left), _lens_row(rig.right)
    r1, r2, p1, p2, q = turns_of(rig)
    return {
        "M1": rig.left.matrix, "D1": left, "M2": rig.right.matrix, "D2": right, "R": rotation, "T": shift_m,
        "R1": r1, "R2": r2, "P1": p1, "P2": p2, "Q": q,
    }  # fmt: skip


def _lens_row(camera: PinholeCamera) -> FloatArray:
    return lens_terms(camera)[None]


def _camera_content(camera: PinholeCamera) -> dict[str, float | list[float]]:
    return {
        "fx_px": camera.fx_px,
        "fy_px": camera.fy_px,
        "cx_px": camera.cx_px,
        "cy_px": camera.cy_px,
        "width_px": camera.width_px,
        "height_px": camera.height_px,
        "distortion": list(camera.distortion),
    }


def _yaml(content: Mapping[str, object]) -> str:
    return yaml.safe_dump(dict(content), sort_keys=False, default_flow_style=None, width=120)


def _commented(lines: Sequence[str]) -> str:
    return "".join(f"# {part}\n" for line in lines for part in line.splitlines())


def write_whole(path: Path, text: str) -> None:
    """Write a text file atomically.

    Raises:
        RigError: it is a folder, or cannot be written.
    """
    if path.is_dir():
        raise RigError(f"{path}: it is a folder; name a file to write.")
    try:
        write_text(path, text)
    except OSError as error:
        raise RigError(f"{path}: cannot be written ({describe(error)}); choose another place.") from error

"""Writer of the files of OpenCV's calibration samples: matrices in FileStorage (YAML, XML or JSON).

    stereo_calib.cpp   M1 D1 M2 D2 R T (and R1 R2 P1 P2 Q)
    calibration.cpp    camera_matrix distortion_coefficients image_width image_height        one camera
    cv::fisheye        one of the above with fisheye_model: 1, as calibration.cpp writes it

They are read by `dialects.py`, without OpenCV: its parser overflows the stack on nested lists,
writes outside its memory on damaged JSON, and does not return from some base64 data. A camera
without distortion coefficients is refused: stereo_calib always writes them, and distances would be
wrong if a distorted camera were treated as an ideal one.
"""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import distortion_coefficients, stereo_rectification
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import check_camera, check_rig
from track_range.stereo.lenses.lens import KANNALA_BRANDT, PINHOLE
from track_range.stereo.rig_formats.dialects import FORMATS
from track_range.stereo.rig_formats.rig_format import write_rig_text


def save_opencv(cameras: StereoRig | PinholeCamera, path: Path) -> None:
    """Write a rig as OpenCV's stereo_calib sample does, or one camera as calibration.cpp does;
    lengths in metres.

    Raises RigError if the cameras are implausible or of different image sizes, or the file cannot
    be written.
    """
    left, right = (
        (cameras.left, cameras.right) if isinstance(cameras, StereoRig) else (cameras, cameras)
    )
    if left.lens != right.lens or left.lens not in (PINHOLE, KANNALA_BRANDT):
        raise RigError(
            f"{path}: expected the lens {PINHOLE} or {KANNALA_BRANDT} for OpenCV's format, the same for both cameras, "
            f"got {' and '.join(sorted({left.lens, right.lens}))}; write a rig.yaml."
        )
    matrices: dict[str, npt.ArrayLike]
    if isinstance(cameras, StereoRig):
        check_rig(cameras, path)
        if left.size_px != right.size_px:
            raise RigError(
                f"{path}: expected cameras of equal image size for OpenCV's format, got "
                f"{left.width_px}x{left.height_px} and {right.width_px}x{right.height_px} px; write a rig.yaml."
            )
        r1, r2, p1, p2, q = stereo_rectification(cameras)
        matrices = {
            "M1": left.matrix, "D1": _distortion_row(left), "M2": right.matrix, "D2": _distortion_row(right),
            "R": cameras.right_from_left[:3, :3], "T": cameras.right_from_left[:3, 3:],
            "R1": r1, "R2": r2, "P1": p1, "P2": p2, "Q": q,
        }  # fmt: skip
    else:
        check_camera(cameras, path)
        matrices = {
            "camera_matrix": cameras.matrix,
            "distortion_coefficients": _distortion_row(cameras),
        }
    storage = cv2.FileStorage(
        path.suffix or ".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY
    )
    storage.write("image_width", left.width_px)
    storage.write("image_height", left.height_px)
    if left.is_wide:
        storage.write("fisheye_model", 1)
    for key, matrix in matrices.items():
        storage.write(key, np.asarray(matrix, np.float64))
    write_rig_text(path, storage.releaseAndGetString())


def _distortion_row(camera: PinholeCamera) -> FloatArray:
    return (
        np.array(camera.distortion)[None]
        if camera.is_wide
        else distortion_coefficients(camera)[None]
    )


OPENCV = replace(
    FORMATS["opencv"], write=lambda cameras, path, _comments: save_opencv(cameras, path)
)

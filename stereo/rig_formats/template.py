"""A rig.yaml with the values that could be read from a calibration, and blanks for missing
values.
"""

import contextlib
from pathlib import Path

import numpy as np

from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.reading import read_calibration
from track_range.stereo.rig_formats.values.cameras import stated_camera
from track_range.stereo.rig_formats.values.draft import read_draft
from track_range.stereo.rig_formats.values.resolution import stated_motion

_KEYS = ("fx_px", "fy_px", "cx_px", "cy_px", "width_px", "height_px")
_HINTS = {
    "fx_px": "focal length, pixels",
    "cx_px": "principal point, pixels",
    "width_px": "size of the images, pixels",
    "distortion": "k1, k2, p1, p2, k3 of OpenCV; [] = undistorted images",
}


def rig_template(path: Path, *, metres_per_unit: float | None = None) -> str:
    """Text of a rig.yaml, with the meaning of a key where its value is missing. RigError if the
    file is missing.

    `metres_per_unit` is the unit of the lengths in the file, None = by the file or their size.
    """
    try:
        calibration = read_calibration(path, is_grey=False, is_pair=None).in_unit(metres_per_unit)
        cameras = [
            {} if camera is None else _values(camera)
            for camera in (calibration.left, calibration.right)
        ]
        reason = calibration.unit_doubt
        motion = None if reason else calibration.right_from_left
    except RigError as error:
        if not path.exists():
            raise
        reason, cameras, motion = str(error), [{}, {}], None
        with contextlib.suppress(RigError):
            draft = read_draft(path)
            for index in (0, 1):
                with contextlib.suppress(RigError):  # of a matrix that is none of a camera
                    cameras[index] = stated_camera(draft, index)
            motion = stated_motion(draft)
    advice = (
        "fill in the blanks, in pixels and metres, and remove what a single camera does not have"
    )
    lines = [
        f"# from {path.name}; {advice}",
        *([f"# {reason}"] if reason else []),
        "track_range_rig: 1",
    ]
    for name, values in zip(("left", "right"), cameras, strict=True):
        lines.append(f"{name}:")
        lines += [_line(key, values.get(key)) for key in (*_KEYS, "distortion")]
    lines.append("right_from_left:  # x_right = rotation x_left + translation_m")
    if motion is None:
        lines += ["  rotation:  # [[1, 0, 0], [0, 1, 0], [0, 0, 1]] of parallel cameras"]
        lines += ["  translation_m:  # [-0.12, 0, 0]: a right camera 0.12 m to the right"]
    else:
        lines += [
            f"  rotation: {motion[:3, :3].tolist()}",
            f"  translation_m: {motion[:3, 3].tolist()}",
        ]
    return "\n".join(lines) + "\n"


def _line(key: str, value: object) -> str:
    """A key with its value, or with its meaning."""
    if value is None:
        return f"  {key}:  # {_HINTS.get(key, 'missing')}"
    return f"  {key}: {value}"


def _values(camera: PinholeCamera) -> dict[str, object]:
    values: dict[str, object] = {key: getattr(camera, key) for key in _KEYS}
    if not camera.width_px:
        values |= {"width_px": None, "height_px": None}
    distortion = np.array(camera.distortion).tolist()
    return values | {
        "distortion": f"{distortion}\n  lens: {camera.lens}" if camera.is_wide else distortion
    }

"""`track-range rig`: conversion of calibration files, and their meaning in degrees and metres."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import numpy as np

from track_range.cli.console import console, print_grid, print_line
from track_range.cli.lazy import Lazy, lazy_app, single_app
from track_range.cli.parameters import command
from track_range.foundation.errors import UsageError
from track_range.foundation.options import Options, option
from track_range.report.tables import Column, grid_of
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import Rectifier
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.rig_formats.reading import left_from_reference_m, load_calibration
from track_range.stereo.rig_formats.registry import rig_writers

_Size = Annotated[str | None, option("Size of the images in pixels, for formats without it.", metavar="WIDTHxHEIGHT")]


class ConvertOptions(Options):
    """Options of `track-range rig convert`."""

    source: Annotated[Path, option("Calibration file to read, in any known format.", metavar="IN", is_argument=True)]
    out: Annotated[Path, option("Calibration file to write.", metavar="OUT", is_argument=True)]
    to: Annotated[
        str, option("Format of OUT: rig.yaml (ours) or OpenCV's stereo_calib (opencv).", metavar="ours|opencv")
    ] = "ours"
    size: _Size = None


class ShowOptions(Options):
    """Options of `track-range rig show`."""

    source: Annotated[Path, option("Calibration file of any known format.", metavar="FILE", is_argument=True)]
    size: _Size = None


_MAX_SIDE_PX = 20_000
"""No image is wider, and maps for a larger one fill the memory."""

_SHOWN_M = np.array([10.0, 30.0, 60.0])


def _convert(options: ConvertOptions) -> None:
    source, out, writers = options.source, options.out, rig_writers()
    if options.to not in writers:
        raise UsageError(f"--to {options.to}: expected one of {', '.join(writers)}.")
    if source.resolve() == out.resolve():
        raise UsageError(f"{out}: it is the file to convert; name another one to write.")
    found, notes = load_calibration(source, size_px=_size_of(options.size))
    _check_sized(found, source)
    writers[options.to](found, out, [f"from {source.name}"])
    for note in (*notes, *_labels_note(source)):
        print_line(console, note)
    cameras = "two cameras" if isinstance(found, StereoRig) else "one camera"
    print_line(console, f"Written: {out}, {cameras}.")


def _labels_note(source: Path) -> tuple[str, ...]:
    """What the formats that are written cannot keep: the frame that KITTI's labels are given in."""
    shift_m = float(np.linalg.norm(left_from_reference_m(source, is_grey=False)))
    if shift_m == 0:
        return ()
    return (
        f"KITTI's labels are given {shift_m:.3f} m beside the left camera, which only {source.name} tells: with "
        "--truth give that one.",
    )


def _show(options: ShowOptions) -> None:
    found, notes = load_calibration(options.source, size_px=_size_of(options.size))
    cameras = {"left": found.left, "right": found.right} if isinstance(found, StereoRig) else {"camera": found}
    columns = _camera_columns(list(cameras.values()))
    print_grid(console, grid_of(str(options.source), "camera", list(cameras), columns))
    for name, camera in cameras.items():
        terms = ", ".join(f"{term:.5g}" for term in camera.distortion) or "none"
        print_line(console, f"{name}: lens terms {terms}.")
    if isinstance(found, StereoRig):
        _show_pair(found)
    for note in notes:
        print_line(console, note)


def _camera_columns(cameras: list[PinholeCamera]) -> list[Column]:
    columns = [
        Column("fx px", [camera.fx_px for camera in cameras], "{:.2f}"),
        Column("fy px", [camera.fy_px for camera in cameras], "{:.2f}"),
        Column("cx px", [camera.cx_px for camera in cameras], "{:.2f}"),
        Column("cy px", [camera.cy_px for camera in cameras], "{:.2f}"),
    ]
    if not all(camera.width_px for camera in cameras):
        return columns
    return [
        Column("width px", [camera.width_px for camera in cameras], "{:.0f}"),
        Column("height px", [camera.height_px for camera in cameras], "{:.0f}"),
        *columns,
        Column("across deg", [_view_deg(camera.width_px, camera.cx_px, camera.fx_px) for camera in cameras]),
        Column("down deg", [_view_deg(camera.height_px, camera.cy_px, camera.fy_px) for camera in cameras]),
    ]


def _view_deg(side_px: int, centre_px: float, focal_px: float) -> float:
    """Angle between the rays through the first and the last pixel's outer edge, lens terms aside."""
    first, last = (centre_px + 0.5) / focal_px, (side_px - 0.5 - centre_px) / focal_px
    return math.degrees(math.atan(first) + math.atan(last))


def _show_pair(rig: StereoRig) -> None:
    x_m, y_m, z_m = rig.right_from_left[:3, 3].tolist()
    print_line(console, f"baseline {rig.baseline_m:.4f} m (shift {x_m:.4f}, {y_m:.4f}, {z_m:.4f} m).")
    pitch, yaw, roll = _angles_deg(rig)
    state = "rectified already" if rig.is_rectified else "to be rectified"
    print_line(console, f"right against left: pitch {pitch:.3f}, yaw {yaw:.3f}, roll {roll:.3f} degrees; {state}.")
    if not (rig.is_rectified or rig.left.width_px):
        print_line(console, "No image size in it: give --size WIDTHxHEIGHT to see what distances it measures.")
        return
    rectified = Rectifier(rig).rig
    disparity_px = rectified.left.fx_px * rectified.baseline_m / _SHOWN_M
    columns = [
        Column("disparity px", disparity_px.tolist(), "{:.2f}"),
        Column("m per_px", (_SHOWN_M / disparity_px).tolist(), "{:.2f}"),
        Column("% per_0.1_px", (10 / disparity_px).tolist(), "{:.2f}"),
    ]
    names = [f"{distance:.0f} m" for distance in _SHOWN_M]
    print_line(
        console, f"rectified: focal length {rectified.left.fx_px:.2f} px, baseline {rectified.baseline_m:.4f} m."
    )
    print_grid(console, grid_of("What a disparity means", "distance", names, columns))


def _angles_deg(rig: StereoRig) -> tuple[float, float, float]:
    """Turn of the right camera's frame about the x, y and z axis, in that order (R = Rz Ry Rx)."""
    turn = rig.right_from_left[:3, :3]
    pitch = math.atan2(turn[2, 1], turn[2, 2])
    yaw = math.asin(float(np.clip(-turn[2, 0], -1, 1)))
    roll = math.atan2(turn[1, 0], turn[0, 0])
    return math.degrees(pitch) + 0.0, math.degrees(yaw) + 0.0, math.degrees(roll) + 0.0  # + 0.0: no minus before 0


def _size_of(words: str | None) -> tuple[int, int] | None:
    if words is None:
        return None
    sides = words.lower().split("x")
    if len(sides) != 2 or not all(side.isdecimal() and int(side) for side in sides):
        raise UsageError(f"--size {words}: write it as WIDTHxHEIGHT, such as 1242x375.")
    width_px, height_px = (int(side) for side in sides)
    if max(width_px, height_px) > _MAX_SIDE_PX:
        raise UsageError(f"--size {words}: no image is as large; {_MAX_SIDE_PX} px a side at most.")
    return width_px, height_px


def _check_sized(found: PinholeCamera | StereoRig, source: Path) -> None:
    camera = found.left if isinstance(found, StereoRig) else found
    if not camera.width_px:
        raise RigError(f"{source}: it does not say how large the images are; add --size WIDTHxHEIGHT.")


convert_app = single_app(command(ConvertOptions, _convert))
show_app = single_app(command(ShowOptions, _show))
app = lazy_app(
    {
        "show": Lazy(
            "track_range.cli.rig:show_app",
            "Show angles of view, baseline, and metres per pixel of disparity.",
            examples=("track-range rig show rig.yaml", "track-range rig show calib.txt --size 1242x375"),
        ),
        "convert": Lazy(
            "track_range.cli.rig:convert_app",
            "Convert a calibration file to rig.yaml or OpenCV's stereo_calib.",
            examples=("track-range rig convert calib.txt rig.yaml --size 1242x375",),
        ),
    }
)

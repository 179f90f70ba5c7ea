"""`track-range rig`: shows, checks and converts calibration files."""

import math
from pathlib import Path
from typing import Annotated

import numpy as np

from track_range.cli.shared.console import console, print_grid, print_line
from track_range.cli.shared.lazy import Lazy, lazy_app
from track_range.cli.shared.parameters import command
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import counted, real_path
from track_range.foundation.schemas.options import Options, option
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import Rectifier
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.virtual_pinhole import field_of_view
from track_range.stereo.rig_formats import reading
from track_range.stereo.rig_formats.rig_format import write_rig_text
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig
from track_range.stereo.rig_formats.template import rig_template
from track_range.stereo.rig_formats.values.stated import UNIT_NAMES
from track_range.views.tables import Column, grid_of

_Size = Annotated[
    str | None, option("Image size in pixels, for formats without a size.", metavar="WIDTHxHEIGHT")
]
_Unit = Annotated[
    str | None,
    option(
        "Unit of the lengths in the file, if track-range reads the wrong unit.", metavar="mm|cm|m"
    ),
]


_Camera = Annotated[
    tuple[str, ...],
    option(
        "In a file of several cameras, the name of one, or of the left and the right one.",
        metavar="NAME|LEFT,RIGHT",
    ),
]


class ConvertOptions(Options):
    """Options of `track-range rig convert`."""

    source: Annotated[
        Path,
        option(
            "Calibration file to read, in any supported format.", metavar="IN", is_argument=True
        ),
    ]
    out: Annotated[Path, option("Calibration file to write.", metavar="OUT", is_argument=True)]
    to: Annotated[
        str,
        option(
            "Format of OUT: track-range's rig.yaml (ours) or OpenCV's stereo_calib (opencv).",
            choices=reading.rig_writers,
        ),
    ] = "ours"
    size: _Size = None
    unit: _Unit = None
    camera: _Camera = ()


class ShowOptions(Options):
    """Options of `track-range rig show`."""

    source: Annotated[
        Path, option("Calibration file in any supported format.", metavar="FILE", is_argument=True)
    ]
    size: _Size = None
    unit: _Unit = None
    camera: _Camera = ()


class TemplateOptions(Options):
    """Options of `track-range rig template`."""

    source: Annotated[
        Path, option("Calibration file of any kind.", metavar="FILE", is_argument=True)
    ]
    out: Annotated[Path | None, option("File to write (default: the text is printed).")] = None
    unit: _Unit = None


_UNITS = {"mm": 0.001, "cm": 0.01, "m": 1.0}  # metres
_OURS = "ours"  # the format rig.yaml
_MAX_SIDE_PX = 20_000  # rectification maps of larger images would not fit into memory
_SHOWN_M = np.array([10.0, 30.0, 60.0])  # distances for which disparities are shown


def _convert(options: ConvertOptions) -> None:
    source, out, writers = options.source, options.out, reading.rig_writers()
    if real_path(source) == real_path(out):
        raise UsageError(
            f"{out}: expected a file other than the input; choose another name for OUT."
        )
    size_px = _size_of(options.size)
    calibration, loading_notes = reading.load_calibration(
        source,
        size_px=size_px,
        metres_per_unit=_unit_of(options.unit),
        cameras=options.camera,
    )
    camera = calibration.left if isinstance(calibration, StereoRig) else calibration
    if not camera.width_px:
        raise RigError(f"{source}: expected an image size, found none; give --size WIDTHxHEIGHT.")
    content, notes = (
        reading.content_of(source, is_grey=False, is_pair=False),
        list(loading_notes),
    )
    shift_m = float(
        np.linalg.norm(reading.left_from_reference_m(source, is_grey=False, size_px=size_px))
    )
    if shift_m:  # of KITTI files
        notes.append(
            f"OUT does not store that the reference frame of KITTI labels is {shift_m:.3f} m from "
            f"the left camera: use --rig {source.name} in runs with --truth."
        )
    comments = [f"from {source.name}"]
    if options.to == _OURS and isinstance(calibration, PinholeCamera):
        save_camera(
            calibration,
            out,
            comments=comments,
            road=content.road,
            mounting=content.mounting,
            accuracy=content.accuracy,
        )
    elif options.to == _OURS and isinstance(calibration, StereoRig):
        save_rig(
            calibration,
            out,
            comments=comments,
            mounting=content.mounting,
            accuracy=content.accuracy,
        )
    else:
        writers[options.to](calibration, out, comments)
        if (content.road, content.mounting, content.accuracy) != (None, None, None):
            notes.append(
                "OUT does not store the uncertainty of the calibration and the mounting: use "
                f"--rig {source.name}."
            )
    cameras = "two cameras" if isinstance(calibration, StereoRig) else "one camera"
    print_line(console, *notes, f"Written: {out}, {cameras}.")


def _show(options: ShowOptions) -> None:
    source, size_px, metres_per_unit = (
        options.source,
        _size_of(options.size),
        _unit_of(options.unit),
    )
    calibration, notes = reading.load_calibration(
        source, size_px=size_px, metres_per_unit=metres_per_unit, cameras=options.camera
    )
    content = reading.read_calibration(
        source, is_grey=False, is_pair=None, cameras=options.camera, size_px=size_px
    ).in_unit(metres_per_unit)
    if source.is_file():
        unit = (
            f"; lengths in the file: {UNIT_NAMES.get(content.metres_per_unit, 'metres')}"
            if content.right
            else ""
        )
        print_line(console, f"Recognised: {reading.format_of(source)[0].title}{unit}.")
    if isinstance(calibration, StereoRig):
        cameras = {"left": calibration.left, "right": calibration.right}
    else:
        cameras = {"camera": calibration}
    columns = _camera_columns(list(cameras.values()))
    print_grid(console, grid_of(str(source), "camera", list(cameras), columns))
    for other in content.others if size_px is None else ():
        section = [camera for camera in (other.left, other.right) if camera is not None]
        size = (
            f"{other.left.width_px}x{other.left.height_px} px (--size "
            f"{other.left.width_px}x{other.left.height_px})"
        )
        print_grid(
            console,
            grid_of(
                f"Images of {size}",
                "camera",
                list(cameras)[: len(section)],
                _camera_columns(section),
            ),
        )
    for name, camera in cameras.items():
        terms = ", ".join(f"{term:.5g}" for term in camera.distortion) or "none"
        model = f" of the lens model {camera.lens}" if camera.is_wide else ""
        print_line(console, f"{name}: distortion coefficients{model} {terms}.")
    if isinstance(calibration, StereoRig):
        _show_pair(calibration, options.source)
    if content.mounting is not None:
        print_line(console, f"mounting, as for --mount: {','.join(content.mounting.parts)}.")
    print_line(console, *notes)


def _template(options: TemplateOptions) -> None:
    text = rig_template(options.source, metres_per_unit=_unit_of(options.unit))
    if options.out is None:
        print_line(console, text.rstrip("\n"))
        return
    write_rig_text(options.out, text)
    # that of right_from_left is a heading
    n_blanks = sum(":  #" in line for line in text.splitlines()) - 1
    print_line(console, f"Written: {options.out}, {counted(n_blanks, 'blank')} to fill in.")


def _unit_of(text: str | None) -> float | None:
    if text is not None and text not in _UNITS:
        raise UsageError(f"--unit {text}: expected mm, cm or m.")
    return None if text is None else _UNITS[text]


def _camera_columns(cameras: list[PinholeCamera]) -> list[Column]:
    def column(name: str, pattern: str) -> Column:
        return Column(f"{name} px", [getattr(camera, f"{name}_px") for camera in cameras], pattern)

    columns = [column(name, "{:.2f}") for name in ("fx", "fy", "cx", "cy")]
    if not all(camera.width_px for camera in cameras):
        return columns
    # angles between the outer edges of the first and the last pixel
    angles = [
        field_of_view(camera if camera.is_wide else camera.without_distortion())
        for camera in cameras
    ]
    return [
        column("width", "{:.0f}"),
        column("height", "{:.0f}"),
        *columns,
        Column("horizontal deg", [angle.horizontal_deg for angle in angles]),
        Column("vertical deg", [angle.vertical_deg for angle in angles]),
    ]


def _show_pair(rig: StereoRig, source: Path) -> None:
    x_m, y_m, z_m = rig.right_from_left[:3, 3].tolist()
    print_line(
        console, f"baseline {rig.baseline_m:.4f} m (translation {x_m:.4f}, {y_m:.4f}, {z_m:.4f} m)."
    )
    rotation = rig.right_from_left[:3, :3]  # Rz Ry Rx
    pitch = math.degrees(math.atan2(rotation[2, 1], rotation[2, 2])) + 0.0  # + 0.0 avoids -0.0
    yaw = math.degrees(math.asin(float(np.clip(-rotation[2, 0], -1, 1)))) + 0.0
    roll = math.degrees(math.atan2(rotation[1, 0], rotation[0, 0])) + 0.0
    state = "already rectified" if rig.is_rectified else "not rectified"
    print_line(
        console,
        f"right relative to left: pitch {pitch:.3f}, yaw {yaw:.3f}, roll "
        f"{roll:.3f} degrees; {state}.",
    )
    if not (rig.is_rectified or rig.left.width_px):
        print_line(
            console,
            "The file has no image size: give --size WIDTHxHEIGHT to show disparities by distance.",
        )
        return
    rectified = Rectifier(rig, source=source).rig
    disparity_px = rectified.left.fx_px * rectified.baseline_m / _SHOWN_M
    columns = [
        Column("disparity px", disparity_px.tolist(), "{:.2f}"),
        Column("m per_px", (_SHOWN_M / disparity_px).tolist(), "{:.2f}"),
        Column("% per_0.1_px", (10 / disparity_px).tolist(), "{:.2f}"),
    ]
    names = [f"{distance:.0f} m" for distance in _SHOWN_M]
    print_line(
        console,
        f"rectified: focal length {rectified.left.fx_px:.2f} px, baseline "
        f"{rectified.baseline_m:.4f} m.",
    )
    print_grid(console, grid_of("Disparity and range resolution", "distance", names, columns))


def _size_of(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    sides = text.lower().split("x")
    if len(sides) != 2 or not all(side.isdecimal() and int(side) for side in sides):
        raise UsageError(f"--size {text}: expected WIDTHxHEIGHT, such as 1242x375.")
    width_px, height_px = map(int, sides)
    if max(width_px, height_px) > _MAX_SIDE_PX:
        raise UsageError(f"--size {text}: expected sides of at most {_MAX_SIDE_PX} px.")
    return width_px, height_px


convert_app = command(ConvertOptions, _convert)
show_app = command(ShowOptions, _show)
template_app = command(TemplateOptions, _template)
app = lazy_app(
    {
        "show": Lazy(
            "track_range.cli.commands.rig:show_app",
            "Show angles of view, baseline, and metres per pixel of disparity.",
            examples=(
                "track-range rig show rig.yaml",
                "track-range rig show calib.txt --size 1242x375",
            ),
        ),
        "template": Lazy(
            "track_range.cli.commands.rig:template_app",
            "Write a rig.yaml with the values that could be read from a file, and blanks for the "
            "rest.",
            examples=("track-range rig template calib.yml --out rig.yaml",),
        ),
        "check": Lazy(
            "track_range.cli.commands.align:check_app",
            "Measure the distance errors of a rig on a drive.",
            "The drive goes past static objects; no distance has to be known. `align` writes the "
            "correction.",
            ("track-range rig check --stereo left.mp4 right.mp4 --rig rig.yaml",),
        ),
        "convert": Lazy(
            "track_range.cli.commands.rig:convert_app",
            "Convert a calibration file to rig.yaml or OpenCV's stereo_calib.",
            examples=("track-range rig convert calib.txt rig.yaml --size 1242x375",),
        ),
    }
)

"""Calibrations with matrices or numbers by name, from OpenCV, scripts, data sets and programs.

    K1 D1 K2 D2 R T          x2 = R x1 + T; T has the unit of the chessboard's square size
    K1 D1 K2 D2 R1 R2 P1 P2  R = R2^T R1, T = R2^T (P2[0, 3] / P2[0, 0], 0, 0)
    P1 P2, or K and B        rectified images: B = -P2[0, 3] / P2[0, 0], or bf / fx

R and T are checked with the rest of the file: the right camera is to the right, R2 R R1^T = 1, |T|
= |P2[0, 3]| / f. (OpenCV, calib3d: stereoCalibrate and stereoRectify; MathWorks: stereoParameters,
cameraIntrinsicsToOpenCV.)
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted, shortened
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.lenses import KANNALA_BRANDT, PINHOLE
from track_range.stereo.geometry.rig import RigError, inverse_motion, rigid_motion
from track_range.stereo.geometry.rig_checks import RigCalibration
from track_range.stereo.rig_formats.rig_format import format_by_pattern
from track_range.stereo.rig_formats.values.cameras import (
    distortion_of,
    fisheye_of,
    of_scalars,
    size_px_of,
    stated_size,
)
from track_range.stereo.rig_formats.values.containers import (
    EXPECTED,
    K_AND_BASELINE,
    VIRTUAL_KITTI,
    plain_values,
)
from track_range.stereo.rig_formats.values.partners import is_second, other_half, partner_of
from track_range.stereo.rig_formats.values.quantities import (
    Quantities,
    Side,
    quantities_of,
    read_quantities,
)
from track_range.stereo.rig_formats.values.units import TOLERANCE, UNIT_NAMES, Unit, unit_of

Pair = tuple[Side, Side]


class Kind(NamedTuple):
    """A kind of file with values by name: how it is recognised, and what its files do not state."""

    name: str  # for messages and the table of formats
    title: str
    pattern: re.Pattern[str]  # in the text
    metres_per_unit: float | None = None  # of lengths; None = by their size
    size_px: tuple[int, int] = (0, 0)  # (width, height) of the images of all files of the kind
    assumption: str = ""  # for the note
    is_rectified: bool = False
    usual_unit: Unit | None = None  # of files that state none; None = by the lengths' size


_M = re.MULTILINE
KINDS = (
    Kind("middlebury", "Middlebury's calib.txt", re.compile(r"^cam0\s*=\s*\[", _M), 0.001, is_rectified=True),
    Kind("cityscapes", "Cityscapes' camera.json", re.compile(r'\A(?=[\s\S]*"baseline")[\s\S]*"u0"'), 1.0,
         (2048, 1024), "images of 2048x1024 px, the size of all Cityscapes images", is_rectified=True),
    Kind("foundation-stereo", "FoundationStereo's K.txt", K_AND_BASELINE, 1.0, is_rectified=True),
    Kind("virtual-kitti", "Virtual KITTI's intrinsic.txt", VIRTUAL_KITTI, 1.0, (1242, 375),
         "the baseline of Virtual KITTI 2 and its images of 1242x375 px", is_rectified=True),
    Kind("orb-slam", "ORB-SLAM's settings", re.compile(r"^(?:Camera1?\.fx|LEFT\.K)\s*:", _M), 1.0),
    Kind("matlab", "MATLAB's stereoParameters", re.compile("(?i)RotationOfCamera2|RadialDistortion"),
         usual_unit=Unit(0.001, "assuming millimetres, MATLAB's default")),
    Kind("realsense-json", "RealSense's intrinsics and extrinsics in JSON", re.compile(r'"(?:ppx|PPX)"'), 1.0),
    Kind("opencv", "the files of OpenCV's stereo_calib", re.compile("opencv-matrix|<opencv_storage>")),
    Kind("matrices", "matrices by name, K1 D1 K2 D2 R T", re.compile("")),
)  # fmt: skip
_EXTRINSIC = ("R", "T", "second_from_first", "first_from_second")


@dataclass(frozen=True, slots=True)
class _File:
    """A file of a kind, completed by files beside it."""

    kind: Kind
    path: Path
    given: Quantities
    beside: tuple[Path, ...]  # the files that complete it
    is_fisheye: bool
    is_depth_camera: bool  # whether its second camera is one of depth
    notes: tuple[str, ...]  # on the lens

    @property
    def title(self) -> str:
        """The kind and the other files, for messages."""
        if not self.beside:
            return self.kind.title
        return f"{self.kind.title} with {' and '.join(file.name for file in self.beside)}"

    @property
    def sides(self) -> list[Side]:
        """The sides of the cameras, one or two."""
        return self.given.sides()[:2] or [None]

    @property
    def pair(self) -> Pair:
        """The sides of both cameras; camera 2 follows a single one."""
        sides = self.sides
        return sides[0], sides[1] if len(sides) == 2 else 2

    @property
    def has_two_cameras(self) -> bool:
        """Whether two cameras are named."""
        return len(self.sides) == 2

    @property
    def has_extrinsics(self) -> bool:
        """Whether R or T, or a transform, is known."""
        return self.given.has(*_EXTRINSIC)

    def projections(self) -> list[FloatArray] | None:
        """The (3, 4) projection matrices of both rectified cameras; None if one is missing."""
        projections = [self.given.of(side, "P") for side in self.pair]
        if all(p is not None and p.size == 12 for p in projections):
            return [p.reshape(3, 4) for p in projections]
        return None


def read_kind(kind: Kind, text: str, path: Path, *, is_pair: bool) -> RigCalibration:
    """The cameras of a file of a kind; with the files beside it that complete a pair, if
    `is_pair`.
    """
    expected = "a calibration of OpenCV" if kind.name == "opencv" else EXPECTED
    stated = quantities_of(plain_values(text, path, expected), path)
    given, beside = _completed(stated, path, is_pair=is_pair)
    if not given.has("K", "fx", "P"):
        raise RigError(_unusable(given, path))
    side = (given.sides() or [None])[0]
    is_fisheye, notes = fisheye_of(given, side, path)
    file = _File(
        kind=kind,
        path=path,
        given=given,
        beside=tuple(beside),
        is_fisheye=is_fisheye,
        is_depth_camera="DepthMapFactor" in text,
        notes=notes,
    )
    if file.has_extrinsics and file.sides in ([2], ["right"]):
        raise _incomplete(given, ["M1"], path)
    return _rig_of(file)


def _rig_of(file: _File) -> RigCalibration:
    """The cameras by projection matrices, by a baseline, alone, or by R and T."""
    given = file.given
    projections = file.projections() if file.has_two_cameras else None
    has_matrices = any(given.of(side, "K") is not None for side in file.sides)
    if projections is not None and not has_matrices:
        return _of_projections(file, projections)
    left = _camera(file, 0)
    baseline = _baseline(file, left)
    if baseline is not None and not file.has_extrinsics and projections is None:
        return _of_baseline(file, left, baseline)
    if not file.has_extrinsics and not file.has_two_cameras:
        return RigCalibration(left, None, None, notes=file.notes)
    return _of_transform(file, left)


def _of_projections(file: _File, projections: Sequence[FloatArray]) -> RigCalibration:
    """The rectified cameras of two projection matrices (3, 4)."""
    first = PinholeCamera.of_matrix(projections[0], (0, 0))
    size_px = size_px_of(file.given, None, (first.cx_px, first.cy_px), file.path)
    cameras = [PinholeCamera.of_matrix(projection, size_px) for projection in projections]
    note = f"{file.path}: projection matrices P1 and P2"
    return _parallel(file, cameras, _offset(*projections), note, "rectified images")


def _baseline(file: _File, left: PinholeCamera) -> float | None:
    """The baseline in the unit of the file, stated or bf / fx; None if unknown, or that of a depth
    camera.
    """
    if file.is_depth_camera or (file.kind.name == "orb-slam" and any(left.distortion)):
        return None
    baseline, bf = file.given.of(None, "baseline"), file.given.of(None, "bf")
    if baseline is None and bf is not None:
        fx = file.given.of(None, "fx")
        baseline = bf / (left.fx_px if fx is None else fx)
    return None if baseline is None else abs(float(baseline[0]))


def _of_baseline(file: _File, left: PinholeCamera, baseline: float) -> RigCalibration:
    """The pair of parallel cameras with this baseline, in the unit of the file."""
    right = _camera(file, 1) if file.has_two_cameras else left
    is_rectified = file.kind.is_rectified or not left.is_distorted
    images = "rectified images" if is_rectified else "parallel cameras"
    notes = file.notes
    if file.kind.assumption:
        notes = (*notes, f"{file.path}: assumed: {file.kind.assumption}.")
    return _parallel(file, [left, right], -baseline, f"{file.path}: {file.title}", images, notes)


def _of_transform(file: _File, left: PinholeCamera) -> RigCalibration:
    """The pair of cameras by R and T."""
    path = file.path
    stated, notes = _motion(file)
    right = _camera(file, 1)
    length = float(np.linalg.norm(stated[:3, 3]))
    unit = _unit(file.kind, file.given, length)
    motion, contradictions = _checked_motion(file, stated)
    note = f"{path}: {file.title}: the baseline is {length * unit.metres:.4g} m, {unit.reason}."
    doubt = (
        f"{path}: expected T in metres, found one {length:.4g} long, which is wider than a "
        "vehicle; give its unit: rig convert FILE rig.yaml --unit mm, cm or m; or multiply T by "
        "the side of a square, if it counts squares of the board."
    )
    rig = RigCalibration(
        left,
        right,
        rigid_motion(motion[:3, :3], motion[:3, 3] * unit.metres),
        notes=(note, *file.notes, *notes, *contradictions),
        metres_per_unit=unit.metres,
        unit_doubt=doubt if unit.is_doubtful else "",
    )
    return _from_left_to_right(file, rig)


def _from_left_to_right(file: _File, rig: RigCalibration) -> RigCalibration:
    """The rig with its right camera to the right of the left one, and a note if the file has it on
    the left.
    """
    motion = rig.right_from_left
    first, second = file.pair
    if motion is None or rig.right is None or first is None:
        return rig
    if not motion[0, 3] > abs(motion[1, 3]):
        return rig
    if first == "left":
        note = (
            f"{file.path}: R and T put the right camera to the left of the left one, so they are "
            "read as the transform from the right camera to the left one; if the left and the "
            "right camera are swapped instead, swap them in the file."
        )
    else:
        rig = replace(rig, left=rig.right, right=rig.left)
        note = (
            f"{file.path}: by T, camera {second} is to the left of camera {first} (x2 = R x1 + T), "
            "so it is used as the left camera; if T is its position instead, swap the cameras in "
            "the file."
        )
    return replace(rig, right_from_left=inverse_motion(motion), notes=(*rig.notes, note))


def _completed(given: Quantities, path: Path, *, is_pair: bool) -> tuple[Quantities, list[Path]]:
    """The quantities, completed by files in the folder of `path`: extrinsics, intrinsics, other
    camera.
    """
    has_cameras = given.has("K", "fx")
    has_extrinsics = given.has(*_EXTRINSIC, "P", "baseline", "bf")
    is_single = has_cameras and len(given.sides()) < 2
    if has_extrinsics != has_cameras and (not is_single or "intrinsic" in path.stem):
        return _with_other_half(given, path, has_cameras=has_cameras)
    if is_pair and is_single and not has_extrinsics:
        partner = partner_of(path)
        if partner is not None:
            return _with_partner(path, partner)
    return given, []


def _with_other_half(
    given: Quantities, path: Path, *, has_cameras: bool
) -> tuple[Quantities, list[Path]]:
    """The quantities with those of the file of extrinsics, or of one or two files of intrinsics."""
    other = other_half(path, is_intrinsic=has_cameras)
    if other is None:
        return given, []
    merged = given | read_quantities(other)
    if has_cameras or len(merged.sides()) == 2:
        return merged, [other]
    partner = partner_of(other)
    if partner is None:
        return merged, [other]
    return given | _both(other, partner), [other, partner]


def _with_partner(path: Path, partner: Path) -> tuple[Quantities, list[Path]]:
    """The quantities of a camera's file and of the other camera's, and of a file of extrinsics."""
    left, right = (partner, path) if is_second(path) else (path, partner)
    both = _both(left, right)
    other = other_half(path, is_intrinsic=True)
    if other is None:
        return both, [partner]
    return both | read_quantities(other), [partner, other]


def _both(left: Path, right: Path) -> Quantities:
    return read_quantities(left).of_one_side("left") | read_quantities(right).of_one_side("right")


def _parallel(
    file: _File,
    cameras: Sequence[PinholeCamera],
    offset: float,
    note: str,
    images: str,
    notes: Sequence[str] = (),
) -> RigCalibration:
    """The pair of two parallel cameras; `offset` = -B in the unit of the file."""
    unit = _unit(file.kind, file.given, abs(offset))
    motion = rigid_motion(np.eye(3), [offset * unit.metres, 0.0, 0.0])
    note = f"{note}: the baseline is {abs(offset) * unit.metres:.5g} m, {unit.reason}; {images}."
    return RigCalibration(
        cameras[0], cameras[1], motion, notes=(note, *notes), metres_per_unit=unit.metres
    )


def _offset(first: FloatArray, second: FloatArray) -> float:
    """-B of two projection matrices, in the unit of the file."""
    return float(second[0, 3] / second[0, 0] - first[0, 3] / first[0, 0])


def _unit(kind: Kind, given: Quantities, length: float) -> Unit:
    """The unit of the lengths in a file; `length` is the baseline in that unit."""
    if kind.metres_per_unit is not None:
        name = UNIT_NAMES[kind.metres_per_unit]
        return Unit(kind.metres_per_unit, f"in {name} as in all such files")
    return unit_of(given, length, kind.usual_unit)


def _motion(file: _File) -> tuple[FloatArray, tuple[str, ...]]:
    """(4, 4) transform from the first camera's frame to the second's, in the unit of the file, and
    notes.
    """
    given, path = file.given, file.path
    stated = _stated_transform(given)
    if stated is not None:
        return stated, ()
    if (None, "T") not in given.values:
        if (file.pair[1], "T") in given.values:  # a pose of each camera
            first, second = (_pose(given, side, path) for side in file.pair)
            return np.asarray(second @ inverse_motion(first)), ()
        rectified = _motion_of_rectification(file)
        if rectified is not None:
            return rectified, (f"{path}: R and T are computed from R1, R2, P1 and P2.",)
    missing = _missing(file)
    if missing:
        raise _incomplete(given, missing, path)
    motion = _pose(given, None, path)
    return inverse_motion(motion) if given.of(None, "inverse") else motion, ()


def _stated_transform(given: Quantities) -> FloatArray | None:
    """The transform in a matrix of 4 x 4 or 3 x 4 numbers; None without one."""
    for quantity in ("second_from_first", "first_from_second"):
        numbers = given.of(None, quantity)
        if numbers is not None:
            rotation, translation = np.split(numbers.reshape(-1, 4)[:3], [3], axis=1)
            motion = rigid_motion(rotation, translation)
            return motion if quantity == "second_from_first" else inverse_motion(motion)
    return None


def _motion_of_rectification(file: _File) -> FloatArray | None:
    """R = R2^T R1, T = R2^T (-B, 0, 0); None without R1, R2, P1 and P2."""
    projections = file.projections()
    first, second = (file.given.of(side, "rect") for side in file.pair)
    if projections is None or first is None or second is None:
        return None
    r1, r2 = first.reshape(3, 3), second.reshape(3, 3)
    return rigid_motion(r2.T @ r1, r2.T @ [_offset(*projections), 0.0, 0.0])


def _missing(file: _File) -> list[str]:
    """Names of the matrices of a pair that the file lacks."""
    given, second = file.given, file.pair[1]
    missing = []
    for name, quantities in {"M2": ("K", "fx"), "D2": ("D", "radial", "k1")}.items():
        if not any((second, quantity) in given.values for quantity in quantities):
            missing.append(name)
    return [*missing, *(name for name in ("R", "T") if given.of(None, name) is None)]


def _incomplete(given: Quantities, missing: list[str], path: Path) -> RigError:
    return RigError(
        f"{path}: expected M2, D2, R, T of two cameras in this file or "
        f"intrinsics/extrinsics{path.suffix} in its folder, found no {', '.join(missing)}; give "
        "the complete calibration, one with M1 and D1 for one camera, or complete a track-range "
        f"rig template (keys found: {_listed(given.keys)})."
    )


def _pose(given: Quantities, side: Side, path: Path) -> FloatArray:
    """(4, 4) transform of R and T of a side; the identity for a camera without them."""
    rotation = given.values.get((side, "R"))
    if rotation is None:
        rotation = given.values.get((side, "rect"), np.eye(3))
    if rotation.size == 3:
        rotation = np.asarray(cv2.Rodrigues(rotation)[0])
    translation = given.values.get((side, "T"), np.zeros(3))
    return rigid_motion(_shaped(rotation, (3, 3), "R", path), _shaped(translation, (3,), "T", path))


def _checked_motion(file: _File, motion: FloatArray) -> tuple[FloatArray, list[str]]:
    """The transform of R and T, inverted if the rectification in the same file shows that, and
    notes on contradictions with it.
    """
    motion, notes = _checked_rotation(file, motion)
    p = file.given.values.get((file.pair[1], "P"))
    if p is None or p.size != 12 or not p[3]:
        return motion, notes
    length, projected = float(np.linalg.norm(motion[:3, 3])), abs(float(p[3] / p[0]))
    if abs(projected / max(length, 1e-9) - 1) > TOLERANCE:
        notes.append(
            f"{file.path}: |T| is {length:.4g}, but P2[0, 3] / f is {projected:.4g}; T is used."
        )
    return motion, notes


def _checked_rotation(file: _File, motion: FloatArray) -> tuple[FloatArray, list[str]]:
    """Comparison of R with R1 and R2: R2 R R1^T = 1."""
    values, (first, second) = file.given.values, file.pair
    rect1, rect2 = values.get((first, "rect")), values.get((second, "rect"))
    is_complete = (second, "P") in values and (None, "T") in values
    if rect1 is None or rect2 is None or not is_complete:
        return motion, []
    r1, r2 = rect1.reshape(3, 3), rect2.reshape(3, 3)
    rotation = motion[:3, :3]
    error, error_of_inverse = (
        float(np.abs(r2 @ either @ r1.T - np.eye(3)).max()) for either in (rotation, rotation.T)
    )
    if error <= TOLERANCE:
        return motion, []
    if error_of_inverse < TOLERANCE:
        note = (
            f"{file.path}: R and T are the transform from camera 2 to camera 1, by R1 and R2; "
            "they are inverted."
        )
        return inverse_motion(motion), [note]
    note = (
        f"{file.path}: R contradicts R1 and R2, which rectify another pair (R2 R R1^T differs from "
        f"the identity by {error:.2g}); R and T are used."
    )
    return motion, [note]


def _camera(file: _File, index: int) -> PinholeCamera:
    """The first (0) or second (1) camera."""
    side, number = file.pair[index], index + 1
    matrix = _camera_matrix(file, side, number)
    distortion = distortion_of(file.given, side)
    if distortion is None:
        is_baseline_known = bool({(None, "baseline"), (None, "bf")} & file.given.values.keys())
        if not file.kind.is_rectified and not is_baseline_known:
            name = file.given.names.get((side, "K"), f"M{number}")
            raise RigError(
                f"{file.path}: expected the distortion coefficients D{number} of the camera "
                f"{name}, found none; write zeros for undistorted images."
            )
        distortion = np.zeros(0)
    lens = KANNALA_BRANDT if file.is_fisheye and distortion.size == 4 else PINHOLE
    camera = PinholeCamera.of_matrix(matrix, (0, 0), distortion, lens)
    size_px = size_px_of(file.given, side, (camera.cx_px, camera.cy_px), file.path)
    width_px, height_px = size_px if size_px[0] else file.kind.size_px
    return replace(camera, width_px=width_px, height_px=height_px)


def _camera_matrix(file: _File, side: Side, number: int) -> FloatArray:
    """(3, 3) camera matrix, with pixels counted from 0."""
    name = file.given.names.get((side, "K"), f"M{number}")
    numbers = file.given.of(side, "K")
    if numbers is None:
        numbers = of_scalars(file.given, side)
    if numbers is None:
        raise _incomplete(file.given, [f"M{number}"], file.path)
    if numbers.size == 4:
        fx, fy, cx, cy = numbers
        numbers = np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1])
    matrix = _shaped(numbers, (3, 3), name, file.path).copy()
    # MATLAB's are transposed
    is_transposed = matrix[2, 0] and matrix[2, 1] and not (matrix[0, 2] or matrix[1, 2])
    if is_transposed:
        matrix = matrix.T.copy()
    if is_transposed or file.kind.name == "matlab":
        matrix[:2, 2] -= 1.0  # MATLAB counts pixels from 1
    if not np.array_equal(matrix[2], (0.0, 0.0, 1.0)):
        raise RigError(
            f"{file.path}: expected 0, 0, 1 in the last row of {name}, found "
            f"{quoted(matrix[2].tolist())}; give the camera matrix."
        )
    return matrix


def _shaped(values: FloatArray, shape: tuple[int, ...], name: str, path: Path) -> FloatArray:
    if values.size != np.prod(shape):
        raise RigError(
            f"{path}: expected {np.prod(shape)} numbers in {name}, found {values.size}; calibrate again."
        )
    return values.reshape(shape)


def camera_values(given: Quantities, number: int) -> dict[str, object]:
    """The values of the first or second camera that could be read, by key of rig.yaml."""
    values: dict[str, object] = {}
    sides = given.sides() or [None]
    if number >= len(sides):
        return values
    side = sides[number]
    focal = given.of(side, "K")
    if focal is None:
        focal = of_scalars(given, side)
    elif focal.size == 9:
        focal = focal[[0, 4, 2, 5]]
    centre = np.zeros(2)
    if focal is not None:
        values |= zip(("fx_px", "fy_px", "cx_px", "cy_px"), focal.tolist(), strict=False)
        centre = focal[2:4]
    size = stated_size(given, side, centre)
    if size is not None:
        values |= {"width_px": round(float(size[0])), "height_px": round(float(size[1]))}
    distortion = distortion_of(given, side)
    return values if distortion is None else values | {"distortion": distortion.tolist()}


def partial_motion(given: Quantities, path: Path) -> FloatArray | None:
    """(4, 4) transform of R and T alone, metres; None if one is missing, or the unit is in
    doubt.
    """
    if given.of(None, "R") is None or given.of(None, "T") is None:
        return None
    motion = _pose(given, None, path)
    unit = _unit(KINDS[-1], given, float(np.linalg.norm(motion[:3, 3])))
    if unit.is_doubtful:
        return None
    motion[:3, 3] *= unit.metres
    return motion


def _unusable(given: Quantities, path: Path) -> str:
    """The probable kind of a file without cameras, and advice."""
    keys = " ".join(given.keys).lower()
    advice = next((advice for pattern, advice in _SEEN if pattern.search(keys)), None) or (
        "expected the matrix M1 of a camera (or track_range_rig)",
        "track-range rig template FILE writes a rig.yaml with blanks",
    )
    seen = _listed(given.keys) or "none"
    return f"{path}: {advice[0]}, found the keys {seen}; {advice[1]}."


_SEEN = (
    (re.compile(r"stereo_?map|_map_?[xy]|map[lr12]?_?[xy]\b|remap|rectify_?map"), (
        "expected camera matrices, but this file seems to contain only remap tables",
        "give the file with M1, D1, M2, D2, R and T, or P1 and P2, of the same calibration",
    )),
    (re.compile(r"imagelist|images"), (
        "expected a calibration, but this file seems to list images for a calibration",
        "track-range calibrate --stereo 'left*.jpg' 'right*.jpg' --board 9x6 --square-mm 24 calibrates the cameras",
    )),
    (re.compile(r"\br\b|\bt\b"), (
        "expected the matrix M1 in this file or in an intrinsics file in its folder, but this file seems to contain "
        "only extrinsics",
        "give stereo_calib's intrinsics.yml beside it",
    )),
    (re.compile(r"controls-|param-|parameters\."), (
        "expected a calibration, but this file seems to contain RealSense's settings",
        "rs-enumerate-devices -c > rig.txt writes the calibration",
    )),
)  # fmt: skip


def _listed(keys: tuple[str, ...]) -> str:
    return shortened(", ".join(keys[:12]), 60)


FORMATS = {
    kind.name: format_by_pattern(
        kind.name,
        kind.title,
        kind.pattern,
        partial(read_kind, kind, is_pair=False),
        "M2, D2, R and T in this file or in intrinsics/extrinsics{suffix} in its folder",
        partial(read_kind, kind, is_pair=True),
    )
    for kind in KINDS
}

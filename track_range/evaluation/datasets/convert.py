"""Drives of data sets in the layout of recordings and truth that the evaluations read.

    NAME/000000.jpg ...     copies of the images, with times.txt; only of data with images
    calib/NAME.txt          rig.yaml of the camera, with its lens
    label_02/NAME.txt       KITTI tracking labels; box = outline of the projected cuboid
    label_shape/NAME.txt    the same rows; box = outline of the rounded body in the cuboid
    truth/NAME.csv          the boxes of label_shape with distance, visible share and closing speed
    poses/NAME.txt          3 x 4 matrix from the camera to the first camera in each row
    ego/NAME.csv            times, speed along the axis of the camera, and yaw rate

Boxes are of the images without lens distortion. A cuboid is moved from its own time to that of the
image with the mean velocity of its track over a second. Objects whose box is lower than 25 px are
left out.

    truncated    fraction of the outline outside of the image
    occluded     0, 1, 2, 3 from 0, 20, 50, 90 % of the visible box behind nearer cuboids, and 3
                 without a lidar point; what is no object of the labels hides nothing
"""

import shutil
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import are_valid_boxes
from track_range.evaluation.datasets import av2, kitti360, nuscenes, pandaset, tables
from track_range.evaluation.datasets.drive import DatasetError, LabelledDrive
from track_range.evaluation.motion.labelled_motion import camera_motion, track_slopes
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import check_regular, counted, shortened
from track_range.foundation.files.output_files import make_folder, write_text
from track_range.foundation.schemas.options import Options, option
from track_range.ranging.truth.label_classes import size_class_of
from track_range.ranging.truth.reference_distance import surface_distance_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.rig_formats.rig_yaml import save_camera

_READERS = {
    "av2": (av2.read, "ring_front_center"),
    "pandaset": (pandaset.read, "front_camera"),
    "kitti360": (kitti360.read, "image_00"),
    "nuscenes": (nuscenes.read, "CAM_FRONT"),
    "waymo-like": (tables.read, ""),
}
"""Reader and usual camera of each data set; "" = it has a single one."""

_TYPES = {"person": "Pedestrian", "bicycle": "Cyclist", "traffic sign": "", "traffic light": ""}
_OWN_TYPES = {
    **dict.fromkeys(
        ("LARGE_VEHICLE", "WHEELED_DEVICE", "VEHICULAR_TRAILER", "Towed Object"), "Misc"
    ),
    **dict.fromkeys(("vehicle.trailer", "trailer", "caravan"), "Misc"),
    **dict.fromkeys(("BICYCLE", "Bicycle"), "Bicycle"),
    **dict.fromkeys(("MOTORCYCLIST", "Motorcycle"), "Motorcycle"),
    **dict.fromkeys(
        ("vehicle.construction", "Other Vehicle - Construction Vehicle"), "Construction_vehicle"
    ),
    "Pedestrian with Object": "Pedestrian",
    "Pickup Truck": "Pickup",
    "Medium-sized Truck": "Truck",
    "rider": "Cyclist",
}
"""Types of labels that are not named as the road class, by this class, and by the class of the data
set where it says more; objects that are no road users are left out."""

_LABEL = "{} {} {} {:.2f} {} {:.4f}" + 11 * " {:.4f}"
_TRUTH_HEAD = "frame,id,class,x1,y1,x2,y2,distance_m,visible_share,closing_mps\n"
_TRUTH = "{},{},{}" + 7 * ",{:.3f}"
_EGO_HEAD = "frame,time_s,stored_time_s,speed_mps,speed_over_ground_mps,yaw_rate_rad_s\n"
_EGO = "{}" + 5 * ",{:.6f}"
_POSE = " ".join(12 * ["{:.7g}"])

_ROUNDNESS = 10.0  # exponent of the superellipsoid in a cuboid that is taken as the body
_NEAREST_M = 0.3  # depth from which points of a cuboid are projected
_MIN_HEIGHT_PX = 25.0
_MAX_CUBOIDS = 20_000  # that are projected at once
_OCCLUDED = (0.2, 0.5, 0.9)
_N_RAYS = 8  # in each direction, through a box
_STEPS = np.linspace(-1.0, 1.0, 7)
_LATTICE = np.stack(np.meshgrid(_STEPS, _STEPS, _STEPS), axis=-1).reshape(-1, 3)
# (P, 3) points of the surface of a cuboid in units of half its sizes, and of the body in it
_CUBOID = _LATTICE[np.abs(_LATTICE).max(axis=1) == 1.0]
_BODY = (
    _CUBOID
    / np.maximum((np.abs(_CUBOID) ** _ROUNDNESS).sum(axis=1) ** (1 / _ROUNDNESS), 1.0)[:, None]
)


class ConvertSettings(Options):
    """Data set, source and output of `track-range convert`."""

    data: Annotated[
        Literal["av2", "pandaset", "kitti360", "nuscenes", "waymo-like"],
        option("Data set.", metavar="NAME", is_argument=True),
    ]
    source: Annotated[
        Path,
        option(
            "Folder of a log (av2), of a sequence (pandaset), of the data set (kitti360, nuscenes), "
            "or of tables (waymo-like).",
            metavar="SOURCE",
            is_argument=True,
        ),
    ]
    out: Annotated[Path, option("Folder to write to.", metavar="OUT", is_argument=True)]
    camera: Annotated[
        str | None,
        option("Name of the camera in the data set (default: the front one).", metavar="NAME"),
    ] = None


def convert(settings: ConvertSettings) -> list[str]:
    """Write the drives of a data set, and return a sentence for each.

    Raises DatasetError: a file of the data set is missing or damaged; UsageError: a camera of data
    with a single one; OutputError: the output cannot be written.
    """
    read, usual = _READERS[settings.data]
    if settings.camera and not usual:
        raise UsageError(
            f"--camera {settings.camera}: expected no camera with {settings.data}, whose camera is "
            "that of rig.yaml."
        )
    drives = read(settings.source, settings.camera or usual)
    try:
        lines = [_written(drive, settings.out) for drive in drives]
    except (KeyError, IndexError, TypeError, ValueError) as error:
        raise DatasetError(
            f"{settings.source}: expected the files of {settings.data}, found other content "
            f"({shortened(repr(error))})."
        ) from error
    if not lines:
        raise DatasetError(
            f"{settings.source}: expected drives of {settings.data} with the camera "
            f"{settings.camera or usual}, found none."
        )
    return lines


def _written(drive: LabelledDrive, out: Path) -> str:
    """Write all files of a drive, the labels last, and say what they hold."""
    name, time_s, labels = drive.name, drive.time_s - drive.time_s[0], _labels(drive)
    at = (labels["frame"], labels["track"], labels["type"])
    if len(drive.images) not in (0, len(time_s)):
        raise DatasetError(
            f"{name}: expected an image for each of {len(time_s)} frames, or none, found "
            f"{len(drive.images)}."
        )
    for frame, image in enumerate(drive.images):
        check_regular(image, DatasetError, f"the image of frame {frame}")
        shutil.copyfile(image, _file(out, name, f"{frame:06d}{image.suffix}"))
    if drive.images:
        write_text(out / name / "times.txt", _text("{:.6f}", time_s))
    visible = (1 - labels["truncated"]) * (1 - labels["hidden"])
    columns = [*labels["label_shape"].T, labels["distance_m"], visible]
    truth = _text(_TRUTH, *at, *columns, labels["closing_mps"]).replace("nan", "")
    write_text(_file(out, "truth", f"{name}.csv"), _TRUTH_HEAD + truth)
    save_camera(drive.camera, _file(out, "calib", f"{name}.txt"))
    pose = (np.linalg.inv(drive.pose[0]) @ drive.pose)[:, :3]
    write_text(_file(out, "poses", f"{name}.txt"), _text(_POSE, *pose.reshape(-1, 12).T))
    speed_mps, right_mps, yaw_rad_s, _ = camera_motion(pose, time_s).T
    ground_mps = np.hypot(speed_mps, right_mps)
    rows = np.arange(len(time_s)), time_s, drive.time_s, speed_mps, ground_mps, -yaw_rad_s
    write_text(_file(out, "ego", f"{name}.csv"), _EGO_HEAD + _text(_EGO, *rows))
    for folder in ("label_02", "label_shape"):
        columns = [*at, labels["truncated"], labels["occluded"], labels["alpha_rad"]]
        columns += [*labels[folder].T, *labels["hwl_m"].T, *labels["bottom_m"].T, labels["yaw_rad"]]
        write_text(_file(out, folder, f"{name}.txt"), _text(_LABEL, *columns))
    n_objects = len(np.unique(labels["track"]))
    return (
        f"{name}: {counted(len(time_s), 'frame')}, {counted(len(labels['frame']), 'label')} of "
        f"{counted(n_objects, 'object')}, {counted(len(drive.images), 'image')}."
    )


def _text(pattern: str, *columns: Iterable[Any]) -> str:
    """A line for each row of the columns."""
    return "".join(pattern.format(*row) + "\n" for row in zip(*columns, strict=True))


def _file(out: Path, folder: str, name: str) -> Path:
    make_folder(out / folder)
    return out / folder / name


def _labels(drive: LabelledDrive) -> dict[str, npt.NDArray[Any]]:
    """Columns of the labels of the objects that an ideal camera without lens distortion shows, in
    the order of frames.
    """
    camera, frame = drive.camera.squared(), drive.frame
    track = np.unique(drive.track, return_inverse=True)[1].reshape(-1) + 1
    moved = drive.cuboid.copy()
    velocity_mps = track_slopes(track[None], drive.cuboid_s, moved[:, :3, 3])
    moved[:, :3, 3] += np.nan_to_num(velocity_mps) * (drive.time_s[frame] - drive.cuboid_s)[:, None]
    pose = np.linalg.inv(drive.pose)[frame] @ moved
    whole_px = _outline(camera, pose, drive.lwh_m, _CUBOID)
    last_px = np.array([camera.width_px, camera.height_px] * 2) - 1.0
    cuboid_px = np.clip(whole_px, 0.0, last_px)
    body_px = np.clip(_outline(camera, pose, drive.lwh_m - drive.padding_m, _BODY), 0.0, last_px)
    area, whole_area = (np.prod(px[:, 2:] - px[:, :2], axis=1) for px in (cuboid_px, whole_px))
    front, bottom_m = pose[:, :3, 0], pose[:, :3, 3] - pose[:, :3, 2] * drive.lwh_m[:, 2:] / 2
    yaw_rad = np.arctan2(-front[:, 2], front[:, 0])
    labels: dict[str, npt.NDArray[Any]] = {
        "frame": frame,
        "track": track,
        "type": np.array([_type_of(kind) for kind in drive.kind], np.str_),
        "label_02": cuboid_px,
        "label_shape": body_px,
        "truncated": 1 - area / np.maximum(whole_area, 1e-9),
        "n_points": drive.n_points,
        "hwl_m": drive.lwh_m[:, ::-1],
        "bottom_m": bottom_m,
        "yaw_rad": yaw_rad,
        "alpha_rad": np.angle(np.exp(1j * (yaw_rad - np.arctan2(*bottom_m[:, [0, 2]].T)))),
        "closing_mps": -track_slopes(track[None], drive.cuboid_s, pose[:, 2, 3:])[:, 0],
    }
    rows = np.flatnonzero((area > 0) & (pose[:, 2, 3] > 0) & are_valid_boxes(body_px))
    rows = rows[np.lexsort((track[rows], frame[rows]))]
    labels = {name: values[rows] for name, values in labels.items()}
    body_px = labels["label_shape"]
    rays = camera.rays((body_px[:, :2] + body_px[:, 2:]) / 2)
    hidden = _hidden_fractions(camera, labels)
    labels["hidden"], labels["distance_m"] = hidden, _surface_m(rays, labels, np.arange(len(rays)))
    labels["occluded"] = np.where(labels["n_points"] == 0, 3, np.digitize(hidden, _OCCLUDED))
    is_high = labels["label_02"][:, 3] - labels["label_02"][:, 1] >= _MIN_HEIGHT_PX
    kept = is_high & (labels["type"] != "") & ~(labels["n_points"] < drive.min_points)
    return {name: values[kept] for name, values in labels.items()}


def _type_of(kind: str) -> str:
    """The type of labels of a class of a data set; "" = it is left out."""
    name = size_class_of(kind)
    return _OWN_TYPES.get(kind, _TYPES.get(name, name.capitalize()))


def _outline(
    camera: PinholeCamera, pose: FloatArray, lwh_m: FloatArray, points: FloatArray
) -> FloatArray:
    """(N, 4) boxes around the points (P, 3) of N objects that are in front of the camera."""
    if len(pose) > _MAX_CUBOIDS:  # not all at once, since P is 218
        parts = np.array_split(np.arange(len(pose)), len(pose) // _MAX_CUBOIDS + 1)
        return np.concatenate([_outline(camera, pose[k], lwh_m[k], points) for k in parts])
    placed_m = (points * lwh_m[:, None] / 2) @ pose[:, :3, :3].transpose(0, 2, 1) + pose[
        :, None, :3, 3
    ]
    z_m = placed_m[:, :, 2:]
    ratio = placed_m[:, :, :2] / np.where(z_m > _NEAREST_M, z_m, np.nan)
    px = ratio * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
    ends = [np.fmin.reduce(px, axis=1), np.fmax.reduce(px, axis=1)]
    return np.asarray(np.nan_to_num(np.concatenate(ends, axis=1), nan=-1.0))


def _surface_m(rays: FloatArray, labels: Mapping[str, FloatArray], rows: IntArray) -> FloatArray:
    """(M,) depth at which each ray meets the cuboid in the row (M,)."""
    bottom_m, size_hwl_m, yaw_rad = (labels[key][rows] for key in ("bottom_m", "hwl_m", "yaw_rad"))
    return surface_distance_m(rays, bottom_m, size_hwl_m=size_hwl_m, rotation_y_rad=yaw_rad)


def _hidden_fractions(camera: PinholeCamera, labels: Mapping[str, FloatArray]) -> FloatArray:
    """(N,) fractions of the rays through the boxes that meet another cuboid of the frame first."""
    frame, boxes_px = labels["frame"], labels["label_02"]
    hidden = np.zeros(len(frame))
    steps = (np.arange(_N_RAYS) + 0.5) / _N_RAYS
    grid = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    by_frame = np.split(np.arange(len(frame)), np.flatnonzero(np.diff(frame)) + 1)
    for rows in filter(len, by_frame):
        n, low, high = len(rows), boxes_px[rows, None, :2], boxes_px[rows, None, 2:]
        rays = np.repeat(camera.rays((low + grid * (high - low)).reshape(-1, 2)), n, axis=0)
        depth_m = _surface_m(rays, labels, np.tile(rows, n * len(grid))).reshape(n, len(grid), n)
        own_m = depth_m[np.arange(n), :, np.arange(n)]
        is_first = np.fmin.reduce(depth_m, axis=2) < own_m - 1e-6
        hidden[rows] = is_first.sum(axis=1) / np.maximum(np.isfinite(own_m).sum(axis=1), 1)
    return hidden

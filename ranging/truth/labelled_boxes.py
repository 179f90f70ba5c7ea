"""BoxSet: labelled boxes of many drives with their true distances, as parallel arrays, without
video.

The true distance is the z at which the ray through the label's box centre first meets its 3-D box,
in the frame of the left colour camera (`ranging.truth.reference_distance`). Labels are used if
they have a 3-D box at 5-100 m, are not truncated, have occluded <= 1 and a type with a size class
(`label_classes`). Boxes come from the labels, possibly with added noise, or from a detector; the
true distance is always the distance in the label.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import are_valid_boxes, iou
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.detection_files import read_detections
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.formats.video_labels.kitti import (
    KittiLabels,
    read_kitti,
    read_kitti_image,
)
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.files.input_files import first_line, quoted, read_text
from track_range.ranging.truth import reference_distance
from track_range.ranging.truth.errors import BANDS_M, MIN_IOU
from track_range.ranging.truth.frame_times import FrameTimes, TimeSource, frame_times
from track_range.ranging.truth.label_classes import (
    SIZE_CLASS_ORDER,
    not_counted_notes,
    size_classes_of,
)
from track_range.ranging.truth.truth import MAX_OCCLUDED, surface_of_labels_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.rig_formats.reading import left_from_reference_m, load_camera

# road class that a detector reports for other classes
DETECTED_CLASS_OF: Mapping[str, str] = {"van": "car"}
MIN_SCORE = 0.5  # smallest confidence of detections that are used
# largest difference of alpha from -pi/2, and lateral offset, of a rear view
REAR_VIEW_RAD, REAR_VIEW_M = 0.25, 10.0
# KITTI type by folder of RRC detections
_RRC_TYPE: Mapping[str, str] = {"Car": "Car", "Pedestrian": "Pedestrian"}
_MIN_SIZE_PX = 1.0  # smallest width and height of a box after noise was added
# of KITTI object labels, without and with a score; tracking labels have 17 or 18
_OBJECT_COLUMNS = (15, 16)
# KITTI, 26, 28, 29, 30 September, 3 October 2011, by focal length
_IMAGE_SIZE_PX: Mapping[float, tuple[int, int]] = {
    721.5377: (1242, 375),
    707.0493: (1224, 370),
    718.3351: (1238, 374),
    707.0912: (1226, 370),
    718.856: (1241, 376),
}
_MAX_FOCAL_DIFFERENCE_PX = 1e-3  # largest difference of focal lengths that count as equal
# number of groups of images that serve as sequences for object labels, which have none
_OBJECT_GROUPS = 10
_UNUSED = f"none is at {BANDS_M[0]:g}-{BANDS_M[-1]:g} m, not truncated, occluded <= {MAX_OCCLUDED}"


@dataclass(frozen=True, slots=True)
class BoxSet:
    """Labelled boxes, one row per object and frame, ordered by sequence and frame."""

    sequence_names: tuple[str, ...]  # names of the sequences
    sequence: IntArray  # (N,) index into `sequence_names`
    frame: IntArray  # (N,) frame number
    time_s: FloatArray  # (N,) seconds from the sequence's first frame
    track_id: IntArray  # (N,) identity of the object, unique within a sequence
    kitti_type: npt.NDArray[np.str_]  # (N,) type of the label, as in the file
    class_name: npt.NDArray[np.str_]  # (N,) size class (`label_classes`), that of the results
    xyxy_px: FloatArray  # (N, 4) box to measure: that of the label, with noise, or detected
    fxycxy_px: FloatArray  # (N, 4) fx, fy, cx, cy of the camera
    # (N, 2) width and height of the image, from the camera, or estimated from the boxes
    size_px: IntArray
    distance_m: FloatArray  # (N,) true distance
    alpha_rad: FloatArray  # (N,) observation angle: -pi/2 = seen from behind
    x_m: FloatArray  # (N,) lateral offset
    # (N, 3) bottom centre of the 3-D box in the frame of the left camera; NaN = no 3-D box
    location_m: FloatArray
    size_hwl_m: FloatArray  # (N, 3) height, width, length of the 3-D box; NaN = no 3-D box
    rotation_y_rad: FloatArray  # (N,) yaw of the 3-D box; NaN = no 3-D box
    occluded: IntArray  # (N,) 0 = fully visible, 1 = partly occluded
    # (N,) distance by `BoxSelection.reference`; None = `distance_m`
    reference_m: FloatArray | None = None
    notes: tuple[str, ...] = ()  # boxes that are not counted, and the origin of the times

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, rows: BoolArray | IntArray) -> BoxSet:
        """The boxes selected by a mask or an index array."""
        columns = {name: getattr(self, name) for name in _columns()}
        return replace(
            self, **{name: column[rows] for name, column in columns.items() if column is not None}
        )

    def with_reference(self) -> BoxSet:
        """The boxes with their reference distances as `distance_m`."""
        return self if self.reference_m is None else replace(self, distance_m=self.reference_m)

    @classmethod
    def without_3d_boxes(cls, **columns: Any) -> BoxSet:
        """Boxes from the columns of a table without 3-D boxes, with unknown orientation and
        occlusion.
        """
        n = len(columns["frame"])
        nan, occluded = np.full(n, np.nan), np.zeros(n, np.int64)
        size_hwl_m = np.full((n, 3), np.nan)
        return cls(
            **columns,
            alpha_rad=nan,
            x_m=nan,
            location_m=size_hwl_m,
            size_hwl_m=size_hwl_m,
            rotation_y_rad=nan,
            occluded=occluded,
        )

    @property
    def time_step_s(self) -> float | None:
        """Median time between two frames of a sequence in s; None = one frame each."""
        steps = np.diff(np.stack([self.sequence, self.frame, self.time_s]), axis=1)
        steps = steps[:, (steps[0] == 0) & (steps[1] > 0)]
        return round(float(np.median(steps[2] / steps[1])), 6) if steps.shape[1] else None

    @property
    def wh_over_f(self) -> FloatArray:
        """(N, 2) width / fx and height / fy."""
        return np.asarray((self.xyxy_px[:, 2:] - self.xyxy_px[:, :2]) / self.fxycxy_px[:, :2])

    @property
    def bearing(self) -> FloatArray:
        """(N,) tangent of the horizontal angle between the box centre and the camera's axis."""
        centre_px = (self.xyxy_px[:, 0] + self.xyxy_px[:, 2]) / 2
        return np.asarray((centre_px - self.fxycxy_px[:, 2]) / self.fxycxy_px[:, 0])

    @property
    def is_rear_view(self) -> BoolArray:
        """(N,) whether the object is seen from behind with a small lateral offset."""
        angle_rad = np.abs(np.angle(np.exp(1j * (self.alpha_rad + np.pi / 2))))
        return np.asarray((angle_rad < REAR_VIEW_RAD) & (np.abs(self.x_m) < REAR_VIEW_M))

    @property
    def class_id(self) -> IntArray:
        """(N,) road class that a detector reports for each box; vans are cars."""
        names = [DETECTED_CLASS_OF.get(str(name), str(name)) for name in self.class_name]
        return np.array([ROAD_CLASSES.index(name) for name in names], np.int64)

    def camera_at(self, row: int) -> PinholeCamera:
        """The camera of the box `row`."""
        fx, fy, cx, cy = self.fxycxy_px[row].tolist()
        width, height = self.size_px[row].tolist()
        return PinholeCamera(fx, fy, cx, cy, width, height)

    def with_noise(self, noise_px: float, *, seed: int) -> BoxSet:
        """Boxes with Gaussian noise on every edge, at least 1 px wide and high."""
        noisy = self.xyxy_px + np.random.default_rng(seed).normal(0.0, noise_px, self.xyxy_px.shape)
        centre, size = (
            (noisy[:, :2] + noisy[:, 2:]) / 2,
            np.maximum(noisy[:, 2:] - noisy[:, :2], _MIN_SIZE_PX),
        )
        return replace(self, xyxy_px=np.concatenate([centre - size / 2, centre + size / 2], axis=1))


@dataclass(frozen=True, slots=True, kw_only=True)
class BoxSelection:
    """Labels that are used, and their reference distance."""

    # file of names of label files, one per line, such as a published split; None = all
    frames: Path | None = None
    # whether labels that are truncated, occluded or outside 5-100 m are used too
    has_all_objects: bool = False
    # definition of the distance (`reference_distance`)
    reference: reference_distance.ReferenceName = "surface"
    velodyne: Path | None = None  # folder of lidar files NAME.bin, for the reference "lidar"
    times: TimeSource | None = None  # None = as `frame_times` finds them


def _columns() -> list[str]:
    """Names of the columns of a `BoxSet`, whose first axis is the rows."""
    names = [field.name for field in fields(BoxSet)]
    return [name for name in names if name not in ("sequence_names", "notes")]


def box_set(
    labels: Path,
    calib: Path,
    *,
    boxes: str = "labels",
    noise_px: float = 0.0,
    seed: int = 0,
    selection: BoxSelection | None = None,
) -> BoxSet:
    """Boxes of KITTI tracking labels (NAME.txt per sequence) or object labels (a file per image),
    with calibration.

    Both may be a single file; `calib` has calibration files of the same names, or is the file of all
    sequences. `boxes` are "labels", or "rrc:DIR" for
    detections DIR/Car/NAME.txt and DIR/Pedestrian/NAME.txt, matched to labels. `noise_px` is the
    standard deviation of noise added to every edge. Without `selection`, visible objects at 5-100 m
    of all files are used. Raises LabelFileError for no files, no 3-D boxes, no usable labels, or
    unreadable detections; RigError for a missing or unreadable calibration.
    """
    files = sorted(file for file in labels.glob("*.txt") if not file.name.startswith("."))
    if labels.is_file():
        files = [labels]
    if not files:
        raise LabelFileError(f"{labels}: expected label files such as 0000.txt, found none.")
    selection = selection or BoxSelection()
    if selection.frames is not None:
        files = _listed(files, selection.frames, labels)
    sequences = [_sequence(file, file_in(calib, file.name), boxes, selection) for file in files]
    if not any(sequence.has_3d for sequence in sequences):
        raise LabelFileError(
            f"{labels}: expected KITTI labels with 3-D boxes, found no label with a 3-D box."
        )
    usable = replace(
        _concatenated([sequence.boxes for sequence in sequences], files), notes=_notes(sequences)
    )
    if not len(usable):
        raise LabelFileError(
            f"{labels}: found no usable label; expected {', '.join(SIZE_CLASS_ORDER)} at "
            f"{BANDS_M[0]:g}-{BANDS_M[-1]:g} m, not truncated, occluded <= "
            f"{MAX_OCCLUDED}{'' if boxes == 'labels' else ', with a matching detection'}."
        )
    return usable.with_noise(noise_px, seed=seed) if noise_px > 0 else usable


def _listed(files: Sequence[Path], frames: Path, labels: Path) -> list[Path]:
    """The label files whose names are in the list `frames`, in the order of the files."""
    names = read_text(frames, LabelFileError, "a list of frames").split()
    if missing := sorted(set(names) - {file.stem for file in files}):
        raise LabelFileError(
            f"{frames}: expected names of label files of {labels}, one per line, found "
            f"{quoted(missing[0])}."
        )
    if not names:
        raise LabelFileError(
            f"{frames}: expected names of label files, one per line, found an empty file."
        )
    listed = set(names)
    return [file for file in files if file.stem in listed]


def file_in(place: Path, name: str) -> Path:
    """The file of a sequence: in a folder, or the given file."""
    return place if place.is_file() else place / name


def times_of(file: Path, calib: Path, source: TimeSource | None) -> FrameTimes:
    """Times of the frames of a label file, whose calibration is in `calib` (`file_in`)."""
    return _times(file, load_camera(file_in(calib, file.name), size_px=None)[0], source)


def _times(file: Path, camera: PinholeCamera, source: TimeSource | None) -> FrameTimes:
    return frame_times(file, is_kitti=_kitti_size_px(camera) is not None, source=source)


class _Sequence(NamedTuple):
    """Usable boxes of one file, as sequence 0."""

    boxes: BoxSet
    has_3d: bool  # whether any label of the file has a 3-D box
    label_types: Sequence[str]  # (N,) types of all labels
    is_counted: BoolArray  # (N,) whether they are usable
    times: FrameTimes | None  # None = separate images


def _notes(sequences: Sequence[_Sequence]) -> tuple[str, ...]:
    """The time step of each origin, and the types of labels that are not counted."""
    clocks = [sequence.times for sequence in sequences if sequence.times is not None]
    steps = {clock.origin: clock.step_s for clock in clocks}
    times = "; ".join(f"{step_s:.4g} s ({origin})" for origin, step_s in steps.items())
    return (
        *([f"Time step: {times}."] if times else []),
        *not_counted_notes(
            [label_type for sequence in sequences for label_type in sequence.label_types],
            np.concatenate([sequence.is_counted for sequence in sequences]),
            _UNUSED,
        ),
    )


def _sequence(file: Path, calib: Path, boxes: str, selection: BoxSelection) -> _Sequence:
    n_columns = len(first_line(file, LabelFileError, "KITTI labels").split())
    labels = read_kitti_image(file) if n_columns in (0, *_OBJECT_COLUMNS) else read_kitti(file)
    camera, _ = load_camera(calib, size_px=None)
    shift_m = left_from_reference_m(calib, is_grey=False)
    times = _times(file, camera, selection.times)
    box_set = _rows(labels, camera, shift_m, times)
    box_set = box_set if boxes == "labels" else _detected(box_set, labels, file.name, boxes)
    if selection.reference == "centre":
        box_set = replace(
            box_set, reference_m=reference_distance.centre_distance_m(labels, shift_m)
        )
    elif selection.reference == "lidar" and selection.velodyne is not None:
        points_m = reference_distance.read_lidar(selection.velodyne / f"{file.stem}.bin", calib)
        box_set = replace(
            box_set, reference_m=reference_distance.lidar_distance_m(labels, points_m, shift_m)
        )
    distance_m = box_set.with_reference().distance_m
    in_span = (distance_m >= BANDS_M[0]) & (distance_m <= BANDS_M[-1])
    is_visible = (
        (labels.truncated == 0) & (labels.occluded >= 0) & (labels.occluded <= MAX_OCCLUDED)
    )
    is_chosen = distance_m > 0 if selection.has_all_objects else in_span & is_visible
    is_usable = is_chosen & labels.has_3d_box & are_valid_boxes(box_set.xyxy_px)
    rows = np.flatnonzero(is_usable & (box_set.class_name != ""))
    is_sequence = bool((labels.track_id >= 0).any())
    return _Sequence(
        box_set.select(rows[np.argsort(labels.frame[rows], kind="stable")]),
        bool(labels.has_3d_box.any()),
        labels.kitti_type.tolist(),
        is_usable & (box_set.class_name != ""),
        times if is_sequence else None,
    )


def _rows(
    labels: KittiLabels, camera: PinholeCamera, shift_m: FloatArray, times: FrameTimes
) -> BoxSet:
    """All labels of a file, usable or not."""
    n = len(labels)
    location_m = labels.location_m
    return BoxSet(
        sequence_names=("",),
        sequence=np.zeros(n, np.int64),
        frame=labels.frame,
        time_s=times.at(labels.frame),
        track_id=labels.track_id,
        kitti_type=labels.kitti_type,
        class_name=np.array(size_classes_of(labels.kitti_type.tolist()), np.str_),
        xyxy_px=labels.xyxy_px,
        fxycxy_px=np.tile([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px], (n, 1)),
        size_px=np.tile(_image_size_px(labels, camera), (n, 1)),
        distance_m=surface_of_labels_m(labels, camera, shift_m),
        alpha_rad=labels.rotation_y_rad - np.arctan2(location_m[:, 0], location_m[:, 2]),
        x_m=location_m[:, 0],
        size_hwl_m=labels.size_hwl_m,
        rotation_y_rad=labels.rotation_y_rad,
        occluded=labels.occluded,
        location_m=location_m + shift_m,
    )


def _kitti_size_px(camera: PinholeCamera) -> tuple[int, int] | None:
    """Image size of the camera of KITTI that has this focal length; None = no camera of KITTI."""
    for focal_px, size_px in _IMAGE_SIZE_PX.items():
        if abs(camera.fx_px - focal_px) < _MAX_FOCAL_DIFFERENCE_PX:
            return size_px
    return None


def _image_size_px(labels: KittiLabels, camera: PinholeCamera) -> IntArray:
    """(2,) width and height of the image: of the camera, of KITTI, or the smallest that contains
    the labels.
    """
    if camera.width_px > 0:
        return np.array([camera.width_px, camera.height_px])
    if (size_px := _kitti_size_px(camera)) is not None:
        return np.array(size_px)
    objects_px = labels.xyxy_px[labels.kitti_type != "DontCare"]  # regions end one pixel farther
    extent_px = np.ceil(np.max(objects_px[:, 2:], axis=0, initial=0.0)).astype(np.int64) + 1
    return np.asarray(np.maximum(extent_px, [round(2 * camera.cx_px), round(2 * camera.cy_px)]))


def _detected(box_set: BoxSet, labels: KittiLabels, name: str, boxes: str) -> BoxSet:
    """All labels of a file with the boxes of matching detections; NaN = no match."""
    form, _, folder = boxes.partition(":")
    if form != "rrc" or not folder:
        raise LabelFileError(f"--boxes {boxes}: expected labels or rrc:DIR.")
    xyxy_px = np.full((len(box_set), 4), np.nan)
    for subfolder, kitti_type in _RRC_TYPE.items():
        path = Path(folder) / subfolder / name
        if not path.parent.is_dir():
            raise LabelFileError(
                f"{path.parent}: no such folder; rrc:DIR requires DIR/Car and DIR/Pedestrian."
            )
        if not os.path.lexists(path):
            continue  # a sequence without detections
        recorded = read_detections(path, form="rrc")
        is_confident = recorded.detections.score >= MIN_SCORE
        detections = recorded.detections.select(is_confident)
        row, detection = greedy_matches(
            (labels.frame, labels.xyxy_px),
            (recorded.frame[is_confident], detections.xyxy_px),
            score=detections.score,
        )
        is_type = labels.kitti_type[row] == kitti_type
        xyxy_px[row[is_type]] = detections.xyxy_px[detection[is_type]]
    return replace(box_set, xyxy_px=xyxy_px)


def greedy_matches(
    labels: tuple[IntArray, FloatArray],
    detections: tuple[IntArray, FloatArray],
    *,
    score: FloatArray,
) -> tuple[IntArray, IntArray]:
    """Row indices of matching labels and detections: in the order of confidence, each to the free
    label of highest IoU.

    `labels` are (N,) frames and (N, 4) boxes of any type, so that the detection of an occluded or
    ignored object is not matched to its neighbour; `detections` are (M,) frames and (M, 4) boxes
    with the scores (M,).
    """
    pairs: list[tuple[int, int]] = []
    for number in np.intersect1d(labels[0], detections[0]):
        rows, indices = np.flatnonzero(labels[0] == number), np.flatnonzero(detections[0] == number)
        indices = indices[np.argsort(-score[indices], kind="stable")]
        overlap = iou(detections[1][indices], labels[1][rows])
        for i, detection in enumerate(indices):
            best = int(np.argmax(overlap[i]))
            if overlap[i, best] >= MIN_IOU:
                pairs.append((int(rows[best]), int(detection)))
                overlap[:, best] = -1.0
    matches = np.array(pairs, np.int64).reshape(-1, 2)
    return matches[:, 0], matches[:, 1]


def _concatenated(parts: Sequence[BoxSet], files: Sequence[Path]) -> BoxSet:
    """All sequences as one set; images with object labels form ten groups, since their drives are
    unknown.
    """
    is_images = len(parts) > 1 and all((part.track_id < 0).all() for part in parts)
    names = (
        tuple(f"group-{k}" for k in range(_OBJECT_GROUPS))
        if is_images
        else tuple(file.stem for file in files)
    )
    numbers = [k * _OBJECT_GROUPS // len(parts) if is_images else k for k in range(len(parts))]
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in _columns()
        if name != "sequence" and getattr(parts[0], name) is not None
    }
    if is_images:
        columns["frame"] = np.concatenate([np.full(len(part), k) for k, part in enumerate(parts)])
    sequence = np.concatenate(
        [np.full(len(part), k) for part, k in zip(parts, numbers, strict=True)]
    )
    return BoxSet(sequence_names=names, sequence=sequence, **columns)

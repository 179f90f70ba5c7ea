"""BoxSet: labelled boxes of many drives with their true distances, as parallel arrays, without any video.

Truth is the z at which the ray through the label's box centre first meets its 3-D box, from the left colour camera
(`ranging.evaluation.box_surface`); labels are shifted into its frame. Kept are boxes with a 3-D box at 5-100 m, not
truncated, occluded <= 1, of the five labelled kinds: Van is a kind of its own here, although its road class may be car
or truck. The box itself may then be blurred by pixel noise or be a detector's; the truth stays the label's.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import are_valid_boxes, iou
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.detection_files import read_detections
from track_range.detection.formats.kitti import KittiLabels, LabelFileError, read_kitti, read_kitti_image
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.evaluation.errors import BANDS_M, MIN_IOU
from track_range.ranging.evaluation.truth import MAX_OCCLUDED, surface_of_labels_m
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.rig_formats.reading import left_from_reference_m, load_camera

CLASS_OF: Mapping[str, str] = {
    "Car": "car",
    "Van": "van",
    "Truck": "truck",
    "Pedestrian": "person",
    "Cyclist": "bicycle",
}
"""KITTI types that are measured, and what their figures are called."""

ROAD_CLASS_OF_KIND: Mapping[str, str] = {"van": "car"}
"""Kinds that are no road class, and the one that a detector takes them for."""

FRAME_STEP_S = 0.1036
"""Mean step of KITTI's frames in the tracking drives; their labels carry no times."""

MIN_SCORE = 0.5
"""Weaker detections are left out."""

REAR_VIEW_RAD, REAR_VIEW_M = 0.25, 10.0
"""An object is seen from behind when alpha is this near -pi/2 and its lateral offset is smaller than that."""

_RRC_TYPE: Mapping[str, str] = {"Car": "Car", "Pedestrian": "Pedestrian"}
_MIN_SIZE_PX = 1.0
_OBJECT_COLUMNS = (15, 16)
_OBJECT_GROUPS = 10


@dataclass(frozen=True, slots=True)
class BoxSet:
    """Labelled boxes, one row per object and frame, ordered by sequence and frame.

    Attributes:
        sequence_names: S names.
        sequence: (N,) index into them.
        frame: (N,) frame number.
        time_s: (N,) seconds from the sequence's first frame.
        track_id: (N,) the label's identity, unique within a sequence.
        kitti_type: (N,) the label's own word.
        class_name: (N,) what its figures are called: car, van, truck, person, bicycle.
        xyxy_px: (N, 4) the box to measure from: the label's, or a noisy or detected one.
        fxycxy_px: (N, 4) fx, fy, cx, cy of the camera.
        size_px: (N, 2) width and height of the image, as far as known from camera or boxes.
        distance_m: (N,) truth.
        alpha_rad: (N,) observation angle: -pi/2 = seen from behind.
        x_m: (N,) lateral offset.
        size_hwl_m: (N, 3) height, width, length of the 3-D box; NaN where there is none.
        rotation_y_rad: (N,) its yaw; NaN where there is none.
        occluded: (N,) 0 = fully visible, 1 = partly hidden.
    """

    sequence_names: tuple[str, ...]
    sequence: IntArray
    frame: IntArray
    time_s: FloatArray
    track_id: IntArray
    kitti_type: npt.NDArray[np.str_]
    class_name: npt.NDArray[np.str_]
    xyxy_px: FloatArray
    fxycxy_px: FloatArray
    size_px: IntArray
    distance_m: FloatArray
    alpha_rad: FloatArray
    x_m: FloatArray
    size_hwl_m: FloatArray
    rotation_y_rad: FloatArray
    occluded: IntArray

    def __len__(self) -> int:
        return len(self.frame)

    def select(self, keep: BoolArray | IntArray) -> BoxSet:
        """The rows that a mask or an index array names."""
        rows = (getattr(self, field.name)[keep] for field in fields(self)[1:])
        return BoxSet(self.sequence_names, *rows)

    @property
    def wh_over_f(self) -> FloatArray:
        """(N, 2) width / fx and height / fy."""
        return np.asarray((self.xyxy_px[:, 2:] - self.xyxy_px[:, :2]) / self.fxycxy_px[:, :2])

    @property
    def bearing(self) -> FloatArray:
        """(N,) tangent of the box centre's angle from the camera's axis in x."""
        centre_px = (self.xyxy_px[:, 0] + self.xyxy_px[:, 2]) / 2
        return np.asarray((centre_px - self.fxycxy_px[:, 2]) / self.fxycxy_px[:, 0])

    @property
    def is_rear_view(self) -> BoolArray:
        """(N,) seen from behind and not far to the side."""
        off_rad = np.abs(np.angle(np.exp(1j * (self.alpha_rad + np.pi / 2))))
        return np.asarray((off_rad < REAR_VIEW_RAD) & (np.abs(self.x_m) < REAR_VIEW_M))

    @property
    def class_id(self) -> IntArray:
        """(N,) road class that a detector would give each box (a van is a car)."""
        names = [ROAD_CLASS_OF_KIND.get(str(name), str(name)) for name in self.class_name]
        return np.array([ROAD_CLASSES.index(name) for name in names], np.int64)

    def camera_at(self, row: int) -> PinholeCamera:
        """The camera that saw a row."""
        fx, fy, cx, cy = self.fxycxy_px[row].tolist()
        width, height = self.size_px[row].tolist()
        return PinholeCamera(fx, fy, cx, cy, width, height)

    def with_noise(self, noise_px: float, *, seed: int) -> BoxSet:
        """The same objects, every edge of their boxes moved by normal noise; no box gets thinner than a pixel."""
        noisy = self.xyxy_px + np.random.default_rng(seed).normal(0.0, noise_px, self.xyxy_px.shape)
        middle, size = (noisy[:, :2] + noisy[:, 2:]) / 2, np.maximum(noisy[:, 2:] - noisy[:, :2], _MIN_SIZE_PX)
        return replace(self, xyxy_px=np.concatenate([middle - size / 2, middle + size / 2], axis=1))


def box_set(labels: Path, calib: Path, *, boxes: str = "labels", noise_px: float = 0.0, seed: int = 0) -> BoxSet:
    """Read KITTI tracking labels (NAME.txt per sequence), or object labels (a file per image), with their calibration.

    Args:
        labels: folder of label files.
        calib: folder of calib files of the same names.
        boxes: "labels", or "rrc:DIR" for detections DIR/Car/NAME.txt and DIR/Pedestrian/NAME.txt, matched to labels.
        noise_px: standard deviation of noise added to every edge.
        seed: of the noise.

    Raises:
        LabelFileError: no files, none with a 3-D box, nothing to measure, or detections that cannot be read.
        RigError: a calibration is missing or cannot be read.
    """
    files = sorted(file for file in labels.glob("*.txt") if not file.name.startswith("."))
    if not files:
        raise LabelFileError(f"{labels}: expected label files such as 0000.txt, found none.")
    found = [_sequence(file, calib / file.name, boxes) for file in files]
    if not any(has_3d for _, has_3d in found):
        raise LabelFileError(f"{labels}: expected KITTI labels with 3-D boxes, found no label with a 3-D box.")
    whole = _joined([part for part, _ in found], files)
    if not len(whole):
        raise LabelFileError(
            f"{labels}: found no usable label; expected {', '.join(CLASS_OF)} at {BANDS_M[0]:g}-{BANDS_M[-1]:g} m, "
            f"not truncated, occluded <= {MAX_OCCLUDED}{'' if boxes == 'labels' else ', with a matching detection'}."
        )
    return whole.with_noise(noise_px, seed=seed) if noise_px > 0 else whole


def _sequence(file: Path, calib: Path, boxes: str) -> tuple[BoxSet, bool]:
    """One file's boxes, as sequence 0, and whether any label has a 3-D box."""
    labels = _labels_in(file)
    camera, _ = load_camera(calib, size_px=None)
    shift_m = left_from_reference_m(calib, is_grey=False)
    every = _rows(labels, camera, shift_m)
    every = every if boxes == "labels" else _detected(every, labels, file.name, boxes)
    span = (every.distance_m >= BANDS_M[0]) & (every.distance_m <= BANDS_M[-1])
    seen = (labels.truncated == 0) & (labels.occluded >= 0) & (labels.occluded <= MAX_OCCLUDED) & labels.has_3d_box
    keep = np.flatnonzero(span & seen & are_valid_boxes(every.xyxy_px) & (every.class_name != ""))
    return every.select(keep[np.argsort(labels.frame[keep], kind="stable")]), bool(labels.has_3d_box.any())


def _labels_in(file: Path) -> KittiLabels:
    """A tracking file, or the object labels of one image."""
    try:
        with file.open(encoding="utf-8-sig") as lines:
            n_columns = len(next((line.split() for line in lines if line.strip()), []))
    except (OSError, UnicodeDecodeError) as error:
        raise LabelFileError(f"{file}: cannot be read as text ({type(error).__name__}).") from error
    return read_kitti_image(file) if n_columns in (0, *_OBJECT_COLUMNS) else read_kitti(file)


def _rows(labels: KittiLabels, camera: PinholeCamera, shift_m: FloatArray) -> BoxSet:
    """Every label as a row, whether it is measured or not."""
    n = len(labels)
    location_m = labels.location_m
    extent_px = np.ceil(np.max(labels.xyxy_px[:, 2:], axis=0, initial=0.0)).astype(np.int64) + 1
    middle_px = np.array([round(2 * camera.cx_px), round(2 * camera.cy_px)])
    size_px = np.array([camera.width_px, camera.height_px])
    return BoxSet(
        sequence_names=("",),
        sequence=np.zeros(n, np.int64),
        frame=labels.frame,
        time_s=labels.frame.astype(np.float64) * FRAME_STEP_S,
        track_id=labels.track_id,
        kitti_type=labels.kitti_type,
        class_name=np.array([CLASS_OF.get(str(word), "") for word in labels.kitti_type], np.str_),
        xyxy_px=labels.xyxy_px,
        fxycxy_px=np.tile([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px], (n, 1)),
        size_px=np.tile(np.where(size_px > 0, size_px, np.maximum(extent_px, middle_px)), (n, 1)),
        distance_m=surface_of_labels_m(labels, camera, shift_m),
        alpha_rad=labels.rotation_y_rad - np.arctan2(location_m[:, 0], location_m[:, 2]),
        x_m=location_m[:, 0],
        size_hwl_m=labels.size_hwl_m,
        rotation_y_rad=labels.rotation_y_rad,
        occluded=labels.occluded,
    )


def _detected(every: BoxSet, labels: KittiLabels, name: str, boxes: str) -> BoxSet:
    """The labels with the boxes of the detections that match them; NaN boxes where none does."""
    form, _, folder = boxes.partition(":")
    if form != "rrc" or not folder:
        raise LabelFileError(f"--boxes {boxes}: expected labels or rrc:DIR.")
    xyxy_px = np.full((len(every), 4), np.nan)
    for word, kitti_type in _RRC_TYPE.items():
        path = Path(folder) / word / name
        if not path.parent.is_dir():
            raise LabelFileError(f"{path.parent}: no such folder; rrc:DIR requires DIR/Car and DIR/Pedestrian.")
        if not path.is_file() or not path.read_text(encoding="utf-8-sig").strip():
            continue  # nothing was found in this sequence
        recorded = read_detections(path, form="rrc")
        strong = recorded.detections.score >= MIN_SCORE
        found = recorded.detections.select(strong)
        row, detection = greedy_matches(
            (labels.frame, labels.xyxy_px), (recorded.frame[strong], found.xyxy_px), score=found.score
        )
        right = labels.kitti_type[row] == kitti_type
        xyxy_px[row[right]] = found.xyxy_px[detection[right]]
    return replace(every, xyxy_px=xyxy_px)


def greedy_matches(
    labels: tuple[IntArray, FloatArray], detections: tuple[IntArray, FloatArray], *, score: FloatArray
) -> tuple[IntArray, IntArray]:
    """Rows of labels and of detections that belong together: the strongest detection takes its best free label first.

    Args:
        labels: (N,) frame and (N, 4) box of every label, of whatever type, so that a detection of a hidden or ignored
            object is not taken for its neighbour's.
        detections: (M,) frame and (M, 4) box.
        score: (M,) of the detections.
    """
    pairs: list[tuple[int, int]] = []
    for number in np.intersect1d(labels[0], detections[0]):
        rows, found = np.flatnonzero(labels[0] == number), np.flatnonzero(detections[0] == number)
        found = found[np.argsort(-score[found], kind="stable")]
        overlap = iou(detections[1][found], labels[1][rows])
        for one, detection in enumerate(found):
            best = int(np.argmax(overlap[one]))
            if overlap[one, best] >= MIN_IOU:
                pairs.append((int(rows[best]), int(detection)))
                overlap[:, best] = -1.0
    both = np.array(pairs, np.int64).reshape(-1, 2)
    return both[:, 0], both[:, 1]


def _joined(parts: Sequence[BoxSet], files: Sequence[Path]) -> BoxSet:
    """Sequences as one set; object labels, an image each, become ten groups: nothing says which drive is which."""
    is_images = len(parts) > 1 and all((part.track_id < 0).all() for part in parts)
    names = tuple(f"group-{k}" for k in range(_OBJECT_GROUPS)) if is_images else tuple(file.stem for file in files)
    numbers = [k * _OBJECT_GROUPS // len(parts) if is_images else k for k in range(len(parts))]
    columns = {
        field.name: np.concatenate([getattr(part, field.name) for part in parts]) for field in fields(BoxSet)[2:]
    }
    if is_images:
        columns["frame"] = np.concatenate([np.full(len(part), k) for k, part in enumerate(parts)])
    sequence = np.concatenate([np.full(len(part), k) for part, k in zip(parts, numbers, strict=True)])
    return BoxSet(sequence_names=names, sequence=sequence, **columns)

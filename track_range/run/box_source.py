"""Source of the boxes of a run: a detector network, a detector object, or a file of recorded
detections.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import numpy.typing as npt

from track_range.detection.box_errors import BoxErrors, box_errors_of
from track_range.detection.boxes import are_valid_boxes, area_px2
from track_range.detection.classes import ROAD_CLASSES, road_class_ids
from track_range.detection.detections import Detections
from track_range.detection.detector import DetectorError, ObjectDetector, checked_detections
from track_range.detection.fixed_parts import FixedParts
from track_range.detection.formats.detection_files import RecordedDetections, read_detections
from track_range.detection.formats.tables.box_table import VideoFacts
from track_range.detection.yolo.detector import YoloDetector
from track_range.detection.yolo.far_pass import FarPass
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted
from track_range.recording.cameras.calibration import RecordingCalibration
from track_range.recording.recording import Recording
from track_range.run.options.detection import MASK_SUFFIXES, DetectionOptions
from track_range.run.options.opened import DetectorOptions, class_names, open_detector
from track_range.run.options.settings import RunSettings
from track_range.stereo.geometry.frames import Frame

# smallest fraction of a recorded box inside the undistorted image of a wide lens that is used
_MIN_SHOWN = 0.5
# fraction of the area of a box in the regions of --ignore above which it is dropped
_MOST_INSIDE = 0.5

CANDIDATE_SCORE = np.where(np.isin(ROAD_CLASSES, ("person", "bicycle")), 0.02, 0.1)
"""(8,) minimum confidence of the candidates for anonymization by road class: low for people, since
the regions of false detections are small, and the default of tracking for vehicles."""


@dataclass(frozen=True, slots=True)
class BoxSource:
    """Detection stage of a run.

    `candidates` returns all boxes of the frame of the latest detection, also with low scores and of
    classes that are not tracked, for anonymization. `prepare` writes a frame into the network's
    input, and returns the function that detects its boxes, which another thread may call; None =
    there is no such input.
    """

    detect: Callable[[Frame], Detections]
    candidates: Callable[[Frame], Detections]
    description: dict[str, Any]  # for the section `found` of settings.yaml
    notes: Callable[[], tuple[str, ...]]  # messages for the user so far
    prepare: Callable[[Frame], Callable[[], Detections]] | None = None
    box_errors: BoxErrors | None = None  # systematic errors of the boxes; None = unknown
    # what never moves in the images, on which a detector finds no road user; None = recorded boxes
    fixed_parts: FixedParts | None = None
    # adds far road users, and learns where they are; None = there is none
    far_pass: FarPass | None = None
    # (M,) numbers of those with recorded boxes
    frames: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))


def open_box_source(
    settings: RunSettings,
    recording: Recording,
    ready_model: Callable[[str], Path],
    opened: Callable[[Path, DetectorOptions], YoloDetector] = open_detector,
) -> BoxSource:
    """The detector or the recorded detections of the settings.

    `ready_model` returns the file of a model by name or path, downloading it first if necessary.
    ModelError, DownloadError, LabelFileError: the detector or the file cannot be used;
    ClassNameError: a class is unknown.
    """
    class_id = tuple(int(i) for i in road_class_ids(settings.classes))
    if settings.detections is not None:
        return _recorded(
            settings.detections, class_id, recording, class_names(settings.names) or ()
        )
    return network_source(settings, ready_model, opened)


def network_source(
    settings: DetectionOptions,
    ready_model: Callable[[str], Path],
    opened: Callable[[Path, DetectorOptions], YoloDetector],
) -> BoxSource:
    """The detector of the settings; see `open_box_source`."""
    path = ready_model(settings.detector or "")
    network = opened(path, DetectorOptions.of(settings))
    description = {
        "file": path.name,
        "sha256": network.session.sha256(),
        "family": network.model.family,
        "names": list(network.model.names),
        "device": network.session.device,
        "box_errors": network.model.attributes["box_errors"].source,
    }
    far_pass = FarPass(network, settings.far_pass_every)

    def prepared(frame: Frame) -> Callable[[], Detections]:
        detect = network.prepared(frame.left)
        return lambda: far_pass.completed(detect(), frame.left, frame.time_s)

    return BoxSource(
        detect=lambda frame: prepared(frame)(),
        candidates=lambda frame: network.candidates(CANDIDATE_SCORE),
        description={"detector": description},
        notes=lambda: (*network.notes, *far_pass.notes),
        box_errors=network.box_errors,
        fixed_parts=FixedParts(),
        prepare=prepared,
        far_pass=far_pass,
    )


def boxes_of(detector: ObjectDetector) -> BoxSource:
    """Source of the boxes of a detector object with `detect(image)`, and optionally `notes` and
    `box_errors`.

    DetectorError: invalid `box_errors`; raised by `detect`: the object returns no valid
    `Detections`.
    """
    last, errors = Detections.empty(), getattr(detector, "box_errors", None)
    try:
        box_errors = None if errors is None else box_errors_of(errors)
    except ValueError as error:
        raise DetectorError(f"{class_name(detector)}, box_errors: {error}.") from error

    def detect(frame: Frame) -> Detections:
        nonlocal last
        last = checked_detections(detector, frame.left, frame.index)
        return last

    return BoxSource(
        detect=detect,
        candidates=lambda frame: last,
        description={"detector": {"class": class_name(detector)}},
        notes=lambda: tuple(getattr(detector, "notes", ())),
        box_errors=box_errors,
        fixed_parts=FixedParts(),
    )


def outside_regions(
    source: BoxSource, regions: str | None, calibration: RecordingCalibration
) -> BoxSource:
    """The source without the boxes that are mostly in the regions of `--ignore`; None = no regions.

    UsageError: the regions are neither polygons nor a mask image of the size of the video.
    """
    if regions is None:
        return source
    detect, prepare = source.detect, source.prepare
    mask = region_mask(regions, calibration.sizes_px[0])
    area_px = cv2.integral(mask).astype(np.int64)  # (H + 1, W + 1) of the regions up to a pixel

    def outside(detections: Detections) -> Detections:
        recorded_px = calibration.rectifier.recorded_boxes(detections.xyxy_px)
        return detections.select(_fraction_inside(area_px, recorded_px) <= _MOST_INSIDE)

    def prepared(
        prepare: Callable[[Frame], Callable[[], Detections]], frame: Frame
    ) -> Callable[[], Detections]:
        detect_prepared = prepare(frame)
        return lambda: outside(detect_prepared())

    outside_prepared = None if prepare is None else partial(prepared, prepare)
    return replace(source, detect=lambda frame: outside(detect(frame)), prepare=outside_prepared)


def remembered(source: BoxSource) -> tuple[Callable[[Frame], Detections], BoxSource]:
    """Detection of frames that are read before a run, and a source for the run that detects no
    frame again.

    The frames of both have the same numbers and images.
    """
    kept: dict[int, Detections] = {}

    def detect_before(frame: Frame) -> Detections:
        return kept.setdefault(frame.index, source.detect(frame))

    def detect(frame: Frame) -> Detections:
        return kept.pop(frame.index) if frame.index in kept else source.detect(frame)

    def prepared(
        prepare: Callable[[Frame], Callable[[], Detections]], frame: Frame
    ) -> Callable[[], Detections]:
        return partial(kept.pop, frame.index) if frame.index in kept else prepare(frame)

    prepare = None if source.prepare is None else partial(prepared, source.prepare)
    return detect_before, replace(source, detect=detect, prepare=prepare)


def region_mask(regions: str, size_px: tuple[int, int]) -> Image:
    """(H, W) uint8, 1 in the regions: polygons `x,y x,y x,y / ...` in pixels of the video, or a
    mask's bright part.
    """
    width, height = size_px
    expected = (
        "--ignore (Python ignore): expected polygons 'x,y x,y x,y / ...' in pixels, or a mask "
        f"image of the size of the video, {width}x{height} px"
    )
    if Path(regions).suffix.lower() in MASK_SUFFIXES:
        mask = _bright_part(regions, size_px, expected)
    else:
        mask = np.zeros((height, width), np.uint8)
        for text in regions.split("/"):
            cv2.fillPoly(mask, [_polygon_px(text, expected)], 1)
    if not mask.any():
        raise UsageError(f"{expected}, found no pixel of the image in {quoted(regions)}.")
    return mask


def _bright_part(name: str, size_px: tuple[int, int], expected: str) -> Image:
    """(H, W) uint8, 1 where the mask image of this name is bright."""
    image = cv2.imread(name, cv2.IMREAD_GRAYSCALE) if Path(name).is_file() else None
    if image is None:
        raise UsageError(f"{expected}, found no readable image {quoted(name)}.")
    found_px = image.shape[1], image.shape[0]
    if found_px != size_px:
        raise UsageError(
            f"{expected}, found one of {found_px[0]}x{found_px[1]} px, {quoted(name)}."
        )
    return np.asarray(image > 127, np.uint8)


def _polygon_px(text: str, expected: str) -> npt.NDArray[np.int32]:
    """(N, 2) int32 corners of a polygon `x,y x,y x,y`, at least three."""
    try:
        points = np.array([[float(value) for value in point.split(",")] for point in text.split()])
        if points.shape[0] < 3 or points.shape[1] != 2 or not (np.abs(points) < 1e5).all():
            raise ValueError("no polygon")
    except (ValueError, IndexError):
        raise UsageError(f"{expected}, found {quoted(text.strip())}.") from None
    return np.asarray(np.rint(points), np.int32)


def _fraction_inside(area_px: IntArray, xyxy_px: FloatArray) -> FloatArray:
    """(N,) fraction of the area of boxes within the image that is in the regions."""
    height, width = area_px.shape[0] - 1, area_px.shape[1] - 1
    # pixel i runs from i - 0.5
    edges = np.clip(np.nan_to_num(xyxy_px) + 0.5, 0, [width, height, width, height])
    x1, y1, x2, y2 = np.rint(edges).astype(np.int64).T
    inside = area_px[y2, x2] - area_px[y1, x2] - area_px[y2, x1] + area_px[y1, x1]
    fraction: FloatArray = inside / np.maximum((x2 - x1) * (y2 - y1), 1)
    return fraction


def class_name(value: object) -> str:
    """The class of an object as module:Class."""
    return f"{type(value).__module__}:{type(value).__qualname__}"


def _recorded(
    path: Path, class_id: tuple[int, ...], recording: Recording, names: tuple[str, ...]
) -> BoxSource:
    # MOTChallenge files have no classes: a single one in --classes applies, else person, as in
    # MOTChallenge
    default_class_id = class_id[0] if len(class_id) == 1 else 0
    video = VideoFacts(
        n_frames=recording.n_total, size_px=recording.calibration.sizes_px[0], names=names
    )
    recorded = read_detections(path, default_class_id=default_class_id, video=video)
    if not recorded.is_rectified:
        recorded = _rectified(recorded, recording)

    def detect(frame: Frame) -> Detections:
        detections = recorded.at(frame.index)
        return detections.select(np.isin(detections.class_id, class_id)) if class_id else detections

    return BoxSource(
        detect=detect,
        candidates=lambda frame: recorded.at(frame.index),
        frames=np.unique(recorded.frame),
        description={"detections": path.name},
        notes=lambda: recorded.notes,
    )


def _rectified(recorded: RecordedDetections, recording: Recording) -> RecordedDetections:
    """The boxes in rectified pixels; boxes of a wide lens are cut at the edges of the undistorted
    images.
    """
    xyxy_px = recording.calibration.rectifier.left_boxes(recorded.detections.xyxy_px)
    rows = np.flatnonzero(are_valid_boxes(xyxy_px))  # those behind the view are NaN
    xyxy_px = xyxy_px[rows]
    # whose undistorted images do not show all recorded boxes
    if recording.calibration.has_wide_lens:
        cut_px = np.clip(xyxy_px, 0.0, np.tile(np.array(recording.size_px, np.float64) - 1, 2))
        is_shown = area_px2(cut_px) / area_px2(xyxy_px) >= _MIN_SHOWN
        rows, xyxy_px = rows[is_shown], cut_px[is_shown]
    boxes = replace(recorded.detections.select(rows), xyxy_px=xyxy_px)
    return replace(recorded, frame=recorded.frame[rows], detections=boxes)

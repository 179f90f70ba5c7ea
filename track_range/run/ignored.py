"""Regions of the image without detections (`--ignore`), such as the bonnet and overlay text; a note proposes them."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.foundation.errors import UsageError
from track_range.foundation.files.input_files import quoted
from track_range.recording.cameras.calibration import RecordingCalibration
from track_range.results.columns import Columns, boxes_px
from track_range.run.box_source import BoxSource
from track_range.stereo.geometry.frames import Frame

_MOST = 0.5  # fraction of the area of a box in regions above which it is dropped
_MIN_SPEED_MPS, _MIN_SPAN_S, _MIN_FRAMES = 3.0, 10.0, 50  # of a drive with boxes that do not move
_STILL, _EDGE = 0.001, 0.15  # standard deviation of the edges of such a box in image widths; its zone in image heights


def outside_regions(source: BoxSource, regions: str | None, calibration: RecordingCalibration) -> BoxSource:
    """The source without the boxes that are mostly in the regions of `--ignore`; None = no regions.

    UsageError: the regions are neither polygons nor a mask image of the size of the video.
    """
    if regions is None:
        return source
    detect, prepare = source.detect, source.prepare
    area_px = cv2.integral(region_mask(regions, calibration.sizes_px[0])).astype(
        np.int64
    )  # (H + 1, W + 1) of the regions up to a pixel

    def outside(detections: Detections) -> Detections:
        return detections.select(_fraction(area_px, calibration.rectifier.recorded_boxes(detections.xyxy_px)) <= _MOST)

    def prepared(frame: Frame) -> Callable[[], Detections]:
        assert prepare is not None  # noqa: S101 - for mypy
        detect_prepared = prepare(frame)
        return lambda: outside(detect_prepared())

    return replace(source, detect=lambda frame: outside(detect(frame)), prepare=None if prepare is None else prepared)


def region_mask(regions: str, size_px: tuple[int, int]) -> Image:
    """(H, W) uint8, 1 in the regions: polygons `x,y x,y x,y / ...` in pixels of the video, or a mask's bright part."""
    width, height = size_px
    expected = (
        "--ignore (Python ignore): expected polygons 'x,y x,y x,y / ...' in pixels, or a mask image of the size of the "
        f"video, {width}x{height} px"
    )
    if Path(regions).suffix.lower() in (".png", ".bmp", ".jpg", ".jpeg"):
        image = cv2.imread(regions, cv2.IMREAD_GRAYSCALE) if Path(regions).is_file() else None
        if image is None:
            raise UsageError(f"{expected}, found no readable image {quoted(regions)}.")
        if image.shape != (height, width):
            raise UsageError(f"{expected}, found one of {image.shape[1]}x{image.shape[0]} px, {quoted(regions)}.")
        mask = (image > 127).astype(np.uint8)
    else:
        mask = np.zeros((height, width), np.uint8)
        for text in regions.split("/"):
            try:
                points = np.array([[float(value) for value in point.split(",")] for point in text.split()])
                if points.shape[0] < 3 or points.shape[1] != 2 or not (np.abs(points) < 1e5).all():
                    raise ValueError("no polygon")
            except (ValueError, IndexError):
                raise UsageError(f"{expected}, found {quoted(text.strip())}.") from None
            cv2.fillPoly(mask, [np.rint(points).astype(np.int32)], 1)
    if not mask.any():
        raise UsageError(f"{expected}, found no pixel of the image in {quoted(regions)}.")
    return mask


def _fraction(area_px: IntArray, xyxy_px: FloatArray) -> FloatArray:
    """(N,) fraction of the area of boxes within the image that is in the regions."""
    height, width = area_px.shape[0] - 1, area_px.shape[1] - 1
    edges = np.clip(np.nan_to_num(xyxy_px) + 0.5, 0, [width, height, width, height])  # pixel i runs from i - 0.5
    x1, y1, x2, y2 = np.rint(edges).astype(np.int64).T
    inside = area_px[y2, x2] - area_px[y1, x2] - area_px[y2, x1] + area_px[y1, x1]
    fraction: FloatArray = inside / np.maximum((x2 - x1) * (y2 - y1), 1)
    return fraction


def still_boxes_note(columns: Columns, calibration: RecordingCalibration) -> tuple[str, ...]:
    """A note that proposes `--ignore` for tracks at an edge of the image that do not move in it while the car drives.

    A vehicle ahead at a constant distance is not at an edge, and moves by the pitch of the car.
    """
    width, height = calibration.sizes_px[0]
    rows = np.flatnonzero((columns["ego_mps"] >= _MIN_SPEED_MPS) & (columns["observed"] > 0))
    box, time_s = calibration.rectifier.recorded_boxes(boxes_px(columns)[rows]), columns["time_s"][rows]
    track, first, group, n = np.unique(columns["track_id"][rows], True, True, True)
    last = np.zeros(len(track), np.int64)
    last[group] = np.arange(len(rows))
    mean, square = (np.stack([np.bincount(group, edge) / n for edge in values.T], axis=1) for values in (box, box**2))
    deviation = np.sqrt(np.maximum(square - mean**2, 0)).max(axis=1)
    at_edge = (mean[:, 3] > (1 - _EDGE) * height) | (mean[:, 1] < _EDGE * height)
    is_long = (time_s[last] - time_s[first] >= _MIN_SPAN_S) & (n >= _MIN_FRAMES)
    still = np.flatnonzero((deviation < _STILL * width) & at_edge & is_long)[:3]
    if not len(still):
        return ()
    corners = np.rint(mean[still]).astype(int)
    polygons = " / ".join(f"{x1},{y1} {x2},{y1} {x2},{y2} {x1},{y2}" for x1, y1, x2, y2 in corners)
    return (
        f"Track {', '.join(f'{name:g}' for name in track[still])} did not move in the image while the car drove. If it "
        f"is the bonnet, or text in the image, drop its boxes with --ignore '{polygons}' (Python ignore).",
    )

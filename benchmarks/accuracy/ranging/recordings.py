"""Kinds of recordings and calibrations: recognised, values right, and distances against the same
drive in plain form.

The kinds are those of the tests (`RECORDINGS`, `CALIBRATIONS`). A recording is a simulated drive in
another form; its boxes are those of the ground truth, and the distances of the stereo matcher are
compared with those of the drive in folders of PNGs with its own rig. A calibration is that of
another pair: points at 5 to 60 m are projected with the true cameras and triangulated with those
that are read.
"""

from __future__ import annotations

import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import partial
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import track_range as tr
from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import CACHE_OPTION, decoded
from tests.support.recordings.calibration_files import CALIBRATIONS, Calibration, differences
from tests.support.recordings.recording_files import RECORDINGS, Pair, Recording, live
from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray
from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_rig

SEED, SECONDS, SIZE_PX = 3, 1.2, (620, 188)  # of the drive, scenario town
FARTHEST_M, SMALLEST_PX = 40.0, 12.0  # distance, and height of the boxes that are ranged
N_LIVE = 6  # frames of live sources
VALUE, DISTANCE_PCT = 1e-6, 1.0  # largest error of values, and median error of distances
TIME_MS = 1.0  # largest error of times since the first frame
SPACE_M = np.stack(
    np.meshgrid((-3.0, 0.0, 4.0), (-1.0, 0.5), (5.0, 10.0, 20.0, 40.0, 60.0)), axis=-1
).reshape(-1, 3)
"""(30, 3) points in the frame of the left camera."""


@workload(
    option("--only", default="", metavar="TEXT", help="kinds with this text in their names"),
    CACHE_OPTION,
)
def recordings(options: Namespace) -> Figures:
    """Whether each kind of recording and calibration is read, with the right values and
    distances.
    """
    folder = options.cache / f"recordings_{SEED}"
    if not (folder / "rig.yaml").exists():
        rig = kitti_like_rig(width_px=SIZE_PX[0], height_px=SIZE_PX[1])
        write_drive(folder, scenario="town", seed=SEED, seconds=SECONDS, rig=rig)
    drive = Plain(folder)
    figures: dict[str, dict[str, Any]] = {"recordings": {}, "calibrations": {}}
    with ExitStack() as servers:
        streams = [
            Recording("live stream, side by side", partial(live, servers=servers), rate_hz=0.0)
        ]
        for recording in (*RECORDINGS, *streams):
            if options.only in recording.kind:
                figures["recordings"][recording.kind] = _attempt(partial(drive.compared, recording))
    for calibration in CALIBRATIONS:
        if options.only in calibration.kind:
            figures["calibrations"][calibration.kind] = _attempt(partial(_read, calibration))
    counts = {name: [row["right"] for row in rows.values()] for name, rows in figures.items()}
    return {
        **figures,
        "right": {name: f"{sum(right)} of {len(right)}" for name, right in counts.items()},
    }


def _attempt(measure: Callable[[Path], Figures]) -> Figures:
    """Figures of a kind in a new folder, or the sentence with which it is refused; "right" = all
    within the limits.
    """
    start_s = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        try:
            row = measure(Path(folder))
        except tr.errors.UserError as error:
            row = {"right": False, "said": str(error).replace(folder, "").strip("/")[:200]}
        except (TypeError, OSError, RuntimeError, ValueError) as error:
            row = {
                "right": False,
                "said": f"{type(error).__name__}: {error}".replace(folder, "")[:200],
            }
    return {**row, "s": round(time.monotonic() - start_s, 1)}


def _thumbnail(image: Any) -> FloatArray:
    grey = np.asarray(image if image.ndim == 2 else image.mean(axis=2), np.float64)
    return np.asarray(cv2.resize(grey, (155, 47), interpolation=cv2.INTER_AREA), np.float64)


class Plain:
    """A simulated drive, and the stereo distances of its boxes by frame, from folders of PNGs."""

    def __init__(self, folder: Path) -> None:
        self.rig_path = folder / "rig.yaml"
        self.pair = Pair(decoded(folder / "left.mp4"), decoded(folder / "right.mp4"))
        self._thumbnails = [_thumbnail(image) for image in self.pair.left]
        rows = [
            line.split() for line in (folder / "truth.txt").read_text(encoding="utf-8").splitlines()
        ]
        self._boxes = [self._boxes_of(rows, frame) for frame in range(len(self.pair.left))]
        with tempfile.TemporaryDirectory() as plain:
            _, self._distances_m = self._read(RECORDINGS[0], Path(plain))

    @staticmethod
    def _boxes_of(rows: Sequence[Sequence[str]], frame: int) -> tr.Tracks:
        """KITTI's columns: frame, id, type, three others, x1, y1, x2, y2, three sizes, x, y, z."""
        kept = [
            row for row in rows
            if int(row[0]) == frame and row[2] == "Car" and float(row[15]) < FARTHEST_M
            and float(row[9]) - float(row[7]) >= SMALLEST_PX
        ]  # fmt: skip
        xyxy_px = np.array([row[6:10] for row in kept], np.float64).reshape(-1, 4)
        n, ids = len(kept), np.array([row[1] for row in kept], np.int64) + 1
        return tr.Tracks(
            ids, xyxy_px, np.full(n, ROAD_CLASSES.index("car")), np.ones(n), np.ones(n, np.bool_)
        )

    def _read(self, recording: Recording, folder: Path) -> tuple[FloatArray, dict[int, FloatArray]]:
        """(F, 2) frame of the drive that each frame shows, and its time; distances by frame of the
        drive.
        """
        names, options = recording.write(folder, self.pair)
        opened = tr.open_recording(*names, rig=self.rig_path, align="off", **options)
        if opened.rig is None or opened.rig.left.size_px != SIZE_PX:
            raise ValueError(f"the images have {opened.size_px} px, expected {SIZE_PX}")
        ranger = tr.StereoRanger(opened.rig)
        seen, distances_m = [], {}
        for frame in islice(opened.frames, N_LIVE if opened.live else None):
            small = _thumbnail(frame.left)
            number = int(np.argmin([np.abs(small - other).mean() for other in self._thumbnails]))
            seen.append((number, frame.time_s))
            distances_m[number] = ranger.measure(self._boxes[number], frame).distance_m
        opened.close()
        return np.array(seen), distances_m

    def compared(self, recording: Recording, folder: Path) -> Figures:
        """Frames, errors of times and of distances of a recording against the drive in plain
        form.
        """
        seen, distances_m = self._read(recording, folder)
        numbers, times_s = seen.T
        relative = np.concatenate([distances_m[n] / self._distances_m[n] - 1 for n in distances_m])
        n_plain = sum(int(np.isfinite(self._distances_m[n]).sum()) for n in distances_m)
        median_pct = 100 * float(np.nanmedian(np.abs(relative)))
        row = {
            "frames": len(seen),
            "distance_error_pct": median_pct,
            "measured": round(float(np.isfinite(relative).sum()) / n_plain, 2),
        }
        is_right = median_pct <= DISTANCE_PCT
        if recording.rate_hz:
            n_expected = (
                3 if "3 frames" in recording.kind else len(self.pair.left)
            ) - recording.n_lost
            errors_s = times_s - times_s[0] - (numbers - numbers[0]) / recording.rate_hz
            error_ms = 1e3 * float(np.abs(errors_s).max())
            is_right &= (
                bool((np.diff(numbers) > 0).all())
                and len(seen) >= n_expected
                and error_ms <= TIME_MS
            )
            row["time_error_ms"] = error_ms
        return {"right": is_right, **row}


def _read(calibration: Calibration, folder: Path) -> Figures:
    """Largest errors of the values of a calibration, and of distances with it."""
    path, expected = calibration.write(folder, calibration.rig), calibration.rig
    rig, _ = load_rig(path, size_px=expected.left.size_px)
    errors = differences(rig, expected)
    z_m = _triangulated_z_m(rig, expected)
    distance_pct = 100 * float(np.abs(z_m / SPACE_M[:, 2] - 1).max())
    is_right = max(errors.values()) <= VALUE and distance_pct <= DISTANCE_PCT
    return {"right": is_right, **errors, "distance_error_pct": distance_pct}


def _triangulated_z_m(rig: StereoRig, true: StereoRig) -> FloatArray:
    """(N,) z by `rig` of the points of `SPACE_M`, whose pixels are those of the true rig: R s a + T
    = t b.
    """

    def rays(read: PinholeCamera, camera: PinholeCamera, points_m: FloatArray) -> FloatArray:
        return read.recorded_rays(camera.recorded_px(points_m))

    homogeneous = np.column_stack((SPACE_M, np.ones(len(SPACE_M))))
    a = rays(rig.left, true.left, SPACE_M)
    b = rays(rig.right, true.right, (homogeneous @ true.right_from_left.T)[:, :3])
    rotated, t = a @ rig.right_from_left[:3, :3].T, rig.right_from_left[:3, 3]
    lengths = [
        np.linalg.lstsq(np.column_stack((one, -two)), -t, rcond=None)[0][0]
        for one, two in zip(rotated, b, strict=True)
    ]
    return np.asarray(np.array(lengths) * a[:, 2])

"""Synthetic drives: folders of KITTI labels of road users seen from behind, at known distances."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

F_PX, CX_PX, CY_PX = 700.0, 600.0, 180.0
SIZES_HWL_M = {
    "Car": (1.5, 1.7, 4.0),
    "Van": (2.2, 1.9, 5.0),
    "Truck": (3.3, 2.5, 10.0),
    "Pedestrian": (1.75, 0.6, 0.8),
    "Cyclist": (1.7, 0.6, 1.8),
}


def label_row(frame: int, track: int, kitti_type: str, rear_m: float, **more: float) -> str:
    """A row of KITTI tracking labels of an object seen from straight behind, with its rear at
    `rear_m`."""
    height, width, length = (size * more.get("scale", 1.0) for size in SIZES_HWL_M[kitti_type])
    x_m, ground_m = more.get("x_m", 0.0), more.get("ground_m", 1.65)
    box = [
        F_PX * (x_m - width / 2) / rear_m + CX_PX,
        F_PX * (ground_m - height) / rear_m + CY_PX,
        F_PX * (x_m + width / 2) / rear_m + CX_PX,
        F_PX * ground_m / rear_m + CY_PX,
    ]
    numbers = [
        *(-1.5708, *box, height, width, length),
        *(x_m, ground_m, rear_m + length / 2, -1.5707963),
    ]
    seen = f"{more.get('truncated', 0):g} {more.get('occluded', 0):g}"
    return f"{frame} {track} {kitti_type} {seen} " + " ".join(f"{number:.6f}" for number in numbers)


def calib_text(shift_px: float = 0.0) -> str:
    row = f"{F_PX} 0 {CX_PX} {shift_px} 0 {F_PX} {CY_PX} 0 0 0 1 0"
    return "".join(f"P{k}: {row}\n" for k in range(4))


def write_drives(
    folder: Path, drives: dict[str, Sequence[str]], *, shift_px: float = 0.0
) -> tuple[Path, Path]:
    """Write drives by name; returns the folders of labels and calibration files."""
    labels, calib = folder / "label_02", folder / "calib"
    for place in (labels, calib):
        place.mkdir(parents=True, exist_ok=True)
    for name, rows in drives.items():
        (labels / f"{name}.txt").write_text("\n".join(rows) + "\n")
        (calib / f"{name}.txt").write_text(calib_text(shift_px))
    return labels, calib


def approaching_rows(seed, kinds=("Car", "Pedestrian", "Car", "Pedestrian"), n_frames=60):
    """KITTI rows of objects that approach at 8 m/s (0.8 m per frame)."""
    first_m = np.random.default_rng(seed).uniform(58, 70, len(kinds))
    near = [
        (frame, track, first_m[track] - 0.8 * frame)
        for frame in range(n_frames)
        for track in range(len(kinds))
    ]
    return [
        label_row(frame, track, kinds[track], rear_m, x_m=3.0 * track)
        for frame, track, rear_m in near
    ]

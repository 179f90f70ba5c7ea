"""Synthetic KITTI labels of drives: vehicles and pedestrians seen from behind, with boxes of their
exact sizes."""

import numpy as np

F_PX = 700.0
SIZES_M = {"Car": (1.5, 1.7, 4.0), "Van": (2.2, 1.9, 5.0), "Pedestrian": (1.75, 0.6, 0.8)}


def row(frame, track, kind, rear_m, x_m=0.0, scale=1.0):
    height, width, length = (scale * size for size in SIZES_M[kind])
    box = [
        F_PX * u / rear_m + c
        for u, c in ((x_m - width / 2, 600), (1.65 - height, 180), (x_m + width / 2, 600))
    ]
    numbers = [
        -1.5708,
        *box,
        F_PX * 1.65 / rear_m + 180,
        height,
        width,
        length,
        x_m,
        1.65,
        rear_m + length / 2,
        -1.5708,
    ]
    return f"{frame} {track} {kind} 0 0 " + " ".join(f"{number:.5f}" for number in numbers)


def drive(seed, kinds=("Car", "Pedestrian", "Car", "Pedestrian"), n_frames=60):
    """KITTI rows of objects that approach at 8 m/s (0.8 m per frame)."""
    first_m = np.random.default_rng(seed).uniform(58, 70, len(kinds))
    near = [
        (frame, track, first_m[track] - 0.8 * frame)
        for frame in range(n_frames)
        for track in range(len(kinds))
    ]
    return [
        row(frame, track, kinds[track], rear_m, x_m=3.0 * track) for frame, track, rear_m in near
    ]

"""A calibration by the names of its matrices, as other programs store it."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

K1 = np.array([[543.75, 0.0, 335.5], [0.0, 546.25, 236.75], [0.0, 0.0, 1.0]])
K2 = np.array([[556.0, 0.0, 315.5], [0.0, 557.25, 240.875], [0.0, 0.0, 1.0]])
D1, D2 = (
    np.array([[0.05, -0.15, -0.0015, 0.0037, 0.39]]),
    np.array([[0.07, -0.16, 0.0001, -0.0004, 0.14]]),
)

R = np.asarray(cv2.Rodrigues(np.array([-0.05, -0.03, 0.01]))[0])
T = np.array([[-0.09], [0.002], [0.0145]])


def values(names: str, translation: np.ndarray = T) -> dict[str, Any]:
    """The matrices by these names; dots nest."""
    content: dict[str, Any] = {"retval": 0.31, "E": np.ones((3, 3)), "F": np.ones((3, 3))}
    for name, matrix in zip(names.split(), (K1, D1, K2, D2, R, translation), strict=True):
        *around, last = name.split(".")
        block = content
        for key in around:
            block = block.setdefault(key, {})
        block[last] = matrix
    return content


def plain(content: Any) -> Any:
    return (
        {key: plain(value) for key, value in content.items()}
        if isinstance(content, dict)
        else np.asarray(content).tolist()
    )


def matlab(pair: bool) -> dict[str, Any]:
    """A struct as MATLAB's toStruct writes it: matrices transposed, pixels from 1, millimetres."""

    def camera(k: np.ndarray, d: np.ndarray) -> dict[str, Any]:
        shifted = k + np.array([[0, 0, 1], [0, 0, 1], [0, 0, 0]])
        return {
            "RadialDistortion": d[:, [0, 1, 4]],
            "TangentialDistortion": d[:, 2:4],
            "ImageSize": np.array([[480.0, 640.0]]),
            "IntrinsicMatrix": shifted.T,
            "WorldPoints": np.zeros((200, 2)),
        }

    cameras = {"CameraParameters1": camera(K1, D1), "CameraParameters2": camera(K2, D2)}
    return {
        "stereoParams": cameras | {"RotationOfCamera2": R.T, "TranslationOfCamera2": 1000 * T.T}
        if pair
        else cameras
    }

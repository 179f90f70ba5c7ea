"""Calibrations as devices, data sets and SLAM programs write them."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

ZED = """[LEFT_CAM_HD]
fx=700
fy=701
cx=640
cy=360
k1=-0.17
k2=0.02
p1=0.001
p2=-0.002
k3=0.003

[RIGHT_CAM_HD]
fx=702
fy=703
cx=641
cy=361
k1=-0.16

[LEFT_CAM_VGA]
fx=350
fy=350
cx=336
cy=188

[RIGHT_CAM_VGA]
fx=351
fy=351
cx=335
cy=189

[STEREO]
Baseline=120
TY=0.5
TZ=-0.25
CV_HD=0.01
RX_HD=0.002
RZ_HD=-0.003
CV_VGA=0.01
"""


def oak(**changes: Any) -> dict[str, Any]:
    """Sockets 1 (left) and 2 (right), each with its transform to the colour camera, socket 0."""

    def camera(focal_px: float, x_cm: float, to: int) -> dict[str, Any]:
        return {
            "cameraType": 0,
            "distortionCoeff": [0.1] * 14,
            "extrinsics": {
                "rotationMatrix": np.eye(3).tolist() if to >= 0 else [],
                "specTranslation": {"x": x_cm * 1.2, "y": 0, "z": 0},
                "toCameraSocket": to,
                "translation": {"x": x_cm, "y": 0.01, "z": 0},
            },
            "height": 800,
            "intrinsicMatrix": [[focal_px, 0, 640], [0, focal_px, 400], [0, 0, 1]],
            "width": 1280,
        }

    data = [[1, camera(800, -3.75, 0)], [2, camera(810, 3.75, 0)], [0, camera(1500, 0, -1)]]
    return {"cameraData": data, "productName": "OAK-D", **changes}


def enumerated(size: tuple[int, int], focal_px: float, stream: str) -> str:
    return (
        f' Intrinsic of "{stream}" / {size[0]}x{size[1]} / {{Y8}}\n  Width:      \t{size[0]}\n'
        f"  Height:     \t{size[1]}\n"
        f"  PPX:        \t{size[0] / 2 + 1}\n  PPY:        \t{size[1] / 2 - 1}\n  Fx:         \t{focal_px}\n"
        f"  Fy:         \t{focal_px}\n  Distortion: \tBrown Conrady\n  Coeffs:     \t0  \t0  \t0  \t0  \t0  \n"
        "  FOV (deg):  \t89.63 x 58.79\n\n"
    )


REALSENSE = "Device info: \n    Name : \tIntel RealSense D435\n\n" + "".join(
    enumerated(size, focal_px, stream)
    for stream in ("Depth", "Infrared 1", "Infrared 2")
    for size, focal_px in (((848, 480), 425.5), ((1280, 720), 640.25))
)

EXTRINSIC = (
    'Extrinsic from "Infrared 1"\t  To\t  "Infrared 2" :\n Rotation Matrix:\n   1      0      0\n   0      1      0\n'
    "   0      0      1\n\n Translation Vector: -0.0499585978686810  0  0\n\n"
)


def pose(yaw_rad: float, xyz_m: list[float]) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(np.array([0.0, yaw_rad, 0.0]))[0]
    matrix[:3, 3] = xyz_m
    return matrix


BODY = pose(0.7, [1.0, 2.0, 3.0]) @ np.diag([1.0, 1.0, 1.0, 1.0])
RIGHT_FROM_LEFT = pose(0.02, [-0.11, 0.001, 0.002])
BODY_FROM = {"0": BODY, "1": BODY @ np.linalg.inv(RIGHT_FROM_LEFT)}  # x_body = T x_camera


def matrix44(matrix: np.ndarray) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": matrix.ravel().tolist()}


def euroc_camera(number: int) -> dict[str, Any]:
    return {
        "sensor_type": "camera",
        "T_BS": matrix44(BODY_FROM[str(number)]),
        "rate_hz": 20,
        "resolution": [752, 480],
        "camera_model": "pinhole",
        "intrinsics": [458 + number, 457, 367, 248],
        "distortion_model": "radial-tangential",
        "distortion_coefficients": [-0.28, 0.07, 0.0002, 1e-05],
    }


def vins_camera(number: int, model: str) -> str:
    lens, projection = {
        "PINHOLE": ("", "fx: {f}\n   fy: 457\n   cx: 367\n   cy: 248"),
        "MEI": (
            "mirror_parameters:\n   xi: 0.8\n",
            "gamma1: {f}\n   gamma2: 457\n   u0: 367\n   v0: 248",
        ),
        "KANNALA_BRANDT": (
            "",
            "k2: 0.01\n   k3: 0.002\n   k4: 0.0\n   k5: 0.0\n   mu: {f}\n   mv: 457\n   u0: 367\n   v0: 248",
        ),
    }[model]
    distortion = "distortion_parameters:\n   k1: -0.2\n   k2: 0.02\n   p1: 0.0001\n   p2: 0.0002\n"
    return (
        f"%YAML:1.0\n---\nmodel_type: {model}\ncamera_name: camera\nimage_width: 752\nimage_height: 480\n{lens}"
        f"{'' if model == 'KANNALA_BRANDT' else distortion}"
        f"projection_parameters:\n   {projection.format(f=458 + number)}\n"
    )


def orb(*lines: str) -> str:
    return '%YAML:1.0\n\nFile.version: "1.0"\n' + "".join(
        f"{line}\n" for line in (*lines, "Viewer.PointSize:2")
    )


def focal(name: str, focal_px: float, *coefficients: str) -> list[str]:
    return [
        f"{name}.fx: {focal_px}",
        f"{name}.fy: {focal_px}",
        f"{name}.cx: 367.0",
        f"{name}.cy: 248.0",
        *coefficients,
    ]


MIDDLEBURY = (
    "cam0=[1758.23 0 953.34; 0 1758.23 552.29; 0 0 1]\ncam1=[1758.23 0 963.34; 0 1758.23 552.29; 0 0 1]\ndoffs=10\n"
    "baseline=111.53\nwidth=1920\nheight=1080\nndisp=290\nvmin=75\nvmax=262\n"
)


def ost(x: float, names: tuple[str, ...]) -> str:
    """camera_calibration's text; x = -f B of the second camera."""

    def block(name: str, offset: float) -> str:
        return (
            f"[{name}]\n\ncamera matrix\n1000.0 0.0 640.0\n0.0 1000.0 360.0\n0.0 0.0 1.0\n\n"
            f"distortion\n-0.1 0.01 0.0 0.0 0.0\n\n"
            "rectification\n1.0 0.0 0.0\n0.0 1.0 0.0\n0.0 0.0 1.0\n\nprojection\n"
            f"900.0 0.0 640.0 {offset}\n0.0 900.0 360.0 0.0\n0.0 0.0 1.0 0.0\n\n"
        )

    blocks = [block(name, x if number else 0.0) for number, name in enumerate(names)]
    return "# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n1280\n\nheight\n720\n\n" + "".join(
        blocks
    )

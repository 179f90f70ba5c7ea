"""Calibrations as cameras, programs and data sets write them: one row per kind, which writes its
files to a folder.

Each row states the rig that has to be read from its files, so that tests and the benchmark compare
all its values.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
import yaml
from scipy.io import savemat
from scipy.spatial.transform import Rotation

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_rig

SIZE = (672, 376)
"""Width and height of the images of most rows, those of ZED's smallest mode."""

# writes the files of a rig to a folder; the result is the path to give
Write = Callable[[Path, StereoRig], Path]


def motion(rotation: Sequence[float], translation_m: Sequence[float]) -> FloatArray:
    """(4, 4) transform of a rotation vector and a translation."""
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = cv2.Rodrigues(np.array(rotation))[0], translation_m
    return matrix


RAW = StereoRig(
    PinholeCamera(400.5, 401.25, 340.25, 190.5, *SIZE, (-0.17, 0.02, 0.001, -0.002, 0.003)),
    PinholeCamera(402.0, 402.75, 331.5, 186.25, *SIZE, (-0.16, 0.018, -0.0005, 0.0008, 0.002)),
    motion([0.002, 0.01, -0.003], [-0.12, 0.0005, -0.00025]),
)
"""Two distorted cameras that are not quite parallel."""


def with_coefficients(rig: StereoRig, n: int) -> StereoRig:
    """The rig with the first `n` coefficients of the distortion, or zeros."""
    left, right = (
        replace(camera, distortion=(*camera.distortion, *[0.0] * n)[:n])
        for camera in (rig.left, rig.right)
    )
    return replace(rig, left=left, right=right)


FOUR = with_coefficients(RAW, 4)
EIGHT = replace(
    RAW,
    left=replace(RAW.left, distortion=(*RAW.left.distortion, 0.01, -0.02, 0.003)),
    right=replace(RAW.right, distortion=(*RAW.right.distortion, 0.02, -0.01, 0.002)),
)
PARALLEL = StereoRig.rectified(PinholeCamera(400.5, 400.5, 340.25, 190.5, *SIZE), 0.12)


def with_lens(lens: str, left: tuple[float, ...], right: tuple[float, ...]) -> StereoRig:
    return replace(
        RAW,
        left=replace(RAW.left, distortion=left, lens=lens),
        right=replace(RAW.right, distortion=right, lens=lens),
    )


FISHEYE = with_lens("kannala-brandt", (0.02, -0.03, 0.01, -0.002), (0.021, -0.028, 0.009, -0.001))
OMNI = with_lens("omni", (0.8, -0.17, 0.02, 0.001, -0.002), (0.82, -0.16, 0.018, -0.0005, 0.0008))


def listed(values: Any) -> Any:
    """Arrays in nested mappings as lists."""
    if isinstance(values, dict):
        return {key: listed(value) for key, value in values.items()}
    return np.asarray(values).tolist() if isinstance(values, np.ndarray | tuple) else values


def line(values: Any) -> str:
    return " ".join(f"{value!r}" for value in np.ravel(values).tolist())


def both(rig: StereoRig) -> tuple[tuple[PinholeCamera, FloatArray], ...]:
    """Each camera, and (4, 4) its transform from the left one."""
    return (rig.left, np.eye(4)), (rig.right, rig.right_from_left)


def rectification(rig: StereoRig) -> dict[str, FloatArray]:
    """OpenCV's R1, R2, P1, P2 and Q; the principal point is rounded, since its last digits vary
    from call to call."""
    r, t = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3:]
    distortion = [np.array(camera.distortion or (0.0,) * 5) for camera in (rig.left, rig.right)]
    found = cv2.stereoRectify(
        rig.left.matrix, distortion[0], rig.right.matrix, distortion[1], rig.left.size_px, r, t
    )
    r1, r2, p1, p2, q = (np.array(matrix, np.float64) for matrix in found[:5])
    p1[:2, 2], p2[:2, 2], q[:2, 3] = p1[:2, 2].round(3), p2[:2, 2].round(3), q[:2, 3].round(3)
    return {"R1": r1, "R2": r2, "P1": p1, "P2": p2, "Q": q}


NAMES = (  # of K, D, K, D, R, T; dots nest
    "K1 D1 K2 D2 R T",
    "M1 D1 M2 D2 R T",
    "cameraMatrix1 distCoeffs1 cameraMatrix2 distCoeffs2 R T",
    "cameraMatrixL distL cameraMatrixR distR rot trans",
    "mtxL distL mtxR distR R T",
    "mtx_left dist_left mtx_right dist_right R T",
    "mtx1 dist1 mtx2 dist2 R T",
    "left_camera_matrix left_dist_coeffs right_camera_matrix right_dist_coeffs rotation translation",
    "camera_matrix_left dist_coeffs_left camera_matrix_right dist_coeffs_right rotation_matrix translation_vector",
    "cameraMatrixLeft distCoeffsLeft cameraMatrixRight distCoeffsRight rmat tvec",
    "K_left D_left K_right D_right R T",
    "K_l D_l K_r D_r R T",
    "Kl Dl Kr Dr R T",
    "cam0_K cam0_D cam1_K cam1_D R T",
    "camera_matrix_0 dist_coeffs_0 camera_matrix_1 dist_coeffs_1 R T",
    "cam_mats_left dist_coefs_left cam_mats_right dist_coefs_right rot_mat trans_vec",
    "leftIntrinsics leftDistortion rightIntrinsics rightDistortion Rot Trns",
    "intrinsic_matrix_left distortion_left intrinsic_matrix_right distortion_right stereo_R stereo_T",
    "KK_left kc_left KK_right kc_right R T",
    "left.K left.D right.K right.D stereo.R stereo.T",
    "cameras.left.camera_matrix cameras.left.distortion_coefficients cameras.right.camera_matrix "
    "cameras.right.distortion_coefficients extrinsics.rotation extrinsics.translation",
    "camera_matrix.left dist_coeff.left camera_matrix.right dist_coeff.right R T",
    "LEFT.K LEFT.D RIGHT.K RIGHT.D R T",
)


def named(names: str, rig: StereoRig, units_per_m: float = 1.0) -> dict[str, Any]:
    """K, D, K, D, R and T (3, 1) by these names; dots nest."""
    arrays = [
        part for camera, _ in both(rig) for part in (camera.matrix, np.array([camera.distortion]))
    ]
    content: dict[str, Any] = {}
    rotation, translation = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3:] * units_per_m
    for name, array in zip(names.split(), (*arrays, rotation, translation), strict=True):
        *around, last = name.split(".")
        block = content
        for key in around:
            block = block.setdefault(key, {})
        block[last] = array
    return content


def storage(path: Path, content: dict[str, Any]) -> Path:
    """A file of OpenCV's FileStorage."""
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for key, value in content.items():
        file.write(key, value)
    file.release()
    return path


def text(path: Path, content: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(content, encoding="utf-8")
    return path


def of_names(
    folder: Path, rig: StereoRig, *, names: str, file: str, units_per_m: float = 1.0, **more: Any
) -> Path:
    """Matrices by name in JSON, YAML or XML of OpenCV, or .npz."""
    content, path = named(names, rig, units_per_m) | more, folder / file
    if path.suffix == ".json":
        return text(path, json.dumps(listed(content)))
    if path.suffix == ".npz":
        np.savez(path, allow_pickle=False, map1=np.zeros((48, 64, 2), np.float32), **content)
        return path
    return storage(path, content)


def npy(folder: Path, rig: StereoRig) -> Path:
    for name, array in named(NAMES[15], rig).items():
        np.save(folder / f"{name}.npy", array)
    return folder / "cam_mats_left.npy"


def printed(folder: Path, rig: StereoRig) -> Path:
    with np.printoptions(precision=17, floatmode="unique"):
        lines = [f"{name}:\n{array}\n" for name, array in named(NAMES[0], rig).items()]
    return text(folder / "printed.txt", "Calibration done\n" + "".join(lines))


def rectified_only(folder: Path, rig: StereoRig, *, keys: str) -> Path:
    """Only some of the matrices of stereoRectify, such as in a file of remap tables."""
    content: dict[str, Any] = {
        key: value for key, value in rectification(rig).items() if key in keys.split()
    }
    np.savez(folder / "maps.npz", left_map_x=np.zeros((48, 64), np.float32), **content)
    return folder / "maps.npz"


def cameras_and_rectification(folder: Path, rig: StereoRig) -> Path:
    content = {key: value for key, value in named(NAMES[0], rig).items() if key not in ("R", "T")}
    return storage(folder / "stereo.yml", content | rectification(rig))


def intrinsics_and_extrinsics(folder: Path, rig: StereoRig) -> Path:
    content = named(NAMES[1], rig)
    storage(
        folder / "extrinsics.yml",
        {key: content.pop(key) for key in ("R", "T")} | rectification(rig),
    )
    return storage(folder / "intrinsics.yml", content)


def left_right_and_extrinsics(folder: Path, rig: StereoRig) -> Path:
    content = named(NAMES[1], rig)
    for side, number in (("left", 1), ("right", 2)):
        storage(
            folder / f"{side}.yml",
            {"camera_matrix": content[f"M{number}"], "dist_coeff": content[f"D{number}"]},
        )
    storage(folder / "extrinsics.yml", {"R": content["R"], "T": content["T"]})
    return folder / "left.yml"


def matlab(rig: StereoRig) -> dict[str, Any]:
    """A struct as MATLAB's toStruct writes it: matrices transposed, pixels from 1, millimetres."""
    blocks = {}
    for number, (camera, _) in enumerate(both(rig), start=1):
        shifted, d = camera.matrix, np.array(camera.distortion)
        shifted[:2, 2] += 1
        blocks[f"CameraParameters{number}"] = {
            "RadialDistortion": d[[0, 1, 4]],
            "TangentialDistortion": d[2:4],
            "ImageSize": np.array(camera.size_px[::-1], float),
            "IntrinsicMatrix": shifted.T,
            "WorldPoints": np.zeros((200, 2)),
        }
    rotation, translation = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3]
    return {**blocks, "RotationOfCamera2": rotation.T, "TranslationOfCamera2": 1000 * translation}


def matlab_file(folder: Path, rig: StereoRig) -> Path:
    savemat(folder / "stereoParams.mat", {"stereoParams": matlab(rig)}, do_compression=True)
    return folder / "stereoParams.mat"


def bouguet(folder: Path, rig: StereoRig) -> Path:
    r, t = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3:]
    content: dict[str, Any] = {"om": cv2.Rodrigues(r)[0], "T": 1000 * t}
    content |= dict(zip(("nx", "ny"), map(float, rig.left.size_px), strict=True))
    for side, (camera, _) in zip(("left", "right"), both(rig), strict=True):
        k = camera.matrix
        content |= {f"fc_{side}": k[[0, 1], [0, 1]][:, None], f"cc_{side}": k[:2, 2:]}
        content[f"kc_{side}"] = np.array([camera.distortion]).T
    savemat(folder / "Calib_Results_stereo.mat", content)
    return folder / "Calib_Results_stereo.mat"


def zed(folder: Path, rig: StereoRig) -> Path:
    """Also a section for twice the size, which is not that of the images."""
    lines = []
    for mode, scale in (("HD", 2.0), ("VGA", 1.0)):
        for side, (camera, _) in zip(("LEFT", "RIGHT"), both(rig), strict=True):
            names = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3")
            focal = scale * np.array([camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px])
            numbers = zip(names, (*focal.tolist(), *camera.distortion), strict=True)
            lines += [f"[{side}_CAM_{mode}]", *(f"{name}={value!r}" for name, value in numbers), ""]
    (rx, cv, rz), t = (
        cv2.Rodrigues(rig.right_from_left[:3, :3])[0].ravel().tolist(),
        (-1000 * rig.right_from_left[:3, 3]).tolist(),
    )
    lines += ["[STEREO]", f"Baseline={t[0]!r}", f"TY={t[1]!r}", f"TZ={t[2]!r}"]
    lines += [f"{name}_VGA={value!r}" for name, value in (("CV", cv), ("RX", rx), ("RZ", rz))]
    return text(folder / "SN12345.conf", "\r\n".join(lines) + "\r\n")


def oak_content(rig: StereoRig) -> dict[str, Any]:
    """Sockets 1 (left) and 2 (right) with their transforms to the colour camera, socket 0;
    centimetres."""

    def camera(model: PinholeCamera, to_colour: FloatArray | None) -> dict[str, Any]:
        xyz = np.zeros(3) if to_colour is None else 100 * to_colour[:3, 3]
        return {
            "cameraType": int(model.lens != "pinhole"),
            "distortionCoeff": [*model.distortion, *[0.0] * 9][:14],
            "extrinsics": {
                "rotationMatrix": [] if to_colour is None else to_colour[:3, :3].tolist(),
                "specTranslation": dict(zip("xyz", (1.2 * xyz).tolist(), strict=True)),
                "toCameraSocket": -1 if to_colour is None else 0,
                "translation": dict(zip("xyz", xyz.tolist(), strict=True)),
            },
            "height": model.height_px,
            "intrinsicMatrix": model.matrix.tolist(),
            "width": model.width_px,
        }

    colour_from_left = motion([0.0, 0.0, 0.0], [-0.0375, 0.0, 0.0])
    colour_from_right = colour_from_left @ np.linalg.inv(rig.right_from_left)
    data = [[1, camera(rig.left, colour_from_left)], [2, camera(rig.right, colour_from_right)]]
    return {"cameraData": [*data, [0, camera(rig.left, None)]], "productName": "OAK-D"}


def oak(folder: Path, rig: StereoRig) -> Path:
    return text(folder / "oak.json", json.dumps(oak_content(rig)))


def realsense(folder: Path, rig: StereoRig) -> Path:
    """The output of rs-enumerate-devices -c."""
    blocks = ["Device info: \n    Name : \tIntel RealSense D435\n\n"]
    for stream, (camera, _) in zip(("Infrared 1", "Infrared 2"), both(rig), strict=True):
        blocks += [
            f' Intrinsic of "{stream}" / {width}x{height} / {{Y8}}\n  Width:      \t{width}\n  Height:     \t{height}\n'
            f"  PPX:        \t{scale * camera.cx_px}\n  PPY:        \t{scale * camera.cy_px}\n  Fx:         \t"
            f"{scale * camera.fx_px}\n  Fy:         \t{scale * camera.fy_px}\n  Distortion: \tBrown Conrady\n"
            f"  Coeffs:     \t{'  '.join(map(repr, camera.distortion or (0.0,) * 5))}  \n"
            "  FOV (deg):  \t89.63 x 58.79\n\n"
            for scale, width, height in (
                (2, 2 * camera.width_px, 2 * camera.height_px),
                (1, *camera.size_px),
            )
        ]
    r, t = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3]
    rows = "".join(f"   {line(row)}\n" for row in r)
    blocks.append(
        f'Extrinsic from "Infrared 1"\t  To\t  "Infrared 2" :\n Rotation Matrix:\n{rows}\n '
        f"Translation Vector: {line(t)}\n"
    )
    return text(folder / "rs.txt", "".join(blocks))


def realsense_json(folder: Path, rig: StereoRig) -> Path:
    content: dict[str, Any] = {}
    for name, (camera, _) in zip(("infrared1", "infrared2"), both(rig), strict=True):
        numbers = (
            camera.width_px,
            camera.height_px,
            camera.fx_px,
            camera.fy_px,
            camera.cx_px,
            camera.cy_px,
        )
        content[name] = dict(
            zip(("width", "height", "fx", "fy", "ppx", "ppy"), numbers, strict=True)
        )
        content[name]["coeffs"] = list(camera.distortion or (0.0,) * 5)
    transform = rig.right_from_left
    content["extrinsics"] = {
        "infrared1_to_infrared2": {
            "rotation": listed(transform[:3, :3]),
            "translation": listed(transform[:3, 3]),
        }
    }
    return text(folder / "rs.json", json.dumps(content))


def matrix44(matrix: FloatArray) -> dict[str, Any]:
    return {"cols": 4, "rows": 4, "data": matrix.ravel().tolist()}


BODY_FROM_LEFT = motion([0.0, 0.7, 0.0], [1.0, 2.0, 3.0])


def euroc(folder: Path, rig: StereoRig, *, files: tuple[str, str]) -> Path:
    """ASL's sensor.yaml of both cameras, also Kimera's."""
    for name, (camera, transform) in zip(files, both(rig), strict=True):
        content = {
            "sensor_type": "camera",
            "T_BS": matrix44(BODY_FROM_LEFT @ np.linalg.inv(transform)),
            "rate_hz": 20,
            "resolution": list(camera.size_px),
            "camera_model": "pinhole",
            "intrinsics": [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
            "distortion_model": "radial-tangential",
            "distortion_coefficients": list(camera.distortion),
        }
        text(folder / name, yaml.safe_dump(content))
    return folder / files[0]


def kalibr(folder: Path, rig: StereoRig) -> Path:
    chain = {}
    for number, (camera, transform) in enumerate(both(rig)):
        xi = [camera.distortion[0]] if camera.lens == "omni" else []
        chain[f"cam{number}"] = {
            "camera_model": "omni" if xi else "pinhole",
            "distortion_coeffs": list(camera.distortion[len(xi) :]),
            "distortion_model": "equidistant" if camera.lens == "kannala-brandt" else "radtan",
            "intrinsics": [*xi, camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
            "resolution": list(camera.size_px),
            **({"T_cn_cnm1": transform.tolist()} if number else {}),
        }
    return text(folder / "camchain.yaml", yaml.safe_dump(chain))


def open_vins(folder: Path, rig: StereoRig) -> Path:
    """OpenVINS' kalibr_imucam_chain.yaml: poses of the cameras relative to the IMU."""
    blocks = {}
    for number, (camera, transform) in enumerate(both(rig)):
        blocks[f"cam{number}"] = {
            "T_imu_cam": (BODY_FROM_LEFT @ np.linalg.inv(transform)).tolist(),
            "camera_model": "pinhole",
            "distortion_coeffs": list(camera.distortion),
            "distortion_model": "radtan",
            "intrinsics": [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px],
            "resolution": list(camera.size_px),
        }
    return text(folder / "kalibr_imucam_chain.yaml", "%YAML:1.0\n\n" + yaml.safe_dump(blocks))


def opencv_matrix(name: str, values: FloatArray) -> str:
    data = ", ".join(map(repr, values.ravel().tolist()))
    rows, columns = values.shape
    return f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [{data}]\n"


def vins_camera(camera: PinholeCamera) -> str:
    focal = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px]
    model, names, coefficients = {
        "pinhole": ("PINHOLE", ("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2")),
        "omni": ("MEI", ("gamma1", "gamma2", "u0", "v0"), ("xi", "k1", "k2", "p1", "p2")),
        "kannala-brandt": ("KANNALA_BRANDT", ("mu", "mv", "u0", "v0"), ("k2", "k3", "k4", "k5")),
    }[camera.lens]
    values = [
        f"   {name}: {value!r}\n"
        for name, value in zip(coefficients, camera.distortion, strict=True)
    ]
    mirror = f"mirror_parameters:\n{values.pop(0)}" if model == "MEI" else ""
    projection = "".join(
        f"   {name}: {value!r}\n" for name, value in zip(names, focal, strict=True)
    )
    blocks = "" if model == "KANNALA_BRANDT" else f"distortion_parameters:\n{''.join(values)}"
    inside = "".join(values) if model == "KANNALA_BRANDT" else ""
    return (
        f"%YAML:1.0\n---\nmodel_type: {model}\ncamera_name: camera\nimage_width: {camera.width_px}\n"
        f"image_height: {camera.height_px}\n{mirror}{blocks}projection_parameters:\n{inside}{projection}"
    )


def vins(folder: Path, rig: StereoRig) -> Path:
    parts = [
        '%YAML:1.0\n\nnum_of_cam: 2\ncam0_calib: "left.yaml"\ncam1_calib: "right.yaml"\nestimate_extrinsic: 1\n'
    ]
    for number, (camera, transform) in enumerate(both(rig)):
        parts.append(
            opencv_matrix(f"body_T_cam{number}", BODY_FROM_LEFT @ np.linalg.inv(transform))
        )
        text(folder / ("left.yaml", "right.yaml")[number], vins_camera(camera))
    return text(folder / "config.yaml", "".join(parts))


def orb_focal(name: str, camera: PinholeCamera) -> str:
    names = ("k1", "k2", "k3", "k4") if camera.is_wide else ("k1", "k2", "p1", "p2")
    values = {"fx": camera.fx_px, "fy": camera.fy_px, "cx": camera.cx_px, "cy": camera.cy_px}
    values |= dict(zip(names, camera.distortion, strict=False))
    return "".join(f"{name}.{key}: {value!r}\n" for key, value in values.items())


def orb(folder: Path, rig: StereoRig, *, form: str) -> Path:
    """Settings of ORB-SLAM2 (with LEFT.K, or bf alone) and of ORB-SLAM3 (Stereo.T_c1_c2, or
    Stereo.b)."""
    left, width, height = rig.left, *rig.left.size_px
    size, lens = (
        f"Camera.width: {width}\nCamera.height: {height}\n",
        "KannalaBrandt8" if left.is_wide else "PinHole",
    )
    if form == "LEFT":
        found, parts = rectification(rig), []
        for number, (side, (camera, _)) in enumerate(
            zip(("LEFT", "RIGHT"), both(rig), strict=True), start=1
        ):
            parts.append(f"{side}.height: {height}\n{side}.width: {width}\n")
            for name, values in {
                "D": np.array([camera.distortion]),
                "K": camera.matrix,
                "R": found[f"R{number}"],
                "P": found[f"P{number}"],
            }.items():
                parts.append(opencv_matrix(f"{side}.{name}", values))
        p = found["P2"]
        body = (
            orb_focal("Camera", rectified(rig).left)
            + size
            + f"Camera.bf: {float(-p[0, 3])!r}\n"
            + "".join(parts)
        )
    elif form == "bf":
        body = orb_focal("Camera", left) + f"Camera.bf: {left.fx_px * rig.baseline_m!r}\n"
    elif form == "b":
        lens, body = (
            "Rectified",
            orb_focal("Camera1", left) + size + f"Stereo.b: {rig.baseline_m!r}\n",
        )
    else:
        body = orb_focal("Camera1", left) + orb_focal("Camera2", rig.right) + size
        body += opencv_matrix(
            "Stereo.T_c1_c2", np.asarray(np.linalg.inv(rig.right_from_left), np.float64)
        )
    return text(
        folder / "settings.yaml",
        f'%YAML:1.0\n\nFile.version: "1.0"\nCamera.type: "{lens}"\n{body}Viewer.PointSize:2\n',
    )


def camera_info(rig: StereoRig) -> tuple[dict[str, Any], dict[str, Any]]:
    """ROS 2's camera_info of both cameras."""
    found = rectification(rig)
    left, right = (
        {
            "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "optical"},
            "height": camera.height_px,
            "width": camera.width_px,
            "distortion_model": "plumb_bob",
            "d": list(camera.distortion),
            "k": listed(camera.matrix.ravel()),
            "r": listed(found[f"R{number}"].ravel()),
            "p": listed(found[f"P{number}"].ravel()),
            "binning_x": 0,
            "binning_y": 0,
            "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
        }
        for number, (camera, _) in enumerate(both(rig), start=1)
    )
    return left, right


def calibration_yaml(message: dict[str, Any]) -> dict[str, Any]:
    """A camera_info in the layout of ROS's camera_calibration."""

    def matrix(key: str, rows: int) -> dict[str, Any]:
        return {"rows": rows, "cols": len(message[key]) // rows, "data": message[key]}

    return {
        "image_width": message["width"],
        "image_height": message["height"],
        "camera_name": "narrow_stereo",
        "camera_matrix": matrix("k", 3),
        "distortion_model": "plumb_bob",
        "distortion_coefficients": matrix("d", 1),
        "rectification_matrix": matrix("r", 3),
        "projection_matrix": matrix("p", 3),
    }


def ros_files(folder: Path, rig: StereoRig) -> Path:
    for side, message in zip(("left", "right"), camera_info(rig), strict=True):
        text(folder / f"{side}.yaml", yaml.safe_dump(calibration_yaml(message)))
    return folder / "left.yaml"


def ros_echo(folder: Path, rig: StereoRig) -> Path:
    return text(
        folder / "echo.yaml", "---\n".join(yaml.safe_dump(message) for message in camera_info(rig))
    )


def ost(folder: Path, rig: StereoRig) -> Path:
    parts = [
        f"# oST version 5.0 parameters\n\n\n[image]\n\nwidth\n{rig.left.width_px}\n\nheight\n{rig.left.height_px}\n"
    ]
    for side, message in zip(("left", "right"), camera_info(rig), strict=True):
        parts.append(f"\n[narrow_stereo/{side}]\n")
        for name, key, n in (
            ("camera matrix", "k", 3),
            ("distortion", "d", 1),
            ("rectification", "r", 3),
        ):
            parts.append(
                f"\n{name}\n"
                + "".join(f"{line(row)}\n" for row in np.reshape(message[key], (n, -1)))
            )
        parts.append(
            "\nprojection\n" + "".join(f"{line(row)}\n" for row in np.reshape(message["p"], (3, 4)))
        )
    return text(folder / "ost.txt", "".join(parts))


def kitti(folder: Path, rig: StereoRig, *, form: str) -> Path:
    """KITTI's calib.txt with P2 and P3, or the two lines alone."""
    p2 = np.column_stack((rig.left.matrix, [44.85, 0.2163, 0.002745]))
    p3 = np.column_stack((rig.left.matrix, rig.left.matrix @ rig.right_from_left[:3, 3] + p2[:, 3]))
    return text(
        folder / "calib.txt",
        "".join(form.format(n=n) + line(p) + "\n" for n, p in ((2, p2), (3, p3))),
    )


def cam_to_cam(folder: Path, rig: StereoRig, *, numbers: tuple[str, str]) -> Path:
    """KITTI raw's calib_cam_to_cam.txt, and DrivingStereo's; the rectified images have another
    size."""
    reference = motion([0.0, 0.0, 0.0], [0.06, 0.0, 0.0])
    lines = ["calib_time: 09-Jan-2012 13:57:47", "corner_dist: 9.950000e-02"]
    for number, (camera, transform), offset in zip(numbers, both(rig), (40.0, 4.0), strict=True):
        pose = transform @ reference
        values = {
            "S": [float(side) for side in camera.size_px],
            "K": camera.matrix,
            "D": camera.distortion,
            "R": pose[:3, :3],
            "T": pose[:3, 3],
            "S_rect": (620.0, 188.0),
            "R_rect": np.eye(3),
            "P_rect": [300, 0, 310, offset, 0, 300, 94, 0, 0, 0, 1, 0],
        }
        lines += [f"{key}_{number}: {line(value)}" for key, value in values.items()]
    return text(folder / "calib_cam_to_cam.txt", "\n".join(lines) + "\n")


def perspective(folder: Path, rig: StereoRig) -> Path:
    """KITTI-360's perspective.txt."""
    lines = []
    for number, (camera, transform) in zip(("00", "01"), both(rig), strict=True):
        p = np.column_stack((camera.matrix, camera.matrix @ transform[:3, 3]))
        values = {
            "S": (1392.0, 512.0),
            "K": [788.6, 0.0, 687.2, 0.0, 786.4, 317.8, 0.0, 0.0, 1.0],
            "D": [-0.344, 0.142, 0.0, 0.0, -0.03],
            "S_rect": [float(side) for side in camera.size_px],
            "R_rect": np.eye(3),
            "P_rect": p,
        }
        lines += [f"{key}_{number}: {line(value)}" for key, value in values.items()]
    return text(folder / "perspective.txt", "\n".join(lines) + "\n")


def middlebury(folder: Path, rig: StereoRig) -> Path:
    def k(camera: PinholeCamera) -> str:
        return "; ".join(line(row) for row in camera.matrix)

    return text(
        folder / "calib.txt",
        f"cam0=[{k(rig.left)}]\ncam1=[{k(rig.right)}]\ndoffs={rig.right.cx_px - rig.left.cx_px!r}\n"
        f"baseline={1000 * rig.baseline_m!r}\nwidth={rig.left.width_px}\nheight={rig.left.height_px}\nndisp=290\n",
    )


def cityscapes(folder: Path, rig: StereoRig) -> Path:
    names = ("fx", "fy", "u0", "v0")
    numbers = (rig.left.fx_px, rig.left.fy_px, rig.left.cx_px, rig.left.cy_px)
    content = {
        "extrinsic": {
            "baseline": rig.baseline_m,
            "pitch": 0.038,
            "roll": 0.0,
            "x": 1.7,
            "y": 0.1,
            "yaw": -0.02,
        },
        "intrinsic": dict(zip(names, numbers, strict=True)),
    }
    return text(folder / "camera.json", json.dumps(content))


def virtual_kitti(folder: Path, rig: StereoRig) -> Path:
    left = rig.left
    rows = "".join(
        f"0 {n} {line([left.fx_px, left.fy_px, left.cx_px, left.cy_px])}\n" for n in (0, 1)
    )
    return text(folder / "intrinsic.txt", f"frame cameraID K[0,0] K[1,1] K[0,2] K[1,2]\n{rows}")


def foundation_stereo(folder: Path, rig: StereoRig) -> Path:
    return text(folder / "K.txt", f"{line(rig.left.matrix)}\n{rig.baseline_m!r}\n")


def bodies(rig: StereoRig) -> list[FloatArray]:
    """(4, 4) poses of both cameras in the frame of a body, x_body = T x_camera."""
    body_from_left = motion([0.1, -0.2, 0.3], [0.5, 0.25, -0.125])
    return [body_from_left @ np.linalg.inv(transform) for _, transform in both(rig)]


def okvis(folder: Path, rig: StereoRig) -> Path:
    cameras = [
        {
            "T_SC": np.ravel(pose),
            "image_dimension": camera.size_px,
            "distortion_coefficients": camera.distortion,
            "distortion_type": "radialtangential" if camera.lens == "pinhole" else "equidistant",
            "focal_length": (camera.fx_px, camera.fy_px),
            "principal_point": (camera.cx_px, camera.cy_px),
        }
        for (camera, _), pose in zip(both(rig), bodies(rig), strict=True)
    ]
    content = {"cameras": [listed(camera) for camera in cameras]}
    return text(folder / "okvis.yaml", "%YAML:1.0\n" + yaml.safe_dump(content))


BASALT = {"pinhole": "pinhole-radtan8", "kannala-brandt": "kb4", "double-sphere": "ds"}


def basalt(folder: Path, rig: StereoRig) -> Path:
    """basalt's calibration.json; the quaternions are those of the rotations."""
    poses, intrinsics = [], []
    for (camera, _), pose in zip(both(rig), bodies(rig), strict=True):
        quaternion = Rotation.from_matrix(pose[:3, :3]).as_quat()
        names = ("px", "py", "pz", "qx", "qy", "qz", "qw")
        poses.append(dict(zip(names, [*pose[:3, 3], *quaternion], strict=True)))
        names = {
            "pinhole": ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"),
            "kannala-brandt": ("k1", "k2", "k3", "k4"),
            "double-sphere": ("xi", "alpha"),
        }[camera.lens]
        matrix = {name: getattr(camera, f"{name}_px") for name in ("fx", "fy", "cx", "cy")}
        numbers = matrix | dict(zip(names, camera.distortion, strict=True))
        intrinsics.append({"camera_type": BASALT[camera.lens], "intrinsics": numbers})
    resolution = [rig.left.size_px, rig.right.size_px]
    content = {"T_imu_cam": poses, "intrinsics": intrinsics, "resolution": resolution}
    return text(folder / "calibration.json", json.dumps({"value0": listed(content)}))


def mrcal(folder: Path, rig: StereoRig) -> Path:
    for (camera, pose), side in zip(both(rig), ("left", "right"), strict=True):
        rotation = cv2.Rodrigues(pose[:3, :3])[0].ravel()
        numbers = [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion]
        lines = [
            "# generated by a test",
            "{",
            f"    'lensmodel':  'LENSMODEL_OPENCV{len(camera.distortion)}',",
            f"    'intrinsics': [ {', '.join(map(repr, numbers))},],",
            f"    'extrinsics': [ {', '.join(map(repr, [*rotation.tolist(), *pose[:3, 3].tolist()]))},],",
            f"    'imagersize': [ {camera.width_px}, {camera.height_px},],",
            "    'optimization_inputs': b'{: *x'",
            "}",
        ]
        text(folder / f"{side}.cameramodel", "\n".join(lines) + "\n")
    return folder / "left.cameramodel"


def mrpt(folder: Path, rig: StereoRig) -> Path:
    """MRPT's stereo camera; the pose is that of the right camera in the left one's frame."""
    lines = []
    for (camera, _), side in zip(both(rig), ("LEFT", "RIGHT"), strict=True):
        lines += [
            f"[CAMERA_PARAMS_{side}]",
            f"resolution = [{camera.width_px} {camera.height_px}]",
            *(f"{name} = {getattr(camera, name + '_px')!r}" for name in ("cx", "cy", "fx", "fy")),
            f"dist = [{line(camera.distortion)}]    // The order is: [K1 K2 T1 T2 K3]",
        ]
    pose = np.linalg.inv(rig.right_from_left)
    rows = " ;".join(line(row) for row in pose[:3, :3])
    lines += [
        "[CAMERA_PARAMS_LEFT2RIGHT_POSE]",
        f"translation_only = [{line(pose[:3, 3])}]",
        f"rotation_matrix_only = [{rows} ]",
    ]
    return text(folder / "camera_params.txt", "\n".join(lines) + "\n")


def ours(folder: Path, rig: StereoRig) -> Path:
    save_rig(rig, folder / "rig.yaml")
    return folder / "rig.yaml"


class Calibration(NamedTuple):
    """A kind of calibration, what writes it, and the rig that has to be read."""

    kind: str
    write: Write
    rig: StereoRig = RAW


def parallel(
    focal_px: float, centre_px: tuple[float, float], size_px: tuple[int, int], baseline_m: float
) -> StereoRig:
    return StereoRig.rectified(PinholeCamera(focal_px, focal_px, *centre_px, *size_px), baseline_m)


def rectified(rig: StereoRig) -> StereoRig:
    """The pair of the images that stereoRectify makes of those of a rig."""
    p = rectification(rig)["P1"]
    return parallel(
        float(p[0, 0]), (float(p[0, 2]), float(p[1, 2])), rig.left.size_px, rig.baseline_m
    )


_SHIFTED = replace(PARALLEL, right=replace(PARALLEL.right, cx_px=350.25))
CALIBRATIONS = (
    Calibration("rig.yaml", ours),
    Calibration("ZED SN*.conf", zed),
    Calibration("OAK calibration JSON", oak, with_coefficients(RAW, 14)),
    Calibration("OAK calibration JSON, fisheye", oak, FISHEYE),
    Calibration("RealSense rs-enumerate-devices -c", realsense, PARALLEL),
    Calibration("RealSense JSON", realsense_json),
    *(
        Calibration(f"OpenCV names {names.split()[0]} .. in {file}", partial(of_names, names=names, file=file))
        for names, file in (
            (NAMES[1], "stereo.yml"), (NAMES[1], "stereo.xml"), (NAMES[0], "stereo.json"), (NAMES[2], "stereo.yml"),
            (NAMES[3], "stereo.yml"), (NAMES[4], "stereo.npz"), (NAMES[5], "stereo.npz"), (NAMES[7], "stereo.json"),
            (NAMES[10], "stereo.yml"), (NAMES[19], "stereo.json"), (NAMES[20], "stereo.json"),
        )
    ),
    Calibration("OpenCV intrinsics.yml + extrinsics.yml", intrinsics_and_extrinsics),
    Calibration("left.yml, right.yml, extrinsics.yml", left_right_and_extrinsics),
    Calibration("OpenCV, T in millimetres", partial(of_names, names=NAMES[1], file="s.yml", units_per_m=1000.0)),
    Calibration("OpenCV, T in centimetres", partial(of_names, names=NAMES[1], file="s.yml", units_per_m=100.0)),
    Calibration(
        "OpenCV, square_size in metres", partial(of_names, names=NAMES[1], file="s.yml", square_size=0.025)
    ),
    Calibration(
        "OpenCV, square_size in millimetres",
        partial(of_names, names=NAMES[1], file="s.yml", units_per_m=1000.0, square_size=25.0),
    ),
    Calibration("cameras with R1 R2 P1 P2", cameras_and_rectification),
    Calibration("remap tables with P1 P2", partial(rectified_only, keys="P1 P2"), rectified(RAW)),
    Calibration("remap tables with Q", partial(rectified_only, keys="Q"), rectified(RAW)),
    Calibration("NumPy .npy files", npy),
    Calibration("printed matrices", printed),
    Calibration("OpenCV fisheye", partial(of_names, names=NAMES[0], file="s.yml", fisheye_model=1), FISHEYE),
    Calibration("MATLAB struct in .mat", matlab_file),
    Calibration("MATLAB struct in JSON", lambda folder, rig: text(folder / "s.json", json.dumps(listed(matlab(rig))))),
    Calibration("Bouguet's Calib_Results_stereo.mat", bouguet),
    Calibration("Kalibr camchain", kalibr, FOUR),
    Calibration("Kalibr camchain, equidistant", kalibr, FISHEYE),
    Calibration("Kalibr camchain, omni", kalibr, OMNI),
    Calibration("OpenVINS chain", open_vins, FOUR),
    Calibration(
        "EuRoC sensor.yaml", partial(euroc, files=("mav0/cam0/sensor.yaml", "mav0/cam1/sensor.yaml")), FOUR
    ),
    Calibration("Kimera camera files", partial(euroc, files=("LeftCameraParams.yaml", "RightCameraParams.yaml")), FOUR),
    Calibration("VINS, pinhole", vins, FOUR),
    Calibration("VINS, MEI", vins, OMNI),
    Calibration("VINS, Kannala-Brandt", vins, FISHEYE),
    Calibration("OKVIS", okvis, FOUR),
    Calibration("OKVIS, equidistant", okvis, FISHEYE),
    Calibration("basalt, pinhole-radtan8", basalt, EIGHT),
    Calibration("basalt, kb4", basalt, FISHEYE),
    Calibration("basalt, ds", basalt, with_lens("double-sphere", (-0.2, 0.57), (-0.21, 0.58))),
    Calibration("mrcal, OPENCV5", mrcal),
    Calibration("MRPT", mrpt),
    Calibration("ORB-SLAM2, LEFT.K", partial(orb, form="LEFT")),
    Calibration("ORB-SLAM2, Camera.bf", partial(orb, form="bf"), PARALLEL),
    Calibration("ORB-SLAM3, Stereo.b", partial(orb, form="b"), PARALLEL),
    Calibration("ORB-SLAM3, Stereo.T_c1_c2", partial(orb, form="T"), FOUR),
    Calibration("ORB-SLAM3, KannalaBrandt8", partial(orb, form="T"), FISHEYE),
    Calibration("ROS camera_info, two files", ros_files),
    Calibration("ROS camera_info, ros2 topic echo", ros_echo),
    Calibration("ROS ost.txt", ost),
    Calibration("KITTI calib.txt", partial(kitti, form="P{n}: "), PARALLEL),
    Calibration("KITTI, two lines without names", partial(kitti, form=""), PARALLEL),
    Calibration("KITTI raw calib_cam_to_cam.txt", partial(cam_to_cam, numbers=("02", "03"))),
    Calibration("DrivingStereo", partial(cam_to_cam, numbers=("101", "103"))),
    Calibration("KITTI-360 perspective.txt", perspective, PARALLEL),
    Calibration("Middlebury calib.txt", middlebury, _SHIFTED),
    Calibration("Cityscapes camera.json", cityscapes, parallel(2262.5, (1096.98, 513.1), (2048, 1024), 0.209313)),
    Calibration(
        "Virtual KITTI intrinsic.txt", virtual_kitti, parallel(725.0087, (620.5, 187.0), (1242, 375), 0.532725)
    ),
    Calibration("FoundationStereo K.txt", foundation_stereo, PARALLEL),
)  # fmt: skip


def differences(read: StereoRig, expected: StereoRig) -> dict[str, float]:
    """Largest differences by kind of value; an unequal lens or size is infinite."""
    pairs = ((read.left, expected.left), (read.right, expected.right))
    matrices = [float(np.abs(one.matrix - other.matrix).max()) for one, other in pairs]
    lenses = [(one.lens, one.size_px, len(one.distortion)) == (other.lens, other.size_px, len(other.distortion))
              for one, other in pairs]  # fmt: skip
    lens = [
        float(np.abs(np.subtract(one.distortion, other.distortion)).max(initial=0.0))
        if is_equal
        else np.inf
        for is_equal, (one, other) in zip(lenses, pairs, strict=True)
    ]
    motions = np.abs(read.right_from_left - expected.right_from_left)
    return {
        "baseline_m": abs(read.baseline_m - expected.baseline_m),
        "matrix_px": max(matrices),
        "distortion": max(lens),
        "rotation": float(motions[:3, :3].max()),
        "translation_m": float(motions[:3, 3].max()),
    }

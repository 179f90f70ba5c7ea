"""Files of photogrammetry and SLAM: offsets and fractions in pixels, corners and centres of pixels, the order of
p1 and p2, and values that have places instead of names."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.support.error_messages import error_message
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.rig_formats.reading import load_camera, load_rig

SIZE = (1280, 720)
FISHEYE = "kannala-brandt"


def read(folder: Path, content: object, name: str = "calib.json", **options: Any) -> Any:
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return load_camera(path, size_px=options.pop("size_px", SIZE), **options)


def check(found: Any, matrix: list[float], distortion: list[float], lens: str = "pinhole") -> Any:
    camera, notes = found
    assert [camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px] == pytest.approx(matrix)
    assert list(camera.distortion) == pytest.approx(distortion)
    assert camera.lens == lens
    return " ".join(notes)


def refused(folder: Path, content: object, name: str) -> str:
    path = folder / name
    path.write_text(content if isinstance(content, str) else json.dumps(content))
    return error_message(RigError, load_camera, path, size_px=SIZE)


@pytest.mark.parametrize(
    ("row", "distortion", "lens"),
    [
        ("PINHOLE 1280 720 500 501 640 360", [], "pinhole"),
        ("SIMPLE_PINHOLE 1280 720 500 640 360", [], "pinhole"),
        ("SIMPLE_RADIAL 1280 720 500 640 360 0.1", [0.1, 0, 0, 0], "pinhole"),
        ("RADIAL 1280 720 500 640 360 0.1 0.02", [0.1, 0.02, 0, 0], "pinhole"),
        ("OPENCV 1280 720 500 501 640 360 0.1 0.02 3e-3 4e-3", [0.1, 0.02, 3e-3, 4e-3], "pinhole"),
        (
            "FULL_OPENCV 1280 720 500 501 640 360 1 2 3 4 5 6 7 8",
            [1, 2, 3, 4, 5, 6, 7, 8],
            "pinhole",
        ),
        ("OPENCV_FISHEYE 1280 720 500 501 640 360 0.1 0.02 0 0", [0.1, 0.02, 0, 0], FISHEYE),
        ("RADIAL_FISHEYE 1280 720 500 640 360 0.1 0.02", [0.1, 0.02, 0, 0], FISHEYE),
        ("SIMPLE_FISHEYE 1280 720 500 640 360", [0, 0, 0, 0], FISHEYE),
        ("FISHEYE 1280 720 500 501 640 360", [0, 0, 0, 0], FISHEYE),
    ],
)
def test_colmap(tmp_path: Path, row: str, distortion: list[float], lens: str) -> None:
    text = f"# Camera list\n# CAMERA_ID, MODEL, WIDTH, HEIGHT, PARAMS[]\n7 {row}\n"
    fy_px = 501 if " 501 " in row else 500
    check(read(tmp_path, text, "cameras.txt"), [500, fy_px, 639.5, 359.5], distortion, lens)


@pytest.mark.parametrize("model", ["FOV", "THIN_PRISM_FISHEYE", "NEW_MODEL"])
def test_colmap_models_without_a_lens(tmp_path: Path, model: str) -> None:
    assert f"'{model}'" in refused(
        tmp_path, f"1 {model} 1280 720 5 6 6 3 0.1 0 0 0\n", "cameras.txt"
    )


def test_colmap_with_two_cameras(tmp_path: Path) -> None:
    text = "1 PINHOLE 1280 720 500 501 640 360\n2 PINHOLE 1280 720 600 601 640 360\n"
    assert "the file has 1, 2" in refused(tmp_path, text, "cameras.txt")
    assert read(tmp_path, text, "cameras.txt", cameras=("2",))[0].fx_px == 600


NERF = {"fl_x": 500.0, "fl_y": 501.0, "cx": 640.0, "cy": 360.0, "w": 1280, "h": 720, "frames": []}


def test_nerfstudio(tmp_path: Path) -> None:
    matrix = [500, 501, 639.5, 359.5]
    brown = {"camera_model": "OPENCV", "k1": 0.1, "k2": 0.02, "p1": 3e-3, "p2": 4e-3}
    assert "r^8" not in check(read(tmp_path, NERF | brown), matrix, [0.1, 0.02, 3e-3, 4e-3])
    terms = {"k1": 0.1, "k2": 0.02, "k3": 0.01, "k4": 0.002}
    fisheye = {"camera_model": "OPENCV_FISHEYE", **terms}
    check(read(tmp_path, NERF | fisheye), matrix, [0.1, 0.02, 0.01, 0.002], FISHEYE)
    flag = {"is_fisheye": True, **terms, "p1": 0.0, "p2": 0.0}
    check(read(tmp_path, NERF | flag), matrix, [0.1, 0.02, 0.01, 0.002], FISHEYE)
    polynomial = {"camera_model": "OPENCV", **terms, "p1": 0.0, "p2": 0.0}
    assert "r^8" in check(read(tmp_path, NERF | polynomial), matrix, [0.1, 0.02, 0, 0, 0.01])
    check(read(tmp_path, NERF), matrix, [])


def test_opensfm(tmp_path: Path) -> None:
    size = {"width": 1280, "height": 720}
    brown = {"focal_x": 0.5, "focal_y": 0.51, "c_x": 0.01, "c_y": -0.02, "k1": 0.1, "k2": 0.02}
    brown |= {"p1": 3e-3, "p2": 4e-3, "k3": 0.01, "projection_type": "brown", **size}
    matrix = [640, 652.8, 639.5 + 12.8, 359.5 - 25.6]
    check(read(tmp_path, {"v2 dji 0.55": brown}), matrix, [0.1, 0.02, 3e-3, 4e-3, 0.01])
    plain = {"projection_type": "perspective", "focal": 0.5, "k1": 0.1, "k2": 0.02, **size}
    scene = [
        {
            "cameras": {"a": plain},
            "shots": {"1.jpg": {"rotation": [0, 0, 1], "translation": [1, 2, 3]}},
        }
    ]
    check(read(tmp_path, scene), [640, 640, 639.5, 359.5], [0.1, 0.02, 0, 0])
    fisheye = plain | {"projection_type": "fisheye"}
    check(read(tmp_path, {"a": fisheye}), [640, 640, 639.5, 359.5], [0.1, 0.02, 0, 0], FISHEYE)
    assert "'dual'" in refused(tmp_path, {"a": plain | {"projection_type": "dual"}}, "c.json")
    del fisheye["width"]
    assert "size of the images" in refused(tmp_path, {"a": fisheye}, "c.json")


def agisoft(**values: object) -> str:
    content = {"projection": "frame", "width": 1280, "height": 720, "f": 1000.0, **values}
    lines = "".join(f"<{key}>{value}</{key}>" for key, value in content.items())
    return f'<?xml version="1.0" encoding="UTF-8"?>\n<calibration>{lines}</calibration>'


def test_agisoft(tmp_path: Path) -> None:
    found = read(
        tmp_path, agisoft(cx=10, cy=-20, b1=3, k1=0.1, k2=0.02, k3=0.01, p1=3e-3, p2=4e-3), "c.xml"
    )
    check(found, [1003, 1000, 649.5, 339.5], [0.1, 0.02, 4e-3, 3e-3, 0.01])
    fisheye = agisoft(projection="fisheye", k1=0.1, k2=0.02, k3=0.01, k4=0.002, p1=3e-3)
    note = check(
        read(tmp_path, fisheye, "c.xml"),
        [1000, 1000, 639.5, 359.5],
        [0.1, 0.02, 0.01, 0.002],
        FISHEYE,
    )
    assert "p1 and p2 are left out" in note
    assert "r^8" not in note
    more_terms = agisoft(k1=0.1, k2=0.02, p1=3e-3, p2=4e-3, p3=1e-4, p4=0)
    note = check(
        read(tmp_path, more_terms, "c.xml"), [1000, 1000, 639.5, 359.5], [0.1, 0.02, 4e-3, 3e-3]
    )
    assert "p3 and p4 are left out" in note
    assert "'cylindrical'" in refused(tmp_path, agisoft(projection="cylindrical"), "c.xml")


@pytest.mark.parametrize(
    ("line", "matrix", "distortion", "lens"),
    [
        ("0.5 0.75 0.5 0.5 0", [640, 540, 639.5, 359.5], [], "pinhole"),
        ("Pinhole 500 501 640 360 0", [500, 501, 640, 360], [], "pinhole"),
        (
            "RadTan 500 501 640 360 .1 0.02 3e-3 4e-3",
            [500, 501, 640, 360],
            [0.1, 0.02, 3e-3, 4e-3],
            "pinhole",
        ),
        (
            "EquiDistant 500 501 640 360 0.1 0.02 0 0",
            [500, 501, 640, 360],
            [0.1, 0.02, 0, 0],
            FISHEYE,
        ),
        (
            "KannalaBrandt 500 501 640 360 0.1 0.02 0 0",
            [500, 501, 640, 360],
            [0.1, 0.02, 0, 0],
            FISHEYE,
        ),
    ],
)
def test_dso(
    tmp_path: Path, line: str, matrix: list[float], distortion: list[float], lens: str
) -> None:
    check(
        read(tmp_path, f"{line}\n1280 720\ncrop\n640 480\n", "camera.txt"), matrix, distortion, lens
    )


def test_dso_with_the_fov_model(tmp_path: Path) -> None:
    assert "field-of-view" in refused(
        tmp_path, "0.5 0.7 0.5 0.5 0.9\n1280 720\nfull\n640 480\n", "c.txt"
    )


def test_robotcar(tmp_path: Path) -> None:
    text = "983.0 984.0 643.5 493.25\n0 0 1 0\n1 0 0 0\n0 1 0 0\n0 0 0 1\n"
    note = check(
        read(tmp_path, text, "stereo_left.txt", size_px=(1280, 960)), [983, 984, 643.5, 493.25], []
    )
    assert "SDK has undistorted" in note


@pytest.mark.parametrize(
    ("name", "terms", "distortion", "lens"),
    [
        ("pinhole", {}, [], "pinhole"),
        ("pinhole_radial_k1", {"disto_k1": [0.1]}, [0.1, 0, 0, 0], "pinhole"),
        ("pinhole_radial_k3", {"disto_k3": [0.1, 0.02, 0.01]}, [0.1, 0.02, 0, 0, 0.01], "pinhole"),
        (
            "pinhole_brown_t2",
            {"disto_t2": [0.1, 0.02, 0.01, 3e-3, 4e-3]},
            [0.1, 0.02, 3e-3, 4e-3, 0.01],
            "pinhole",
        ),
        ("fisheye", {"fisheye": [0.1, 0.02, 0.01, 2e-3]}, [0.1, 0.02, 0.01, 2e-3], FISHEYE),
    ],
)
def test_openmvg(
    tmp_path: Path, name: str, terms: dict[str, Any], distortion: list[float], lens: str
) -> None:
    base = {"width": 1280, "height": 720, "focal_length": 500.0, "principal_point": [640.0, 360.0]}
    data = {"value0": base, **terms} if terms else base
    value = {"polymorphic_name": name, "ptr_wrapper": {"id": 1, "data": data}}
    pose = {"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, 1]], "center": [0, 0, 0]}
    content = {
        "views": [{"key": 0, "value": {"ptr_wrapper": {"id": 2, "data": {"filename": "a.jpg"}}}}],
        "intrinsics": [{"key": 0, "value": value}],
        "extrinsics": [{"key": 0, "value": pose}],
    }
    check(read(tmp_path, content, "sfm_data.json"), [500, 500, 640, 360], distortion, lens)


def test_meshroom_is_named(tmp_path: Path) -> None:
    content = {"intrinsics": [{"intrinsicId": "1", "pxInitialFocalLength": "500"}]}
    message = refused(tmp_path, content, "cameras.sfm")
    assert "AliceVision (Meshroom)" in message
    assert "cameras.txt" in message


def test_zod(tmp_path: Path) -> None:
    camera = {
        "intrinsics": [[500.0, 0, 640.0, 0], [0, 501.0, 360.0, 0], [0, 0, 1, 0]],
        "distortion": [0.1, 0.02, 0.01, 2e-3],
        "undistortion": [0.3, 0.2, 0.1, 0.0],
        "extrinsics": [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]],
        "image_dimensions": [1280, 720],
        "field_of_view": [120.0, 67.0],
    }
    note = check(
        read(tmp_path, {"FC": camera}), [500, 501, 640, 360], [0.1, 0.02, 0.01, 2e-3], FISHEYE
    )
    assert "Kannala-Brandt" in note


def test_argoverse(tmp_path: Path) -> None:
    cameras = [
        {
            "key": f"image_raw_{name}",
            "value": {
                "focal_length_x_px_": focal_px,
                "focal_length_y_px_": focal_px,
                "focal_center_x_px_": 640.0,
                "focal_center_y_px_": 360.0,
                "distortion_coefficients_": [0.1, 0.02, 0.01],
                "vehicle_SE3_camera_": {"translation": [1.0, 0.0, 1.0]},
            },
        }
        for name, focal_px in (("ring_front_center", 500.0), ("stereo_front_left", 900.0))
    ]
    content = {"camera_data_": cameras}
    assert "image_raw_stereo_front_left, image_raw_ring_front_center" in refused(
        tmp_path, content, "c.json"
    )
    found = read(tmp_path, content, cameras=("image_raw_ring_front_center",))
    check(found, [500, 500, 640, 360], [0.1, 0.02, 0, 0, 0.01])


def test_tables_of_arrow_are_named(tmp_path: Path) -> None:
    (tmp_path / "intrinsics.feather").write_bytes(b"ARROW1\x00\x00" + bytes(100))
    message = error_message(RigError, load_camera, tmp_path / "intrinsics.feather", size_px=SIZE)
    assert "Argoverse 2" in message


def storage(values: dict[str, tuple[int, int, list[float]]]) -> str:
    """OpenCV's FileStorage."""
    parts = [
        f"{name}: !!opencv-matrix\n   rows: {rows}\n   cols: {cols}\n   dt: d\n   data: {data}\n"
        for name, (rows, cols, data) in values.items()
    ]
    return '%YAML:1.0\n---\nnames:\n   - "01"\n   - "02"\n' + "".join(parts)


def test_easymocap(tmp_path: Path) -> None:
    """intri.yml and extri.yml, with numbers of two digits; x = R x_world + T."""
    intrinsics, extrinsics = {}, {}
    for number, x_m in ((1, 0.0), (2, -0.4)):
        intrinsics[f"K_0{number}"] = (3, 3, [500.0 + number, 0, 640, 0, 500, 360, 0, 0, 1])
        intrinsics[f"dist_0{number}"] = (1, 5, [0.1 * number, 0, 0, 0, 0])
        extrinsics[f"Rot_0{number}"] = (3, 3, [1.0, 0, 0, 0, 1, 0, 0, 0, 1])
        extrinsics[f"T_0{number}"] = (3, 1, [x_m, 0.0, 1.0])
    (tmp_path / "intri.yml").write_text(storage(intrinsics))
    assert load_camera(tmp_path / "intri.yml", size_px=SIZE, cameras=("camera2",))[0].fx_px == 502
    (tmp_path / "extri.yml").write_text(storage(extrinsics))
    rig, _ = load_rig(tmp_path / "intri.yml", size_px=SIZE)
    assert (rig.left.fx_px, rig.right.distortion[0]) == (501, 0.2)
    assert rig.baseline_m == pytest.approx(0.4)


@pytest.mark.parametrize("key", ["input_horizontal_stretch", "input_vertical_stretch"])
def test_profiles_of_stretched_images_are_refused(tmp_path: Path, key: str) -> None:
    params = {"camera_matrix": [[500, 0, 640], [0, 500, 360], [0, 0, 1]]}
    params["distortion_coeffs"] = [0.1, 0.0, 0.0, 0.0]
    content = {"fisheye_params": params, "calib_dimension": {"w": 1280, "h": 720}, key: 1.0}
    assert read(tmp_path, content)[0].fx_px == 500
    assert f"{key}: 0.75" in refused(tmp_path, content | {key: 0.75}, "c.json")


def test_two_cameras_of_opensfm_are_a_question(tmp_path: Path) -> None:
    """Cameras with a focal length and a size, but no principal point."""
    plain = {"projection_type": "perspective", "width": 1280, "height": 720, "k1": 0.1, "k2": 0.02}
    content = {"front": plain | {"focal": 0.5}, "back": plain | {"focal": 0.8}}
    assert "front, back" in refused(tmp_path, content, "camera_models.json")
    assert read(tmp_path, content, cameras=("back",))[0].fx_px == pytest.approx(1024)


def test_lists_of_cameras(tmp_path: Path) -> None:
    """The records of a table, as of Argoverse 2 or nuScenes."""
    camera = {"fx": 500.0, "fy": 500.0, "cx": 640.0, "cy": 360.0, "k1": 0.1, "k2": 0.0}
    content = [{"name": "front", **camera}, {"name": "rear", **camera, "fx": 700.0}]
    assert "front, rear" in refused(tmp_path, content, "cameras.json")
    assert read(tmp_path, content, cameras=("rear",))[0].fx_px == 700


def test_panoramas_without_a_matrix_are_named(tmp_path: Path) -> None:
    for key in ("projection_type", "polymorphic_name"):
        content = {"cameras": {"a": {key: "spherical", "width": 1280, "height": 720}}}
        assert "a panorama, 'spherical'" in refused(tmp_path, content, "c.json")


def test_stella_with_a_rectifier(tmp_path: Path) -> None:
    """x_rectified = R_left x_left = R_right x_right + (B, 0, 0), and f B of the rectified images."""
    turn = [0.8, 0.0, 0.6, 0.0, 1.0, 0.0, -0.6, 0.0, 0.8]
    rectifier = {f"{part}_{side}": value for side in ("left", "right") for part, value in (
        ("K", [500.0, 0, 640, 0, 500, 360, 0, 0, 1]), ("D", [0.1, 0, 0, 0, 0]), ("R", turn),
    )}  # fmt: skip
    rectified = {"model": "perspective", "fx": 450.0, "fy": 450.0, "cx": 640.0, "cy": 360.0}
    rectified |= {"focal_x_baseline": 54.0, "k1": 0.0, "k2": 0.0, "p1": 0.0, "p2": 0.0}
    lines = [
        f"{block}:\n" + "".join(f"  {key}: {value}\n" for key, value in values.items())
        for block, values in (("Camera", rectified), ("StereoRectifier", rectifier))
    ]
    (tmp_path / "stella.yaml").write_text("".join(lines))
    rig, _ = load_rig(tmp_path / "stella.yaml", size_px=SIZE)
    assert (rig.left.fx_px, rig.right.distortion[0]) == (500, 0.1)
    assert rig.right_from_left[:3, 3] == pytest.approx([-0.12 * 0.8, 0.0, -0.12 * 0.6])
    assert rig.right_from_left[:3, :3] == pytest.approx(np.eye(3))


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("cameras.xml", '<document version="2.0"> <chunk label="a"/></document>', "Metashape"),
        (
            "calib_results.txt",
            "#polynomial (ocam_model.ss in MATLAB)\n5 -7.2 0 1 2 3\n",
            "OCamCalib",
        ),
        ("fisheye.json", '{"MappingCoefficients": [8, 1, 0, 0], "ImageSize": [2, 2]}', "OCamCalib"),
        ("cameras.bin", "text", "model_converter"),
    ],
)
def test_named_refusals(tmp_path: Path, name: str, text: str, words: str) -> None:
    assert words in refused(tmp_path, text, name)


def test_repeated_elements_of_xml_are_cameras(tmp_path: Path) -> None:
    cameras = "".join(
        f"<camera><K>{f} 0 640 0 {f} 360 0 0 1</K><D>0.1 0 0 0 0</D></camera>" for f in (500, 700)
    )
    path = tmp_path / "c.xml"
    path.write_text(f"<rig><cameras>{cameras}</cameras></rig>")
    assert "camera camera1 of camera1, camera2" in load_camera(path, size_px=SIZE)[1][0]
    assert load_camera(path, size_px=SIZE, cameras=("camera2",))[0].fx_px == 700


@pytest.mark.parametrize("size", [[], [1280]])
def test_incomplete_sizes_are_refused(tmp_path: Path, size: list[int]) -> None:
    camera = {"K": [500, 0, 640, 0, 500, 360, 0, 0, 1], "D": [0.1, 0, 0, 0], "resolution": size}
    message = refused(tmp_path, {"cameras": {"cam0": camera}}, "c.json")
    assert "expected 2 numbers in cameras.cam0.resolution" in message


def test_values_of_a_region_are_refused(tmp_path: Path) -> None:
    content = {
        "K": [500, 0, 640, 0, 500, 360, 0, 0, 1],
        "D": [0.1, 0, 0, 0, 0],
        "width": 1280,
        "height": 720,
    }
    whole = content | {"roi": {"x_offset": 0, "y_offset": 0, "width": 0, "height": 0}}
    assert read(tmp_path, whole)[0].size_px == SIZE
    part = content | {"roi": {"x_offset": 100, "y_offset": 0, "width": 640, "height": 360}}
    assert "region of interest" in refused(tmp_path, part, "c.json")
    corner = content | {"roi": {"x_offset": 0, "y_offset": 0, "width": 640, "height": 360}}
    assert "roi.width: 640" in refused(tmp_path, corner, "c.json")

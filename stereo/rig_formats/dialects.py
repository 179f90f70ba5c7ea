"""Calibrations with matrices or numbers by name, from OpenCV, scripts, data sets and programs: one
row of a table for each kind of file.

The names of quantities in files are rows of `values.aliases.QUANTITIES`. A draft holds the values
that a file and those beside it state, and `values.resolution` makes a rig of it.
"""

import re
from functools import partial
from pathlib import Path

from track_range.stereo.geometry.rig_checks import RigCalibration
from track_range.stereo.rig_formats.rig_format import format_by_pattern
from track_range.stereo.rig_formats.values.containers import plain_values
from track_range.stereo.rig_formats.values.conventions import (
    from_centre,
    of_each_side,
    of_longer_side,
)
from track_range.stereo.rig_formats.values.dialect import PLAIN, Dialect, Unit
from track_range.stereo.rig_formats.values.draft import draft_of
from track_range.stereo.rig_formats.values.partners import completed
from track_range.stereo.rig_formats.values.resolution import resolved
from track_range.stereo.rig_formats.values.tables import (
    BASALT,
    COLMAP,
    DSO,
    K_AND_BASELINE,
    MRCAL,
    ROBOTCAR,
    VIRTUAL_KITTI,
)

# github.com/ethz-asl/kalibr, wiki: supported models, YAML formats; the intrinsics of a wide lens
# stand before fu. Files for other programs, such as OpenVINS's, have T_cam_imu instead of T_cn_cnm1.
KALIBR = Dialect(
    name="kalibr",
    title="Kalibr's camchain.yaml",
    # blocks at the top level, not blocks of scripts
    pattern=re.compile(r"^cam\d+\s*:(?!\s*\n\s+K\s*:)", re.MULTILINE),
    priority=-10,  # other files have cameras of such names
    metres_per_unit=1.0,
    missing="a block cam1 with T_cn_cnm1",
    is_ideal_without=True,
)
DIALECTS = (
    Dialect(
        name="middlebury",
        title="Middlebury's calib.txt",
        pattern=re.compile(r"^cam0\s*=\s*\[", re.MULTILINE),
        metres_per_unit=0.001,
        is_rectified=True,
    ),
    Dialect(
        name="cityscapes",
        title="Cityscapes' camera.json",
        pattern=re.compile(r'\A(?=[\s\S]*"baseline")[\s\S]*"u0"'),
        metres_per_unit=1.0,
        assumed={"size": [2048, 1024]},
        assumption="images of 2048x1024 px, the size of all Cityscapes images",
        is_rectified=True,
    ),
    Dialect(
        name="foundation-stereo",
        title="FoundationStereo's K.txt",
        pattern=K_AND_BASELINE,
        metres_per_unit=1.0,
        is_rectified=True,
    ),
    Dialect(
        name="virtual-kitti",
        title="Virtual KITTI's intrinsic.txt",
        pattern=VIRTUAL_KITTI,
        metres_per_unit=1.0,
        assumed={"baseline": 0.532725, "size": [1242, 375]},  # europe.naverlabs.com
        assumption="the baseline of Virtual KITTI 2 and its images of 1242x375 px",
        is_rectified=True,
    ),
    Dialect(
        name="orb-slam",
        title="ORB-SLAM's settings",
        pattern=re.compile(r"^(?:Camera1?\.fx|LEFT\.K)\s*:", re.MULTILINE),
        metres_per_unit=1.0,
        is_baseline_rectified=True,
    ),
    Dialect(
        name="matlab",
        title="MATLAB's stereoParameters",
        pattern=re.compile("(?i)RotationOfCamera2|RadialDistortion"),
        usual_unit=Unit(0.001, "assuming millimetres, MATLAB's default"),
        first_pixel=1.0,
    ),
    Dialect(
        name="realsense-json",
        title="RealSense's intrinsics and extrinsics in JSON",
        pattern=re.compile(r'"(?:ppx|PPX)"'),
        metres_per_unit=1.0,
    ),
    Dialect(  # projects.asl.ethz.ch, kmavvisualinertialdatasets; x_body = T_BS x_camera
        name="euroc",
        title="EuRoC's sensor.yaml",
        pattern=re.compile(r"^T_BS\s*:", re.MULTILINE),
        metres_per_unit=1.0,
        missing="the file of the other camera beside it, cam0/sensor.yaml and cam1/sensor.yaml, or "
        "LeftCameraParams.yaml and RightCameraParams.yaml",
    ),
    KALIBR,
    Dialect(
        name="colmap",
        title="COLMAP's cameras.txt",
        pattern=COLMAP,
        first_pixel=0.5,
        is_ideal_without=True,
    ),
    Dialect(
        name="nerfstudio",
        title="transforms.json of nerfstudio or instant-ngp",
        pattern=re.compile(r'"fl_x"'),
        first_pixel=0.5,
        is_ideal_without=True,
        has_radial_k4=True,
    ),
    Dialect(
        name="opensfm",
        title="cameras.json of OpenDroneMap or OpenSfM",
        pattern=re.compile(r'\A(?=[\s\S]*"projection_type")[\s\S]*"focal(?:_x)?"'),
        first_pixel=0.5,
        convention=of_longer_side,
        assumed={"cx": 0.0, "cy": 0.0},
        is_ideal_without=True,
    ),
    Dialect(
        name="agisoft",
        title="Agisoft Metashape's calibration",
        pattern=re.compile(r"\A(?=[\s\S]*<projection>)[\s\S]*<f>"),
        first_pixel=0.5,
        convention=from_centre,
        assumed={"cx": 0.0, "cy": 0.0},
        is_ideal_without=True,
        has_radial_k4=True,
        is_tangential_swapped=True,
    ),
    Dialect(
        name="photoscan",
        title="Agisoft PhotoScan's calibration",
        pattern=re.compile(r"\A(?=[\s\S]*<projection>)[\s\S]*<fx>"),
        first_pixel=0.5,
        is_ideal_without=True,
        has_radial_k4=True,
        is_tangential_swapped=True,
    ),
    Dialect(
        name="dso",
        title="DSO's camera.txt",
        pattern=DSO,
        convention=of_each_side,
        is_ideal_without=True,
    ),
    Dialect(
        name="robotcar",
        title="RobotCar's camera model",
        pattern=ROBOTCAR,
        is_ideal_without=True,
        assumption="images that the data set's SDK has undistorted",
    ),
    Dialect(
        name="mrcal",
        title="mrcal's .cameramodel",
        pattern=MRCAL,
        metres_per_unit=1.0,
        is_ideal_without=True,
    ),
    Dialect(
        name="basalt",
        title="basalt's calibration.json",
        pattern=BASALT,
        metres_per_unit=1.0,
        is_ideal_without=True,
    ),
    Dialect(
        name="mrpt",
        title="MRPT's stereo camera",
        pattern=re.compile(r"^[^\S\n]*\[CAMERA_PARAMS_LEFT2RIGHT_POSE\]", re.MULTILINE),
        metres_per_unit=1.0,
    ),
    Dialect(
        name="openmvg",
        title="OpenMVG's sfm_data.json",
        pattern=re.compile('"ptr_wrapper"'),
        is_ideal_without=True,
    ),
    Dialect(
        name="zod",
        title="the Zenseact Open Dataset's calibration.json",
        pattern=re.compile(r'\A(?=[\s\S]*"undistortion")[\s\S]*"field_of_view"'),
        assumed={"distortion_model": "kannala_brandt"},
        assumption="the fisheye model (Kannala-Brandt) of all cameras of the data set",
    ),
    Dialect(
        name="argoverse",
        title="Argoverse's vehicle_calibration_info.json",
        pattern=re.compile('"camera_data_"'),
        has_radial_only=True,
    ),
    Dialect(
        name="gyroflow",
        title="Gyroflow's lens profile",
        pattern=re.compile('"fisheye_params"'),
        assumed={"distortion_model": "opencv_fisheye"},  # unless the file states another one
    ),
    Dialect(
        name="stella",
        title="stella_vslam's settings",
        pattern=re.compile(r"^[ \t]*+(?:Camera\.)?focal_x_baseline\s*+:", re.MULTILINE),
        metres_per_unit=1.0,
        is_baseline_rectified=True,
    ),
    Dialect(
        name="opencv",
        title="the files of OpenCV's stereo_calib",
        pattern=re.compile("opencv-matrix|<opencv_storage>"),
        priority=-10,  # other programs write OpenCV's files, too
        expected="a calibration of OpenCV",
    ),
    PLAIN,
)
"""Kinds of files."""


def read_dialect(dialect: Dialect, text: str, path: Path, *, is_pair: bool) -> RigCalibration:
    """The cameras of a file of a dialect; with the files beside it that complete a pair, if
    `is_pair`.
    """
    draft = draft_of(plain_values(text, path, dialect.expected), path, dialect)
    return resolved(completed(draft, is_pair=is_pair), is_pair=is_pair)


FORMATS = {
    dialect.name: format_by_pattern(
        dialect.name,
        dialect.title,
        dialect.pattern,
        partial(read_dialect, dialect, is_pair=False),
        dialect.missing,
        partial(read_dialect, dialect, is_pair=True),
        dialect.priority,
    )
    for dialect in DIALECTS
}
READ_ONLY = tuple(form for name, form in FORMATS.items() if name != "opencv")

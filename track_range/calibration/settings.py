"""Options of calibration, alignment and the evaluation of stereo matchers."""

from pathlib import Path
from typing import Annotated, Any

from track_range.foundation.schemas.options import Options, option
from track_range.ranging.evaluation.settings import StereoModelField
from track_range.recording.speed_source import AUTO
from track_range.recording.video.layouts import LayoutOption

_ROAD = "From a drive, without a board"  # heading of the options of this calibration
_BASELINE = "Check of the baseline"
_KNOWN_BOX: dict[str, Any] = {"metavar": "BOX=M", "panel": _ROAD, "is_repeated": True}
OFF, LEAVE_TWO_OUT = "off", "leave-two-out"  # values of --align that name no file


_Stereo = Annotated[
    tuple[Path, Path] | None,
    option(
        "Left and right video of a drive past static objects (buildings, parked cars, trees), or "
        "one video with the images of both cameras.",
        metavar="LEFT RIGHT|BOTH",
    ),
]

_StereoLayout = Annotated[
    LayoutOption,
    option(
        "Layout of one video with the images of both cameras: beside or below each other, the left "
        "camera's image first or second, or two video tracks (default: as the file, its name or "
        "the images show)."
    ),
]

_Drives = Annotated[
    tuple[Path, ...],
    option(
        "Folder with left.mp4 and right.mp4; repeat the option for further drives with the same "
        "rig.",
        flag="--drive",
        metavar="DIR",
        is_repeated=True,
    ),
]

_Rig = Annotated[
    Path | None,
    option("Calibration file (default: the calibration file in the folder of the images)."),
]


class BaselineOptions(Options):
    """Evidence of the baseline, which the images of a rig alone do not show."""

    detector: Annotated[
        str | None,
        option(
            "Detector of road users, whose sizes check the baseline: a name or an ONNX file.",
            panel=_BASELINE,
        ),
    ] = None
    detections: Annotated[
        Path | None,
        option(
            "File with boxes of road users, instead of a detector.", panel=_BASELINE, metavar="FILE"
        ),
    ] = None
    ego_speed: Annotated[
        str | None,
        option(
            "Speed of the camera, which checks the baseline: a constant in km/h, a file, or "
            "KITTI's oxts folder.",
            panel=_BASELINE,
            metavar="KMH|FILE|DIR",
        ),
    ] = None

    @property
    def checks_baseline(self) -> bool:
        """Whether there is evidence of the baseline."""
        return any(value is not None for value in (self.detector, self.detections, self.ego_speed))


class BoardOptions(Options):
    """Images, board and output files of `track-range calibrate`."""

    mono: Annotated[
        str | None,
        option(
            "Images of one camera: a pattern in quotes ('boards/*.jpg'), a folder, or a video; "
            "without --board, images of a drive.",
            metavar="IMAGES",
        ),
    ] = None
    stereo: Annotated[
        tuple[str, str] | None,
        option(
            "Images of the left and the right camera: patterns in quotes, folders, or videos; or "
            "one of these with the images of both cameras.",
            metavar="LEFT RIGHT|BOTH",
        ),
    ] = None
    stereo_layout: _StereoLayout = "auto"
    board: Annotated[
        str | None,
        option(
            "Board: MxN inner corners of a chessboard, in a row and in a column, such as 9x6, or a "
            "ChArUco board with MxN squares, charuco:MxN:SQUARE_MM:MARKER_MM[:DICTIONARY].",
            metavar="BOARD",
        ),
    ] = None
    square_mm: Annotated[
        float | None, option("Side length of the chessboard's squares in mm.", metavar="MM")
    ] = None
    lens: Annotated[
        str,
        option(
            "Lens model: pinhole, or fisheye (Kannala-Brandt) for fields of view from about 100 "
            "degrees.",
            metavar="pinhole|fisheye",
        ),
    ] = "pinhole"
    lens_terms: Annotated[
        int,
        option(
            "Number of distortion coefficients of a pinhole camera: 4 = k1 k2 p1 p2; 5 adds k3; 8 "
            "adds k4 k5 k6.",
            metavar="0|4|5|8",
        ),
    ] = 5
    out: Annotated[Path, option("Calibration file to write, rig.yaml.", metavar="FILE")]
    picture: Annotated[
        Path | None,
        option(
            "Picture of the residuals and the image coverage (default: beside --out).",
            metavar="FILE.png",
        ),
    ] = None
    json_file: Annotated[
        Path | None, option("JSON file for the results.", flag="--json", metavar="FILE")
    ] = None


class RoadOptions(Options):
    """What is known of a camera that is calibrated from its drives."""

    known_distance: Annotated[
        tuple[str, ...],
        option(
            "Known distance of an object, along the camera's axis to its nearest surface, with its "
            "box in pixels of the video T_S seconds after the start: 'T_S,X1,Y1,X2,Y2=12.4'; if "
            "the detector does not find the object, add a class after Y2: "
            "'T_S,X1,Y1,X2,Y2,van=12.4'. Repeat the option for further objects.",
            **_KNOWN_BOX,
        ),
    ] = ()
    known_height: Annotated[
        tuple[str, ...], option("Known height of an object, with its box as above.", **_KNOWN_BOX)
    ] = ()
    known_width: Annotated[
        tuple[str, ...],
        option(
            "Known width of an object seen from behind or the front, with its box as above.",
            **_KNOWN_BOX,
        ),
    ] = ()
    known_lane_width: Annotated[
        tuple[str, ...],
        option(
            "Known distance between two lane lines, with their columns in one row: "
            "'T_S,X1,X2,Y=3.5'.",
            metavar="ROW=M",
            panel=_ROAD,
            is_repeated=True,
        ),
    ] = ()
    camera_height_m: Annotated[
        float | None,
        option(
            "Measured height of the camera above the road in m.",
            metavar="M",
            panel=_ROAD,
            gt=0.2,
            le=5,
        ),
    ] = None
    force: Annotated[
        bool,
        option(
            "Output of the calibration even if the measurements contradict each other.", panel=_ROAD
        ),
    ] = False
    camera_model: Annotated[
        str | None,
        option(
            "Camera model with a published field of view, such as 'comma EON'.",
            metavar="NAME",
            panel=_ROAD,
        ),
    ] = None
    lens_fov_deg: Annotated[
        str | None,
        option(
            "Field of view as on the box of the camera, in degrees with the side that it is across: "
            "140d diagonal, 120h horizontal, 70v vertical.",
            metavar="DEG",
            panel=_ROAD,
        ),
    ] = None
    detector: Annotated[
        str | None,
        option(
            "Detector of the road users, a name or an ONNX file (default: the packaged detector).",
            panel=_ROAD,
        ),
    ] = None
    curves: Annotated[
        Path | None,
        option(
            "Size curves, written by `track-range fit` (default: the packaged curves).", panel=_ROAD
        ),
    ] = None


class DriveInputs(Options):
    """Recordings and output files of `track-range calibrate drive`."""

    recordings: Annotated[
        tuple[str, ...],
        option(
            "Recordings of one camera: videos, or folders of images; all of them give one estimate, "
            "which narrows with each.",
            metavar="VIDEO...",
            is_argument=True,
            is_repeated=True,
        ),
    ]
    rig: Annotated[
        Path | None,
        option(
            "Calibration file of the same camera from earlier recordings, from whose estimate and "
            "standard deviations this one continues."
        ),
    ] = None
    ego_speed: Annotated[
        str,
        option(
            "Speed of the camera, which shows the focal length on a straight road: from GPS records "
            "in the videos or in files beside them (auto), unknown (off), or of a single recording "
            "a constant in km/h, a file, or KITTI's oxts folder.",
            words=("auto", "off"),
            metavar="KMH|FILE|DIR",
        ),
    ] = AUTO
    out: Annotated[
        Path | None,
        option("Calibration file to write, rig.yaml (default: the estimate is only printed)."),
    ] = None
    json_file: Annotated[
        Path | None, option("JSON file for the results.", flag="--json", metavar="FILE")
    ] = None


class DriveSettings(RoadOptions, DriveInputs):
    """Options of `track-range calibrate drive`."""


class GroundCalibrationSettings(Options):
    """Options of `track-range calibrate ground`."""

    recording: Annotated[
        str,
        option("Video of the camera, or a folder of images.", metavar="VIDEO", is_argument=True),
    ]
    known_point: Annotated[
        tuple[str, ...],
        option(
            "Point of the road in px and in metres: '410,620=0,0'; at least four of them, or lengths "
            "besides. Repeat the option for further points.",
            metavar="X,Y=X_M,Y_M",
            is_repeated=True,
        ),
    ] = ()
    known_length: Annotated[
        tuple[str, ...],
        option(
            "Length on the road between two pixels, in metres: '410,620,905,622=7.0'. Repeat the "
            "option for further lengths.",
            metavar="X1,Y1,X2,Y2=M",
            is_repeated=True,
        ),
    ] = ()
    known_parallel: Annotated[
        tuple[str, ...],
        option(
            "Two lines on the road that are parallel, such as kerbs, by two pixels of each: "
            "'300,700,610,250,980,700,690,250'. Repeat the option for further pairs.",
            metavar="X1,Y1,...,X4,Y4",
            is_repeated=True,
        ),
    ] = ()
    rig: Annotated[
        Path | None,
        option("Calibration file of the camera (default: none, or that beside the video)."),
    ] = None
    focal_px: Annotated[
        float | None, option("Focal length in px, if it is known.", metavar="PX", gt=0)
    ] = None
    camera_height_m: Annotated[
        float | None,
        option("Measured height of the camera above the road in m.", metavar="M", gt=0.2, le=60),
    ] = None
    pitch_deg: Annotated[
        float | None,
        option(
            "Measured pitch of the camera in degrees, positive = down.",
            metavar="DEG",
            ge=-10,
            le=90,
        ),
    ] = None
    at_s: Annotated[
        float, option("Time of the image in the video, in seconds.", flag="--at", metavar="S", ge=0)
    ] = 0.0
    out: Annotated[Path, option("File to write, ground.yaml.", metavar="FILE")] = Path(
        "ground.yaml"
    )
    picture: Annotated[
        Path | None,
        option("Picture of the fit to write: a grid of 5 m on the road.", metavar="FILE.png"),
    ] = None


class CalibrationSettings(RoadOptions, BoardOptions):
    """Options of `track-range calibrate`, with a board or from one drive."""

    @property
    def is_from_road(self) -> bool:
        """Whether one camera is calibrated from a drive, instead of images of a board."""
        return self.board is None and self.stereo is None

    @property
    def of_drive(self) -> DriveSettings:
        """The settings of a calibration from the drive `mono`."""
        known = {name: getattr(self, name) for name in RoadOptions.model_fields}
        recordings = () if self.mono is None else (self.mono,)
        return DriveSettings(recordings=recordings, out=self.out, json_file=self.json_file, **known)


class AlignmentSettings(BaselineOptions):
    """Drives or references, and output files, of `track-range align`."""

    stereo: _Stereo = None
    stereo_layout: _StereoLayout = "auto"
    drives: _Drives = ()
    reference: Annotated[
        Path | None,
        option(
            "Objects at known distances: a folder in KITTI 2015's layout or of a labelled drive; "
            "with --stereo, KITTI tracking labels or a CSV with frame, x1, y1, x2, y2 and "
            "distance_m or disparity_px.",
            metavar="DIR|LABELS|CSV",
        ),
    ] = None
    rig: _Rig = None
    out: Annotated[
        Path, option("Alignment file to write, for the option --align of a run.", metavar="FILE")
    ]
    seed: Annotated[
        int, option("Random seed for the resampling that estimates the uncertainty.", ge=0)
    ] = 0
    json_file: Annotated[
        Path | None, option("JSON file for the results.", flag="--json", metavar="FILE")
    ] = None


class RigCheckSettings(BaselineOptions):
    """Drives of `track-range rig check`."""

    stereo: _Stereo = None
    stereo_layout: _StereoLayout = "auto"
    drives: _Drives = ()
    rig: _Rig = None
    json_file: Annotated[
        Path | None, option("JSON file for the results.", flag="--json", metavar="FILE")
    ] = None


class StereoEvaluationSettings(Options):
    """Matchers and stereo pairs of `track-range evaluate stereo`."""

    pairs: Annotated[
        Path,
        option(
            "Folder in KITTI 2015's layout (image_2, image_3, disp_occ_0, obj_map, calib.txt), or "
            "of a drive or of single pairs (left.mp4, right.mp4 or folders left, right of images, "
            "rig.yaml or calib.txt, and truth.csv, truth.txt or label.txt).",
            metavar="DIR",
        ),
    ]
    truth: Annotated[
        tuple[Path, ...],
        option(
            "File of objects with known distances of such a folder; repeat the option for further "
            "files, whose objects are added (default: the first one above that exists).",
            metavar="FILE",
            is_repeated=True,
        ),
    ] = ()
    rig: Annotated[
        Path | None, option("Calibration file (default: the calibration file in the folder).")
    ] = None
    matchers: Annotated[
        tuple[str, ...],
        option(
            "Matchers to evaluate: patch, sgbm, and OpenCV's other SGBM modes sgbm-3way, "
            "sgbm-5way, sgbm-hh, sgbm-hh4; with -centre appended (not patch), the disparity at the "
            "box centre is used.",
            flag="--matcher",
            metavar="A,B,...",
            min_length=1,
        ),
    ] = ("patch", "sgbm", "sgbm-centre", "sgbm-hh")
    stereo_model: StereoModelField = ()
    align: Annotated[
        str,
        option(
            "Disparity correction: an alignment file, none (off), or cross-validated, leaving two "
            "pairs out at a time.",
            metavar="FILE|off|leave-two-out",
        ),
    ] = OFF
    seed: Annotated[int, option("Random seed for the bootstrap intervals.", ge=0)] = 0

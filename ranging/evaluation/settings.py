"""RangeEvaluationSettings: options of the evaluation of distances on labelled boxes."""

from pathlib import Path
from typing import Annotated, Literal

from track_range.foundation.schemas.options import Options, option
from track_range.ranging.size_models.region import Region
from track_range.ranging.truth.reference_distance import ReferenceName

BoxesField = Annotated[
    str,
    option(
        "Boxes to measure from: labelled boxes, or detections DIR/{Car,Pedestrian}/NAME.txt.",
        metavar="labels|rrc:DIR",
    ),
]
NoiseField = Annotated[
    float,
    option(
        "Standard deviation in pixels of noise added to the edges of the boxes.",
        metavar="PX",
        ge=0.0,
        le=50.0,
    ),
]
NoiseSeedField = Annotated[int, option("Random seed for the noise.", ge=0)]
RegionField = Annotated[
    Region,
    option("Region of the recordings, whose road users differ in size; KITTI is from europe."),
]
TimesField = Annotated[
    Path | None,
    option(
        "Folder of the times of the frames, named like the labels: NAME.csv with a column time_s, "
        "or NAME.txt with a time in each line (default: the folder times, timestamps or ego beside "
        "the labels; else KITTI's mean interval for its cameras, and 10 Hz for others).",
        metavar="DIR",
    ),
]
FrameRateField = Annotated[
    float | None,
    option(
        "Frames per second of the labels, instead of their times.",
        flag="--frame-rate",
        metavar="HZ",
        ge=0.1,
        le=1000.0,
    ),
]
DepthModelField = Annotated[
    tuple[Path, ...],
    option(
        "Network that gives the depth of each pixel of one image, metric or relative: the method "
        "depth; repeat the option for further networks, with the names of their files: depth-NAME.",
        metavar="FILE.onnx",
        is_repeated=True,
    ),
]
StereoModelField = Annotated[
    tuple[Path, ...],
    option(
        "Network that gives the disparity of each pixel of a rectified pair: the method disparity; "
        "repeat the option for further networks, with the names of their files: disparity-NAME.",
        metavar="FILE.onnx",
        is_repeated=True,
    ),
]


class RangeEvaluationSettings(Options):
    """Methods, boxes and labels of `track-range evaluate ranges`."""

    labels: Annotated[
        Path,
        option(
            "Folder of KITTI tracking labels, NAME.txt for each sequence, or one such file.",
            metavar="DIR|FILE",
        ),
    ]
    calib: Annotated[
        Path,
        option(
            "Folder of calibration files (KITTI, rig.yaml and others), named like the labels, or the "
            "file of all sequences.",
            metavar="DIR|FILE",
        ),
    ]
    boxes: BoxesField = "labels"
    noise_px: NoiseField = 0.0
    seed: NoiseSeedField = 0
    filter: Annotated[
        Literal["none", "paper", "default"],
        option("Filter of the distances of each track over time."),
    ] = "none"
    cross_validate: Annotated[
        bool,
        option(
            "Cross-validation: size curves refitted for each sequence on the boxes of the "
            "other sequences."
        ),
    ] = False
    same_drive: Annotated[
        bool,
        option(
            "Size curves fitted to the sequence that they are evaluated on, as Zhang et al. did "
            "(too optimistic)."
        ),
    ] = False
    fit_on: Annotated[
        Literal["labels", "boxes"],
        option(
            "Boxes that size curves are fitted to: labelled boxes, or the boxes of --boxes and "
            "--noise-px."
        ),
    ] = "labels"
    frames: Annotated[
        Path | None,
        option(
            "File of frame names, one per line, such as val.txt of a split of KITTI's object set.",
            metavar="FILE",
        ),
    ] = None
    fit_frames: Annotated[
        Path | None,
        option(
            "File of frame names that all size curves are fitted to, such as train.txt.",
            metavar="FILE",
        ),
    ] = None
    split: Annotated[
        str | None,
        option(
            "Split of KITTI's object set, for --frames and --fit-frames: a folder with val.txt and "
            "train.txt; chen = the folder ImageSets beside the labels or above them, where most "
            "copies have Chen's split.",
            metavar="chen|DIR",
        ),
    ] = None
    objects: Annotated[
        Literal["visible", "all"],
        option(
            "Objects to evaluate: visible objects at 5-100 m, or all objects with a 3-D box, "
            "including cut off, hidden and far objects."
        ),
    ] = "visible"
    truth: Annotated[
        ReferenceName,
        option(
            "True distance: visible surface, centre of the 3-D box, or 10th percentile of its "
            "lidar points."
        ),
    ] = "surface"
    velodyne: Annotated[
        Path | None, option("Folder of lidar files NAME.bin, for --truth lidar.", metavar="DIR")
    ] = None
    methods: Annotated[
        tuple[str, ...],
        option(
            "Ranging methods to evaluate: names, several joined by + for their fusion, or "
            "MODULE:OBJECT of a RangingMethod (default: all that can measure).",
            metavar="A,B,...",
            old_names=("method",),
        ),
    ] = ()
    images: Annotated[
        Path | None,
        option(
            "Images of the labels, for methods that need them: a folder with a folder "
            "of PNG or JPG "
            "images, or a video, for each sequence, named like the labels (the images or the video "
            "themselves for one file of labels).",
            metavar="DIR",
        ),
    ] = None
    right_images: Annotated[
        Path | None,
        option("The same of the right cameras, for methods that need a pair.", metavar="DIR"),
    ] = None
    align: Annotated[
        str,
        option(
            "Disparity correction of the pairs: estimated from their images as in a "
            "run, none (off), "
            "or an alignment file.",
            metavar="auto|off|FILE",
        ),
    ] = "auto"
    depth_model: DepthModelField = ()
    stereo_model: StereoModelField = ()
    curves: Annotated[
        Path | None,
        option("Size curves of the mono method (default: the packaged curves).", metavar="FILE"),
    ] = None
    region: RegionField = "unknown"
    times: TimesField = None
    frame_rate_hz: FrameRateField = None
    camera_height_m: Annotated[
        float | None,
        option(
            "Height of the camera above the road in metres (default: estimated from the boxes).",
            flag="--camera-height",
            metavar="M",
            ge=0.3,
            le=5.0,
        ),
    ] = None

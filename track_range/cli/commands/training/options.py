"""Options of `track-range train`, `track-range anchors` and `track-range pseudo-label`."""

from pathlib import Path
from typing import Annotated, Literal

from track_range.foundation.schemas.options import Options, option
from track_range.run.options.detection import DeviceField, SizeField, ThreadsField

_DATA, _TRAINING, _OUTPUT, _VARIANTS = "Data and network", "Training", "Output", "Network variants"

_Data = Annotated[
    Path,
    option(
        "Data set in YOLO's format (keys path, train, val, names), or with KITTI labels (`format: "
        "kitti`); optional keys manifest and labels_pseudo for images with incomplete labels "
        "(docs/how-to/detectors.md).",
        metavar="data.yaml",
        panel=_DATA,
    ),
]
_Size = Annotated[
    int,
    option(
        "Side length of the training images in pixels, a multiple of 32.",
        flag="--size",
        metavar="PX",
        panel=_TRAINING,
        ge=64,
        le=2048,
    ),
]
_Seed = Annotated[
    int,
    option(
        "Random seed for initial weights, augmentation and order.",
        panel=_TRAINING,
        ge=0,
        le=2**63 - 1,
    ),
]


class AnchorOptions(Options):
    """Options of `track-range anchors`."""

    data: _Data
    size_px: _Size = 416
    clusters: Annotated[
        int,
        option("Number of anchors; YOLOv4-tiny has 6, YOLOv5 has 9.", panel=_TRAINING, ge=2, le=32),
    ] = 9
    seed: _Seed = 0


class TrainOptions(Options):
    """Options of `track-range train`."""

    data: _Data
    model: Annotated[
        Literal["road", "yolov5n", "yolov5s", "yolov4-tiny"],
        option("Network to train; road = the network of the packaged detector.", panel=_DATA),
    ] = "yolov5n"
    size_px: _Size = 416
    n_epochs: Annotated[
        int, option("Number of epochs.", flag="--epochs", panel=_TRAINING, ge=1)
    ] = 100
    batch_size: Annotated[
        int,
        option(
            "Number of images per optimisation step.",
            flag="--batch",
            panel=_TRAINING,
            ge=1,
            le=1024,
        ),
    ] = 16
    out: Annotated[
        Path,
        option(
            "Folder of the run: checkpoints, results.csv, curves.png and the ONNX file.",
            metavar="DIR",
            panel=_OUTPUT,
        ),
    ] = Path("track-range-training")
    resume: Annotated[
        bool,
        option(
            "Whether to resume the interrupted run in --out; its other options must be repeated.",
            panel=_OUTPUT,
        ),
    ] = False
    device: Annotated[
        str,
        option(
            "Device to train on; auto = a GPU if there is one, else the CPU.",
            metavar="auto|cpu|cuda",
            panel=_TRAINING,
        ),
    ] = "auto"
    attention: Annotated[
        Literal["none", "cbam"], option("Attention module in the backbone blocks.", panel=_VARIANTS)
    ] = "none"
    box_loss: Annotated[
        Literal["ciou", "eiou"], option("Regression loss of the boxes.", panel=_VARIANTS)
    ] = "ciou"
    anchors: Annotated[
        Literal["default", "kmeans++"],
        option(
            "Anchors: the defaults of the network, or fitted to the boxes of the training data.",
            panel=_VARIANTS,
        ),
    ] = "default"
    teacher: Annotated[
        str | None,
        option(
            "Teacher network (ONNX file of a YOLOv5n or YOLOv5s); RoadNet also learns from its "
            "features, a YOLOv5 from its outputs.",
            metavar="FILE|NAME",
            panel=_DATA,
        ),
    ] = None
    weights: Annotated[
        tuple[Path, ...],
        option(
            "Checkpoint of another run that provides the initial weights; its anchors are not "
            "used. RoadNet can also start from the backbone and neck of a YOLOv5n. Repeat the "
            "option for the mean of several checkpoints of one run.",
            metavar="best.pt",
            is_repeated=True,
            panel=_DATA,
        ),
    ] = ()
    optimiser: Annotated[Literal["adamw", "sgd"], option("Optimiser.", panel=_TRAINING)] = "adamw"
    learning_rate: Annotated[
        float | None,
        option(
            "Learning rate (default: 0.002 for adamw, 0.01 for sgd).",
            panel=_TRAINING,
            ge=1e-6,
            le=1.0,
        ),
    ] = None
    gain: Annotated[
        tuple[float, float],
        option(
            "Smallest and largest scale of the training images, relative to --size.",
            metavar="MIN MAX",
            panel=_TRAINING,
        ),
    ] = (0.5, 1.5)
    mosaic: Annotated[
        float,
        option(
            "Fraction of the training images that are mosaics of four images.",
            metavar="FRACTION",
            panel=_TRAINING,
            ge=0.0,
            le=1.0,
        ),
    ] = 0.9
    last_epochs: Annotated[
        int,
        option("Number of epochs at the end without mosaics.", metavar="N", panel=_TRAINING, ge=0),
    ] = 0
    int8_epochs: Annotated[
        int,
        option(
            "Number of epochs at the end in which the rounding of INT8 weights and activations is "
            "simulated, so that `models quantize` loses less accuracy.",
            metavar="N",
            panel=_TRAINING,
            ge=0,
        ),
    ] = 0
    precision: Annotated[
        Literal["auto", "float32", "bfloat16", "float16"],
        option(
            "Number format for training; auto = the fastest format on the device.", panel=_TRAINING
        ),
    ] = "auto"
    validate_every: Annotated[
        int, option("Number of epochs between validations.", metavar="N", panel=_TRAINING, ge=1)
    ] = 1
    n_threads: Annotated[
        int,
        option(
            "Number of CPU threads; 0 = one per core.",
            flag="--threads",
            panel=_TRAINING,
            ge=0,
            le=256,
        ),
    ] = 0
    seed: _Seed = 0
    licence: Annotated[
        str, option("Licence of the weights, stored in the ONNX file.", metavar="TEXT", panel=_DATA)
    ] = ""


class PseudoLabelOptions(Options):
    """Options of `track-range pseudo-label`."""

    data: Annotated[
        Path,
        option(
            "Data set in YOLO's format, usually with a manifest of the classes that are completely "
            "labelled in each image; detections in its labels_pseudo are combined with the "
            "detectors (docs/how-to/detectors.md).",
            metavar="data.yaml",
        ),
    ]
    models: Annotated[
        tuple[str, ...],
        option(
            "Detector: an ONNX file, or a name from `track-range models list`; repeat the option "
            "for an ensemble.",
            flag="--model",
            metavar="FILE|NAME",
            is_repeated=True,
        ),
    ]
    out: Annotated[
        Path,
        option(
            "Folder of the pseudo-labels: a file NAME.txt for each training image.", metavar="DIR"
        ),
    ]
    resume: Annotated[bool, option("Whether to continue the interrupted run in --out.")] = False
    min_probability: Annotated[
        float,
        option(
            "Minimum probability of pseudo-labels of classes that are not completely labelled.",
            metavar="P",
            ge=0.0,
            le=1.0,
        ),
    ] = 0.1
    size_px: SizeField = None
    threads: ThreadsField = 0
    device: DeviceField = "auto"

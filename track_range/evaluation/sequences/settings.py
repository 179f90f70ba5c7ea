"""Options of tracking labelled sequences, and of evaluating tracks and detectors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from track_range.detection.evaluation.matching import SizeMeasure
from track_range.detection.formats.image_labels.labelled_images import IMAGE_LABELS
from track_range.detection.formats.label_formats import LABEL_FORMATS
from track_range.detection.formats.tables.label_format import LabelFormat
from track_range.detection.formats.titles import TRUTH_NAMES, TRUTH_TITLES
from track_range.foundation.schemas.options import Options, option
from track_range.run.options.detection import (
    AnchorsField,
    DeviceField,
    LayoutField,
    LetterboxField,
    NamesField,
    NumberNamesField,
    ReidField,
    SizeField,
    ThreadsField,
    TrackerField,
    TrackerScoreField,
)


def truth_formats() -> dict[str, LabelFormat]:
    """The label formats of ground truth, by name."""
    return {name: form for name, form in LABEL_FORMATS.usable.items() if not form.is_of_run}


LabelFormatField = Annotated[
    str | None,
    option(
        "Format of the labels (default: KITTI for a video, COCO for a .json file, else YOLO).",
        flag="--format",
        choices=IMAGE_LABELS.keys,
    ),
]
LabelNamesField = Annotated[
    str | None,
    option(
        "Class names of the numbers in YOLO labels: a,b,c or a file with one name per line "
        "(default: classes.txt or data.yaml beside the labels, else the 8 road classes)."
    ),
]
ManifestField = Annotated[
    Path | None,
    option(
        "CSV with the columns file, split and labels_complete (8 flags), which selects images and "
        "the classes to evaluate in each image."
    ),
]
SplitField = Annotated[str, option("Split of the manifest to evaluate on.")]


class TrackSettings(Options):
    """Input, tracker and output folder of `track-range track`."""

    detections: Annotated[
        Path,
        option(
            "Detections in MOTChallenge's det.txt, rows frame,x1,y1,x2,y2,score, or another format "
            "of --detections: a file, a folder of files NAME.txt, or a folder of sequences "
            "NAME/det/det.txt.",
            metavar="DETECTIONS",
            is_argument=True,
        ),
    ]
    out: Annotated[
        Path, option("Folder of the results: mot/NAME.txt for each sequence.", metavar="DIR")
    ]
    images: Annotated[
        Path | None,
        option(
            "Images of the frames, for appearance and camera-motion compensation: a video, a "
            "folder of images, or a folder with a video or image folder for each sequence.",
            metavar="VIDEO|DIR",
        ),
    ] = None
    form: Annotated[
        Literal["mot", "kitti", "rrc"] | None,
        option(
            "Format of the detections; rrc is frame,x1,y1,x2,y2,score (default: detected from the "
            "file).",
            flag="--format",
        ),
    ] = None
    road_class: Annotated[
        str | None,
        option(
            "Road class of rows without a class (default: car or person if the folder name "
            "contains it, else person).",
            flag="--classes",
            metavar="CLASS",
        ),
    ] = None
    names: NumberNamesField = None
    fps: Annotated[
        float | None,
        option("Frame rate (default: from seqinfo.ini, else 10).", metavar="FPS", ge=0.01, le=1000),
    ] = None
    tracker: TrackerField = "road"
    reid: ReidField = None
    tracker_min_score: TrackerScoreField = None
    online: Annotated[
        bool,
        option(
            "Tracks as a live run reports them, without filled gaps and without boxes before the "
            "confirmation of a track."
        ),
    ] = False
    kitti: Annotated[
        bool, option("Additional output of the tracks in KITTI's format, kitti/NAME.txt.")
    ] = False


class TrackEvaluationSettings(Options):
    """Tracks and ground truth of `track-range evaluate tracks`."""

    truth: Annotated[
        Path,
        option(
            f"Ground truth: a file or folder of {TRUTH_TITLES}; or a folder of sequences NAME.txt or "
            "NAME/gt/gt.txt."
        ),
    ]
    results: Annotated[
        Path,
        option(
            "Tracks in one of these formats: a file, a folder of files NAME.txt, or the output "
            "folder of a run or of `track-range track`."
        ),
    ]
    truth_format: Annotated[
        str | None,
        option(
            f"Format of the ground truth: {TRUTH_NAMES} (default: detected from its content).",
            flag="--format",
            metavar="NAME",
            choices=truth_formats,
        ),
    ] = None
    road_class: Annotated[
        str | None,
        option(
            "Class to evaluate; for KITTI car, person or bicycle (default: KITTI car, MOTChallenge "
            "person, other formats the most frequent class).",
            flag="--class",
            metavar="NAME",
        ),
    ] = None
    seed: Annotated[
        int, option("Random seed of the 95 % intervals of several sequences.", ge=0)
    ] = 0
    compare: Annotated[
        Literal["motmetrics"] | None,
        option("Package that evaluates the same boxes for comparison; differences are explained."),
    ] = None


class DetectionEvaluationSettings(Options):
    """Detectors and labelled images of `track-range evaluate detections`."""

    models: Annotated[
        tuple[str, ...],
        option(
            "Detector to evaluate: an ONNX file, or a name from `track-range models list`; repeat "
            "the option to compare several.",
            flag="--model",
            metavar="FILE|NAME",
            is_repeated=True,
        ),
    ]
    images: Annotated[Path, option("Folder of images, or a video.", metavar="DIR|VIDEO")]
    labels: Annotated[
        Path,
        option(
            "Labels of the images: a folder, a COCO file, or a KITTI tracking file.",
            metavar="DIR|FILE",
        ),
    ]
    label_format: LabelFormatField = None
    label_names: LabelNamesField = None
    manifest: ManifestField = None
    split: SplitField = "val"
    classes: Annotated[
        tuple[str, ...], option("Road classes to evaluate (default: all).", metavar="A,B,...")
    ] = ()
    min_height: Annotated[
        float,
        option(
            "Minimum height of an object in pixels; smaller objects are ignored.",
            metavar="PX",
            ge=0.0,
        ),
    ] = 0.0
    min_score: Annotated[
        str | None,
        option(
            "Confidence threshold at which precision and recall are reported, also by class "
            "(default: 0.25).",
            metavar="S[,CLASS=S...]",
        ),
    ] = None
    by: Annotated[
        SizeMeasure,
        option(
            "Measure of the table by size of object: area of the box (COCO's small, medium and "
            "large: limits of 32^2 and 96^2 px) or its height (limits of 25, 50 and 100 px), both "
            "in pixels of the image."
        ),
    ] = "area"
    names: NamesField = None
    anchors: AnchorsField = None
    letterbox: LetterboxField = None
    layout: LayoutField = None
    size_px: SizeField = None
    threads: ThreadsField = 0
    device: DeviceField = "auto"

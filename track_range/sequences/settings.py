"""Options of tracking labelled sequences, and of evaluating tracks and detectors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

from track_range.foundation.options import Options, option
from track_range.run.detector_fields import (
    Device,
    anchors_option,
    device_option,
    letterbox_option,
    names_option,
    size_option,
    threads_option,
)

TruthFormat = Literal["mot", "kitti"]

LabelFormatField = Annotated[
    Literal["yolo", "kitti", "coco"] | None,
    option("Format of the labels (default: KITTI for a video, COCO for a .json file, else YOLO).", flag="--format"),
]
LabelNamesField = Annotated[
    str | None,
    option(
        "Class names of YOLO's numbers: a,b,c or a file (default: classes.txt or data.yaml beside the labels, else the "
        "8 road classes)."
    ),
]
ManifestField = Annotated[
    Path | None,
    option("CSV with columns file, split, labels_complete (8 flags): which images and classes count."),
]
SplitField = Annotated[str, option("Split of the manifest to use.")]


class TrackSettings(Options):
    """Which detections are tracked and how, and where the tracks go."""

    detections: Annotated[
        Path,
        option(
            "Detections: MOT det.txt, KITTI rows, or frame,x1,y1,x2,y2,score; a file, a folder of them (NAME.txt), or "
            "MOTChallenge's folders (NAME/det/det.txt).",
            metavar="DETECTIONS",
            is_argument=True,
        ),
    ]
    out: Annotated[Path, option("Folder of the results, mot/NAME.txt per sequence.", metavar="DIR")]
    images: Annotated[
        Path | None,
        option(
            "Images of the frames, for appearance and camera motion: a video, a folder of images, or a folder of "
            "either per sequence.",
            metavar="VIDEO|DIR",
        ),
    ] = None
    form: Annotated[
        Literal["mot", "kitti", "rrc"] | None,
        option(
            "Format of the detections; rrc: frame,x1,y1,x2,y2,score (default: detected from the file).",
            flag="--format",
        ),
    ] = None
    road_class: Annotated[
        str | None,
        option(
            "Class of rows that name none (default: car or person by the folder's name, else person).",
            flag="--classes",
            metavar="X",
        ),
    ] = None
    fps: Annotated[float | None, option("Frame rate (default: seqinfo.ini's, else 10).", ge=0.01, le=1000)] = None
    tracker: Annotated[
        str,
        option(
            "Tracker: deepsort compares appearance too, sort does not; or a tracker class of your own.",
            metavar="NAME|MODULE:CLASS",
        ),
    ] = "deepsort"
    reid: Annotated[
        Path | None, option("Re-identification network (ONNX) for appearance; needs --images.", metavar="FILE")
    ] = None
    online: Annotated[
        bool, option("Output of each frame as a live run reports it, without what later frames add (gaps, starts).")
    ] = False
    kitti: Annotated[bool, option("KITTI rows in addition: kitti/NAME.txt.")] = False


class TrackEvaluationSettings(Options):
    """Which tracks are measured against which ground truth."""

    truth: Annotated[Path, option("Ground truth: a file, or a folder of sequences (NAME.txt or NAME/gt).")]
    results: Annotated[
        Path, option("Tracks: MOT or KITTI rows, NAME.txt per sequence, or the output folder of `track`.")
    ]
    truth_format: Annotated[
        TruthFormat | None, option("Format of the truth (default: detected from its first line).", flag="--format")
    ] = None
    road_class: Annotated[
        str | None,
        option("Class to evaluate; KITTI: car (default), person or bicycle.", flag="--class", metavar="NAME"),
    ] = None
    compare: Annotated[
        Literal["motmetrics"] | None,
        option("Other package whose figures for the same boxes are shown too, with the reasons for differences."),
    ] = None


class DetectionEvaluationSettings(Options):
    """Which detectors are measured on which labelled images."""

    models: Annotated[
        tuple[str, ...],
        option("Detector; repeat the option for others.", flag="--model", metavar="FILE|NAME", is_repeated=True),
    ]
    images: Annotated[Path, option("Folder of images, or a video.")]
    labels: Annotated[Path, option("Labels of the images: a folder, or one COCO or KITTI tracking file.")]
    label_format: LabelFormatField = None
    label_names: LabelNamesField = None
    manifest: ManifestField = None
    split: SplitField = "val"
    classes: Annotated[tuple[str, ...], option("Road classes to measure (default: all).", metavar="A,B,...")] = ()
    min_height: Annotated[
        float, option("Minimum height in pixels; smaller objects are ignored.", metavar="PX", ge=0.0)
    ] = 0.0
    min_score: Annotated[
        str | None,
        option("Working confidence, for precision and recall (default: 0.25).", metavar="S[,CLASS=S...]"),
    ] = None
    names: Annotated[str | None, names_option()] = None
    anchors: Annotated[str | None, anchors_option()] = None
    letterbox: Annotated[str | None, letterbox_option()] = None
    size_px: Annotated[int | None, size_option()] = None
    threads: Annotated[int, threads_option()] = 0
    device: Annotated[Device, device_option()] = "auto"

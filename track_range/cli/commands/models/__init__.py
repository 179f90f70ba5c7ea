"""`track-range models`: list, download, inspect, import, quantize and calibrate detectors."""

from track_range.cli.shared.lazy import Lazy, lazy_app

app = lazy_app(
    {
        "list": Lazy(
            "track_range.cli.commands.models.files:list_app",
            "List the packaged, downloaded and downloadable detectors.",
            examples=("track-range models list",),
        ),
        "pull": Lazy(
            "track_range.cli.commands.models.files:pull_app",
            "Download a detector into the cache folder and verify its checksum.",
            "Detectors come from the releases of their projects.",
            ("track-range models pull yolov5n",),
        ),
        "info": Lazy(
            "track_range.cli.commands.models.info",
            "Show the layout, input format, classes and origin of a detector.",
            "Attributes that the file does not contain are shown with their assumed values.",
            ("track-range models info road", "track-range models info best.onnx"),
        ),
        "import": Lazy(
            "track_range.cli.commands.models.files:import_app",
            "Convert a Darknet network (.cfg and .weights) to an ONNX file.",
            examples=(
                "track-range models import yolov4-tiny.cfg yolov4-tiny.weights \\\n"
                "      --names coco.names --out yolov4-tiny.onnx",
            ),
        ),
        "quantize": Lazy(
            "track_range.cli.commands.models.quantize",
            "Write INT8 and FP16 copies of a detector and compare them with the original.",
            "The comparison covers size, speed and accuracy, measured against labels if given, "
            "else against the boxes of the original.",
            ("track-range models quantize road --images images/ --out copies",),
        ),
        "calibrate-scores": Lazy(
            "track_range.cli.commands.models.calibrate_scores",
            "Write a copy of a detector whose scores are probabilities.",
            "A logistic function of the score is fitted to labelled images, by class.",
            (
                "track-range models calibrate-scores road.onnx --images val/ \\\n"
                "      --labels val-labels/ --out road-calibrated.onnx",
            ),
        ),
    }
)

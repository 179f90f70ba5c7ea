"""`track-range models`: what detector files hold, where they come from, and making them."""

from __future__ import annotations

from track_range.cli.lazy import Lazy, lazy_app

app = lazy_app(
    {
        "info": Lazy(
            "track_range.cli.models.info", "Show what a model file contains, what is assumed of it, and its classes."
        ),
        "list": Lazy("track_range.cli.models.files:list_app", "List detectors that can be downloaded or are here."),
        "pull": Lazy(
            "track_range.cli.models.files:pull_app",
            "Download a detector from its own project's release into the cache folder, and verify it.",
        ),
        "import": Lazy(
            "track_range.cli.models.files:import_app", "Convert a Darknet network (cfg and weights) to an ONNX file."
        ),
        "quantize": Lazy(
            "track_range.cli.models.quantize",
            "Write INT8 and FP16 copies of a detector, and compare size, speed and accuracy.",
        ),
    },
)

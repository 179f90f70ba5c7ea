"""`track-range models info`: layout, input format, classes and origin of a detector."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain
from typing import Annotated, Any

from rich import box
from rich.table import Table
from rich.text import Text

from track_range.cli.console import console
from track_range.cli.parameters import command
from track_range.detection.box_errors import UNKNOWN_DETECTOR
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.models.lookup import ModelLocation, find_model
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.options import Options, option
from track_range.run.options.detection import AnchorsField, LetterboxField, NamesField
from track_range.run.options.opened import DetectorOptions, open_detector

_ABOUT = ("data", "date", "epochs", "licence", "license")  # metadata on the origin of a model
_IDENTITY = {"mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0)}  # values without effect, not shown


class InfoOptions(Options):
    """Options of `track-range models info`."""

    model: Annotated[
        str, option("ONNX file, or a name from `track-range models list`.", metavar="FILE|NAME", is_argument=True)
    ]
    names: NamesField = None
    anchors: AnchorsField = None
    letterbox: LetterboxField = None


def _info(options: InfoOptions) -> None:
    detector = DetectorOptions.of(options)
    model = find_model(options.model)
    is_local = model.origin != "catalogue" or model.entry is None
    table = Table(box=box.SIMPLE_HEAD, show_header=False, padding=(0, 1), title=options.model, title_justify="left")
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_column(style="dim", overflow="fold")
    for row in chain(_rows(open_detector(model.path, detector)) if is_local else (), _entry_rows(model)):
        table.add_row(*(Text(text) for text in row))
    console.print(table)


def _entry_rows(model: ModelLocation) -> Iterator[tuple[str, str, str]]:
    """Rows (property, value, source) from the catalogue."""
    entry = model.entry
    if entry is None:
        return
    if model.origin == "catalogue":
        yield "state", "not downloaded", f"download with `track-range models pull {entry.name}`"
        yield "family", entry.family, "from the catalogue"
        yield "input", entry.input, ""
    yield "licence", f"{entry.licence.name}: {entry.licence.meaning}", ""
    yield "from", f"{entry.project}, release {entry.release}", ""
    for file in entry.files:
        yield "file", file.url, file.checksum


def _rows(detector: YoloDetector) -> Iterator[tuple[str, str, str]]:
    session, model = detector.session, detector.model
    family = model.attributes["family"]
    yield "family", model.family, family.source
    yield "outputs", model.layout, ""
    shape = ", ".join("any" if side is None else str(side) for side in session.input_shape)
    is_variable = None in session.input_shape[2:]
    source = "variable size: set by --size and the aspect ratio of the video" if is_variable else ""
    yield "input", f"[{shape}] {session.input_dtype.__name__}", source
    if is_variable:
        if detector.area is None:
            yield "size", str(detector.size.value), detector.size.source
        else:
            yield "area", f"{detector.area.value:.0f} pixels", detector.area.source
    for key in ("letterbox", "colours", "divisor", "mean", "std", "anchors", "scale_x_y", "scores"):
        if key in model.attributes and model.attributes[key].value != _IDENTITY.get(key):
            yield key, _text(model.attributes[key].value), model.attributes[key].source
    errors = ", ".join(
        f"{name} {100 * e.log_height:+.1f} ± {100 * e.log_height_sigma:.1f}"
        for name, e in (detector.box_errors or UNKNOWN_DETECTOR).items()
    )
    yield "errors of box heights %", errors, model.attributes["box_errors"].source
    yield f"{len(model.names)} classes", ", ".join(model.names), model.attributes["names"].source
    yield "road classes", ", ".join(ROAD_CLASSES[i] for i in detector.known_class_id), ""
    missing = [name for i, name in enumerate(ROAD_CLASSES) if i not in detector.known_class_id]
    if missing:
        yield "classes not covered", ", ".join(missing), ""
    for key in _ABOUT:
        if key in session.metadata:
            yield key, session.metadata[key], "from the model's metadata"
    yield "runs on", session.device, ""
    yield "file", f"{session.path.stat().st_size / 1e6:.1f} MB", ""
    yield "sha256", session.sha256(), ""


def _text(value: Any) -> str:
    """Text of the value of an attribute; anchors in the format of `--anchors`."""
    if not isinstance(value, tuple):
        return f"{value:g}" if isinstance(value, float) else str(value)
    if isinstance(value[0], tuple):
        return " / ".join(" ".join(f"{w:g},{h:g}" for w, h in head) for head in value)
    return ", ".join(f"{number:g}" for number in value)


app = command(InfoOptions, _info)

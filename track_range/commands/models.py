"""`track-range models info`: what a model file holds, what is taken for granted, and what it would be used for."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from rich import box
from rich.console import Console
from rich.table import Table
from rich.text import Text

from detection.classes import ROAD_CLASSES
from detection.yolo import YoloDetector
from track_range.commands.ready_model import ready_model
from track_range.detector_options import DetectorOptions, open_detector


def tell_model(word: str, options: DetectorOptions, console: Console) -> None:
    """Load the model, run it once, and print what it is.

    Raises:
        ModelError: it cannot be used as a detector.
        DownloadError: it is one of the catalogue's, and cannot be fetched.
    """
    path = ready_model(word, console)
    detector = open_detector(path, options)
    table = Table(box=box.SIMPLE_HEAD, show_header=False, padding=(0, 1), title=str(path), title_justify="left")
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_column(style="dim", overflow="fold")
    for row in _rows(detector):
        table.add_row(*(Text(text) for text in row))
    console.print(table)


def _rows(detector: YoloDetector) -> Iterator[tuple[str, str, str]]:
    """What, value, who says so."""
    session, model = detector.session, detector.model
    family = model.facts["family"]
    yield "family", model.family, family.source
    yield "outputs", model.layout, ""
    shape = ", ".join("any" if side is None else str(side) for side in session.input_shape)
    yield "input", f"[{shape}] {session.input_dtype.__name__}", _rectangular(detector)
    for key in ("letterbox", "colours", "divisor", "anchors", "scale_x_y"):
        if key in model.facts:
            yield key, _text(model.facts[key].value), model.facts[key].source
    yield f"{len(model.names)} classes", ", ".join(model.names), model.facts["names"].source
    yield "road classes", ", ".join(ROAD_CLASSES[i] for i in detector.known_class_id), ""
    missing = [name for i, name in enumerate(ROAD_CLASSES) if i not in detector.known_class_id]
    if missing:
        yield "it cannot see", ", ".join(missing), ""
    yield "runs on", session.device, ""
    yield "file", f"{session.path.stat().st_size / 1e6:.1f} MB", ""
    yield "sha256", session.sha256(), ""


def _rectangular(detector: YoloDetector) -> str:
    if None in detector.session.input_shape[2:]:
        return "open: as large as each video needs at --size"
    return ""


def _text(value: Any) -> str:
    """A fact's value; anchors as `--anchors` takes them."""
    if not isinstance(value, tuple):
        return f"{value:g}" if isinstance(value, float) else str(value)
    if isinstance(value[0], tuple):
        return " / ".join(" ".join(f"{w:g},{h:g}" for w, h in head) for head in value)
    return ", ".join(f"{each:g}" for each in value)

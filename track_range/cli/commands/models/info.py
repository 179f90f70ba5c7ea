"""`track-range models info`: layout, input format, classes and origin of a detector."""

from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import cv2
from rich import box
from rich.table import Table
from rich.text import Text

from track_range.cli.shared.console import console
from track_range.cli.shared.parameters import command
from track_range.detection.box_errors import UNKNOWN_DETECTOR
from track_range.detection.catalogue.lookup import ModelLocation, find_model
from track_range.detection.classes import ROAD_CLASSES, class_counts
from track_range.detection.yolo.detector import YoloDetector
from track_range.detection.yolo.first_images import N_IMAGES
from track_range.detection.yolo.metadata import FROM_METADATA
from track_range.foundation.errors import ConfigError
from track_range.foundation.files.atomic_files import describe, write_bytes
from track_range.foundation.files.images import read_image
from track_range.foundation.schemas.options import Options, option
from track_range.pipeline.colours import track_colour
from track_range.run.options.detection import AnchorsField, LayoutField, LetterboxField, NamesField
from track_range.run.options.opened import DetectorOptions, open_detector
from track_range.views.overlay.annotator import draw_box

_ABOUT = ("data", "date", "epochs", "licence", "license")  # metadata on the origin of a model
_IDENTITY = {"mean": (0.0, 0.0, 0.0), "std": (1.0, 1.0, 1.0)}  # values without effect, not shown


class InfoOptions(Options):
    """Options of `track-range models info`."""

    model: Annotated[
        str,
        option(
            "ONNX file, or a name from `track-range models list`.",
            metavar="FILE|NAME",
            is_argument=True,
        ),
    ]
    names: NamesField = None
    anchors: AnchorsField = None
    letterbox: LetterboxField = None
    layout: LayoutField = None
    image: Annotated[
        Path | None,
        option(
            "Image on which the layout is checked; its boxes are drawn into --out.", metavar="FILE"
        ),
    ] = None
    out: Annotated[
        Path | None,
        option(
            "Picture of the boxes, PNG (default: IMAGE-boxes.png in the current folder).",
            metavar="FILE",
        ),
    ] = None


def _info(options: InfoOptions) -> None:
    detector = DetectorOptions(
        names=options.names,
        anchors=options.anchors,
        letterbox=options.letterbox,
        layout=options.layout,
    )
    model = find_model(options.model)
    is_local = model.origin != "catalogue" or model.entry is None
    table = Table(
        box=box.SIMPLE_HEAD,
        show_header=False,
        padding=(0, 1),
        title=options.model,
        title_justify="left",
    )
    table.add_column(style="bold", no_wrap=True)
    table.add_column(overflow="fold")
    table.add_column(style="dim", overflow="fold")
    rows: list[tuple[str, str, str]] = []
    if is_local:
        network = open_detector(model.path, detector)
        rows = [*_rows_on_image(network, options.image, options.out), *detector_rows(network)]
    for row in chain(rows, _entry_rows(model)):
        table.add_row(*(Text(text) for text in row))
    console.print(table)


def _rows_on_image(
    detector: YoloDetector, path: Path | None, out: Path | None
) -> list[tuple[str, str, str]]:
    """Rows on the boxes in an image, which are drawn into `out`; ConfigError if a file cannot be
    read or written.
    """
    if path is None:
        return []
    image = read_image(path, ConfigError)
    for _ in range(N_IMAGES):  # as on the first images of a video
        boxes = detector.detect(image)
    for i, xyxy_px in enumerate(boxes.xyxy_px):
        colour = track_colour(int(boxes.class_id[i]))
        draw_box(image, xyxy_px, bgr=colour, line_px=2, dashed=False)
        text = f"{ROAD_CLASSES[boxes.class_id[i]]} {boxes.score[i]:.2f}"
        place = (int(xyxy_px[0]) + 2, max(int(xyxy_px[1]) - 4, 10))
        cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, 0.45, colour, 1, cv2.LINE_AA)
    picture = out or Path(f"{path.stem}-boxes.png")
    if picture.suffix.lower() != ".png":
        raise ConfigError(f"{picture}: expected a PNG file for --out.")
    try:
        write_bytes(picture, cv2.imencode(".png", image)[1].tobytes())
    except OSError as error:
        raise ConfigError(f"{picture}: cannot be written ({describe(error)}).") from error
    return [("boxes", f"{class_counts(boxes.class_id)}, drawn into {picture}", f"in {path.name}")]


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


def detector_rows(detector: YoloDetector) -> Iterator[tuple[str, str, str]]:
    """Rows (property, value, source) of a detector."""
    session, model = detector.session, detector.model
    yield from _layout_rows(detector)
    yield from _input_rows(detector)
    for key in ("letterbox", "colours", "divisor", "mean", "std", "anchors", "scale_x_y", "scores"):
        if key in model.attributes and model.attributes[key].value != _IDENTITY.get(key):
            yield key, _text(model.attributes[key].value), model.attributes[key].source
    errors = ", ".join(
        f"{name} {100 * e.log_height:+.1f} ± {100 * e.log_height_sigma:.1f}"
        for name, e in (detector.box_errors or UNKNOWN_DETECTOR).items()
    )
    yield "errors of box heights %", errors, model.attributes["box_errors"].source
    yield from _class_rows(detector)
    for key in _ABOUT:
        if key in session.metadata:
            yield key, session.metadata[key], FROM_METADATA
    yield "runs on", session.device, ""
    yield "file", f"{session.path.stat().st_size / 1e6:.1f} MB", ""
    yield "sha256", session.sha256(), ""


def _layout_rows(detector: YoloDetector) -> Iterator[tuple[str, str, str]]:
    model = detector.model
    family = model.attributes["family"]
    yield "family", model.family, family.source
    yield "layout", f"{model.name}: {model.layout}", detector.why
    others = [reading.name for reading in detector.readings if reading.name != model.name]
    if others:
        advice = "--layout selects one; --image shows its boxes"
        yield "other layouts of these shapes", ", ".join(others), advice
    if model.note:
        yield "ignored", model.note, ""


def _input_rows(detector: YoloDetector) -> Iterator[tuple[str, str, str]]:
    session = detector.session
    shape = ", ".join("any" if side is None else str(side) for side in session.input_shape)
    is_variable = None in session.input_shape[2:]
    source = "variable size: set by --size and the aspect ratio of the video" if is_variable else ""
    yield "input", f"[{shape}] {session.input_dtype.__name__}", source
    if is_variable and detector.area is None:
        yield "size", str(detector.size.value), detector.size.source
    elif is_variable and detector.area is not None:
        yield "area", f"{detector.area.value:.0f} pixels", detector.area.source


def _class_rows(detector: YoloDetector) -> Iterator[tuple[str, str, str]]:
    model = detector.model
    yield f"{len(model.names)} classes", ", ".join(model.names), model.attributes["names"].source
    yield "road classes", ", ".join(ROAD_CLASSES[i] for i in detector.known_class_id), ""
    missing = [name for i, name in enumerate(ROAD_CLASSES) if i not in detector.known_class_id]
    if missing:
        yield "classes not covered", ", ".join(missing), ""


def _text(value: Any) -> str:
    """Text of the value of an attribute; anchors in the format of `--anchors`."""
    if not isinstance(value, tuple):
        return f"{value:g}" if isinstance(value, float) else str(value)
    if isinstance(value[0], tuple):
        return " / ".join(" ".join(f"{w:g},{h:g}" for w, h in head) for head in value)
    return ", ".join(f"{number:g}" for number in value)


app = command(InfoOptions, _info)

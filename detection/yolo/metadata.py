"""Metadata of a model: class names, anchors, letterbox and other attributes, each with its source.

Many ONNX files contain no metadata. Each attribute is read from the first source that has it: the
user's options, the file's metadata (written by Ultralytics' exporter and `track-range models
import`), `MODEL.yaml` next to the file; otherwise the family's default is used. All sources use the
same keys:

    family     name of the family, for display           names      class names, in the network's order
    anchors    per output head, [width, height] pixels   scale_x_y  per output head, Darknet's scale of the centres
    letterbox  such as centred-114                       colours    rgb or bgr          divisor  255 or 1
    mean, std  per channel, of pixel / divisor           scores     sigmoid or softmax, of outputs that are logits
    size       longer side in pixels of an input of variable size
    area       number of pixels of an input of variable size, instead of `size`
    end2end    whether Ultralytics' exporter included the suppression
    layout     name of the layout of the outputs (docs/how-to/detectors.md)
    kpt_shape  keypoints of a box in a pose network: their number, and values of each
    head       class of the head in Ultralytics' metadata, such as RTDETRDecoder
    box_errors systematic errors of the box sizes, by class (`detection.box_errors`)

RF-DETR's exporter writes one JSON document, `rfdetr_inference`, whose class names, mean and std are
used.
"""

import ast
import sys
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from track_range.detection.box_errors import box_errors_of
from track_range.detection.classes import names_of
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.input_format import placement_and_grey
from track_range.foundation.files.input_files import MAX_TEXT_BYTES, quoted, shortened
from track_range.foundation.files.structured_text import parse_json, read_yaml

FROM_METADATA = "from the model's metadata"  # source of an attribute
_MAX_REASON = 160  # characters of the description of an invalid value
Anchors = tuple[tuple[tuple[float, float], ...], ...]  # (width, height) in input px, by head


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelOptions:
    """Attributes of a model that the user specifies; None = not specified."""

    names: tuple[str, ...] | None = None  # class names in the network's order
    # pairs in input px by head, such as `81,82 135,169 344,319 / 23,27 37,58 81,82`
    anchors: str | None = None
    letterbox: str | None = None  # placement and grey level of the padding, such as `top-left-114`
    layout: str | None = None  # name of the layout of the outputs, such as `yolov8`


@dataclass(frozen=True, slots=True)
class Attribute:
    """One attribute of a model: its value, and a description of its source for display."""

    value: Any
    source: str


class ModelMetadata:
    """The explicit attributes of one model, by key."""

    def __init__(self, attributes: Mapping[str, Attribute]) -> None:
        self._attributes = attributes

    def get(self, key: str, default: Any, source: str) -> Attribute:
        """The attribute `key`; if it is missing, `default` with its `source`."""
        return self._attributes.get(key) or Attribute(default, source)


def read_metadata(path: Path, metadata: Mapping[str, str], options: ModelOptions) -> ModelMetadata:
    """Attributes of the model at `path`, from options, metadata or `MODEL.yaml`; ModelError for an
    invalid value.
    """
    option_values = {key: getattr(options, key) for key in ModelOptions.__dataclass_fields__}
    # as "Ultralytics rtdetr-l model"
    is_rt_detr = "rtdetr" in metadata.get("description", "").lower().replace("-", "")
    head = {"head": RT_DETR_DESCRIPTION} if is_rt_detr else {}
    metadata = {**_rfdetr_metadata(metadata), **head, **metadata}
    sidecar = path.with_suffix(".yaml")
    sidecar_values: Any = (
        read_yaml(sidecar, ModelError, "the attributes of a model") if sidecar.is_file() else None
    )
    if sidecar.is_file() and not (
        isinstance(sidecar_values, dict) and sidecar_values.keys() & _PARSERS.keys()
    ):
        raise ModelError(
            f"{sidecar}: expected one of the keys {', '.join(_PARSERS)}; add one of them, or "
            "remove the file."
        )
    attributes: dict[str, Attribute] = {}
    for key, parse in _PARSERS.items():
        if option_values.get(key) is not None:
            attributes[key] = Attribute(
                _parsed(parse, option_values[key], f"--{key}"), "as specified"
            )
        elif key in metadata:
            place = f"{path}: metadata '{key}'"
            attributes[key] = Attribute(
                _parsed(parse, _literal(metadata[key]), place), FROM_METADATA
            )
        elif key in (sidecar_values or {}):
            source = f"from {sidecar.name}"
            attributes[key] = Attribute(
                _parsed(parse, sidecar_values[key], f"{sidecar}: '{key}'"), source
            )
    return ModelMetadata(attributes)


_RFDETR_KEY = "rfdetr_inference"  # of RF-DETR's JSON document in a model's metadata


def _rfdetr_metadata(metadata: Mapping[str, str]) -> dict[str, str]:
    document = _literal(metadata.get(_RFDETR_KEY, ""))
    if not isinstance(document, Mapping):
        return {}
    texts = {
        key: repr(document[source])
        for key, source in (("mean", "means"), ("std", "stds"))
        if source in document
    }
    by_id, n = document.get("class_id_to_name"), document.get("num_classes")
    if isinstance(by_id, Mapping) and isinstance(n, int) and 0 < n <= _MAX_CLASSES:
        texts["names"] = repr([str(by_id.get(str(i), "N/A")) for i in range(n)])
    return texts


# of older Ultralytics, whose metadata have no more
RT_DETR_DESCRIPTION = "RT-DETR, according to its description"


def _parsed(parse: Callable[[Any], Any], value: object, place: str) -> Any:
    try:
        return parse(value)
    except ValueError as error:
        raise ModelError(f"{place}: {shortened(str(error), _MAX_REASON)}.") from error
    except (TypeError, KeyError, OverflowError) as error:
        raise ModelError(f"{place}: unexpected value {quoted(value)}.") from error


def _literal(text: str) -> object:
    """The value of a metadata text: JSON, a Python literal (Ultralytics' format of names), else the
    text itself.
    """
    if len(text) > MAX_TEXT_BYTES:
        return text
    try:
        return parse_json(text, "", ValueError, "a value")
    except ValueError:
        pass
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # texts such as 'a\d' are valid, with a SyntaxWarning
            return ast.literal_eval(text)
    except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
        return text


_MAX_NAME = 100  # characters of the name of a family
_MAX_CLASSES = 10_000  # in RF-DETR's metadata

_MAX_HEADS, _MAX_ANCHORS = 16, 64  # of a network, and in a head; YOLO networks have 1 to 5 of each
_ANCHORS_EXPECTED = (
    "expected positive width,height pairs for every head, such as '81,82 135,169 / 23,27 37,58'"
)


def _anchors(value: Any) -> Anchors:
    """Anchors from nested lists, or from text such as `10,14 23,27 37,58 / 81,82 135,169
    344,319`.
    """
    if isinstance(value, str):
        value = [[pair.split(",") for pair in head.split()] for head in value.split("/")]
    try:
        anchors = tuple(tuple((float(w), float(h)) for w, h in head) for head in value)
    except (ValueError, TypeError, OverflowError) as error:
        raise ValueError(_ANCHORS_EXPECTED) from error
    if len(anchors) > _MAX_HEADS or any(len(head) > _MAX_ANCHORS for head in anchors):
        raise ValueError(f"expected at most {_MAX_HEADS} heads of {_MAX_ANCHORS} anchors")
    if not anchors or not all(
        head and all(0 < side < 1e5 for pair in head for side in pair) for head in anchors
    ):
        raise ValueError(_ANCHORS_EXPECTED)
    return anchors


def _number(value: Any) -> float:
    """A number from a number or text; NaN for other values."""
    try:
        return float("nan") if isinstance(value, bool) else float(value)
    except (ValueError, TypeError, OverflowError):
        return float("nan")


def _scales(value: Any) -> tuple[float, ...]:
    values: Sequence[Any] = (
        value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    )
    scales = tuple(_number(scale) for scale in values)
    if not all(1 <= scale <= 2 for scale in scales):
        raise ValueError(f"expected numbers from 1 to 2, got {quoted(list(scales))}")
    return scales


def _family(value: object) -> str:
    if not isinstance(value, str | int | float) or not 0 < len(str(value)) <= _MAX_NAME:
        raise ValueError(f"expected the name of a family or head of networks, got {quoted(value)}")
    return str(value)


def _letterbox(value: object) -> str:
    placement_and_grey(value)
    return str(value).strip().lower()


def _triple(value: Any, *, is_positive: bool = False) -> tuple[float, ...]:
    numbers = tuple(_number(item) for item in value) if isinstance(value, Sequence) else ()
    if len(numbers) != 3 or not all(abs(number) <= 65535 for number in numbers):
        raise ValueError(f"expected three numbers, one for each channel, got {quoted(value)}")
    if is_positive and not all(number > 0 for number in numbers):
        raise ValueError(
            f"expected three positive numbers, one for each channel, got {quoted(value)}"
        )
    return numbers


def _one_of(first: str, second: str) -> Callable[[object], str]:
    def parse(value: object) -> str:
        if str(value).lower() not in (first, second):
            raise ValueError(f"expected {first} or {second}, got {quoted(value)}")
        return str(value).lower()

    return parse


def _between(low: float, high: float, expected: str) -> Callable[[Any], float]:
    def parse(value: Any) -> float:
        if not low <= _number(value) <= high:
            raise ValueError(f"expected {expected}, got {quoted(value)}")
        return float(value)

    return parse


_size_px = _between(32, 4096, "32 to 4096 pixels")

_PARSERS: Mapping[str, Callable[[Any], Any]] = {
    "family": _family,
    "names": names_of,
    "anchors": _anchors,
    "scale_x_y": _scales,
    "letterbox": _letterbox,
    "colours": _one_of("rgb", "bgr"),
    "divisor": _between(sys.float_info.min, 65535, "a positive number such as 255"),
    "mean": _triple,
    "std": partial(_triple, is_positive=True),
    "scores": _one_of("sigmoid", "softmax"),
    "size": lambda value: int(_size_px(value)),
    "area": _between(32**2, 4096**2, f"{32**2} to {4096**2} pixels"),
    "end2end": lambda value: str(value).lower() == "true",
    "head": _family,
    "layout": lambda value: _family(value).lower(),
    "kpt_shape": lambda value: tuple(int(length) for length in value),
    "box_errors": box_errors_of,
}

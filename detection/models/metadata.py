"""What is known of a model besides its weights: class names, anchors, letterbox, and who says so.

Many ONNX files say nothing of themselves. What is wanted comes from the first of: the user's options, the file's own
metadata (Ultralytics' exports and `track-range models import` write it), `MODEL.yaml` beside the file, the family's
default. All use the same keys:

    family     the network's name, for people            names      class names, in the network's order
    anchors    per output head, [width, height] pixels   scale_x_y  per output head, Darknet's stretch of the centres
    letterbox  such as centred-114                       colours    rgb or bgr          divisor  255 or 1
    size       longer side of the input in pixels, where it is open
"""

from __future__ import annotations

import ast
import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.input_format import placement_and_grey

Anchors = tuple[tuple[tuple[float, float], ...], ...]
"""Per output head, coarsest grid first as a rule, (width, height) of each anchor in input pixels."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ModelOptions:
    """Attributes of a model that the user gives; None = not given.

    Attributes:
        names: class names in the network's order.
        anchors: `81,82 135,169 344,319 / 23,27 37,58 81,82`: width,height pairs, one group per head in output order.
        letterbox: such as `top-left-114`.
    """

    names: tuple[str, ...] | None = None
    anchors: str | None = None
    letterbox: str | None = None


@dataclass(frozen=True, slots=True)
class Attribute:
    """One thing known of a model, and in words who says so."""

    value: Any
    source: str


class ModelMetadata:
    """The attributes of one model, by key."""

    def __init__(self, attributes: Mapping[str, Attribute]) -> None:
        self._attributes = attributes

    def of(self, key: str, default: Any, source: str) -> Attribute:
        """The attribute `key`, else the default."""
        return self._attributes.get(key) or Attribute(default, source)


def read_metadata(path: Path, metadata: Mapping[str, str], options: ModelOptions) -> ModelMetadata:
    """The attributes of the model at `path`, from options, else from its metadata, else from `MODEL.yaml`.

    Raises:
        ModelError: a value cannot be used.
    """
    given = {key: getattr(options, key) for key in ModelOptions.__dataclass_fields__}
    sidecar = path.with_suffix(".yaml")
    beside = _read_yaml(sidecar) if sidecar.is_file() else {}
    attributes: dict[str, Attribute] = {}
    for key, parse in _PARSERS.items():
        if given.get(key) is not None:
            attributes[key] = Attribute(_parsed(parse, given[key], f"--{key}"), "as given")
        elif key in metadata:
            where = f"{path}: its metadata '{key}'"
            attributes[key] = Attribute(_parsed(parse, _literal(metadata[key]), where), "from the model's metadata")
        elif key in beside:
            source = f"from {sidecar.name} beside it"
            attributes[key] = Attribute(_parsed(parse, beside[key], f"{sidecar}: '{key}'"), source)
    return ModelMetadata(attributes)


def _parsed(parse: Callable[[Any], Any], value: object, where: str) -> Any:
    try:
        return parse(value)
    except (ValueError, TypeError, KeyError, OverflowError) as error:
        raise ModelError(f"{where} cannot be used: {error}.") from error


def _read_yaml(sidecar: Path) -> dict[str, Any]:
    try:
        document = yaml.safe_load(sidecar.read_text(encoding="utf-8-sig"))
    except (OSError, yaml.YAMLError, UnicodeDecodeError) as error:
        raise ModelError(f"{sidecar}: not readable as YAML ({type(error).__name__}).") from error
    if not isinstance(document, dict) or not document.keys() & _PARSERS.keys():
        raise ModelError(
            f"{sidecar}: none of the keys {', '.join(_PARSERS)}; write 'names: [a, b, ...]', or remove it."
        )
    return document


def _literal(text: str) -> object:
    """A metadata value: JSON, a Python literal (Ultralytics writes names so), else the text itself."""
    for read in (json.loads, ast.literal_eval):
        try:
            return read(text)
        except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            continue
    return text


def names_of(value: object) -> tuple[str, ...]:
    """Names from a list, or from a mapping number -> name, 0 and on, as YOLO's tools write it."""
    if isinstance(value, Mapping):
        numbers = {int(key): name for key, name in value.items()}
        if sorted(numbers) != list(range(len(numbers))):
            raise ValueError(
                f"names are numbered from 0 on without gaps, not {', '.join(map(str, sorted(numbers)))[:40]}"
            )
        value = [numbers[key] for key in sorted(numbers)]
    if isinstance(value, Sequence) and not isinstance(value, str) and value:
        return tuple(str(name) for name in value)
    raise ValueError(f"a list of names wanted, not {str(value)[:40]!r}; give them with --names")


_ANCHORS_WANTED = "positive width,height pairs wanted for every head, such as '81,82 135,169 / 23,27 37,58'"


def _anchors(value: Any) -> Anchors:
    """Anchors from nested lists, or from text such as `10,14 23,27 37,58 / 81,82 135,169 344,319`."""
    if isinstance(value, str):
        value = [[pair.split(",") for pair in head.split()] for head in value.split("/")]
    try:
        anchors = tuple(tuple((float(w), float(h)) for w, h in head) for head in value)
    except (ValueError, TypeError) as error:
        raise ValueError(_ANCHORS_WANTED) from error
    if not anchors or not all(head and all(0 < side < 1e5 for pair in head for side in pair) for head in anchors):
        raise ValueError(_ANCHORS_WANTED)
    return anchors


def _scales(value: Any) -> tuple[float, ...]:
    values: Sequence[Any] = value if isinstance(value, Sequence) and not isinstance(value, str) else [value]
    scales = tuple(float(scale) for scale in values)
    if not all(1 <= scale <= 2 for scale in scales):
        raise ValueError(f"numbers from 1 to 2 wanted, not {list(scales)}")
    return scales


def _letterbox(value: object) -> str:
    placement_and_grey(value)
    return str(value).strip().lower()


def _colours(value: object) -> str:
    if str(value).lower() not in ("rgb", "bgr"):
        raise ValueError(f"rgb or bgr wanted, not {value!r}")
    return str(value).lower()


def _divisor(value: Any) -> float:
    if not 0 < float(value) <= 65535:
        raise ValueError(f"a positive number wanted, such as 255, not {value!r}")
    return float(value)


def _size(value: Any) -> int:
    if not 32 <= int(value) <= 4096:
        raise ValueError(f"pixels from 32 to 4096 wanted, not {value!r}")
    return int(value)


_PARSERS: Mapping[str, Callable[[Any], Any]] = {
    "family": str,
    "names": names_of,
    "anchors": _anchors,
    "scale_x_y": _scales,
    "letterbox": _letterbox,
    "colours": _colours,
    "divisor": _divisor,
    "size": _size,
}

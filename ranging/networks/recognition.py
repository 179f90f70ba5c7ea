"""The format of a network's file: its `MODEL.yaml`, else its names where only one format has
them.
"""

import difflib
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from track_range.foundation.files.input_files import quoted, shortened
from track_range.foundation.files.structured_text import read_yaml
from track_range.foundation.schemas.validation import validated
from track_range.ranging.networks.formats import FORMATS
from track_range.ranging.networks.network_format import NetworkError, NetworkFormat

_FORMAT = "format"  # key of MODEL.yaml that names the row it starts from
_SEEN = 100  # characters of inputs and outputs in a message
_INPUT = "colours: rgb, divisor: 255, mean: [0.485, 0.456, 0.406], std: [0.229, 0.224, 0.225]"
# a filled-in MODEL.yaml in one line, for one image and for a pair
_DEPTH = f"`{{task: depth, gives: depth, metric: true, {_INPUT}, multiple: 14, area: 268324}}`"
_STEREO = f"`{{task: stereo, gives: disparity, scale: 1, {_INPUT}, multiple: 32, fit: pad}}`"


def settings_file(path: Path) -> Path:
    """`MODEL.yaml` beside `MODEL.onnx`."""
    return path.with_suffix(".yaml")


def has_network_settings(path: Path) -> bool:
    """Whether `MODEL.yaml` is that of a depth or stereo network, and not that of a detector."""
    sidecar = settings_file(path)
    if not sidecar.is_file():
        return False
    lines = sidecar.read_text(encoding="utf-8", errors="replace").splitlines()
    return any(line.startswith(("format:", "task:", "gives:")) for line in lines)


def format_of(
    path: Path, inputs: Sequence[Any], outputs: Sequence[Any]
) -> tuple[str, NetworkFormat]:
    """Where the format is from, for display, and the format of the network in a file.

    Raises NetworkError if `MODEL.yaml` has a wrong key or value, or there is none and the names of
    inputs and outputs do not tell; the message has an example.
    """
    sidecar = settings_file(path)
    if sidecar.is_file():
        return _of_settings(sidecar, path)
    fitting = fitting_formats(inputs, outputs)
    if len(fitting) == 1 and (network := _usable(path, fitting[0])):
        return f"format {fitting[0]}, by the names of inputs and outputs", network
    seen = shortened(", ".join(f"{one.name} {one.shape}" for one in (*inputs, *outputs)), _SEEN)
    if fitting:
        lines = " or ".join(f"`format: {name}`" for name in fitting)
        problem = f"{seen}, as in {len(fitting)} formats; write {sidecar.name} with {lines}"
    else:
        n_images = sum(len(one.shape) >= 4 for one in inputs)
        example = _STEREO if n_images > 1 else _DEPTH
        problem = f"{seen}; write {sidecar.name}, such as {example}"
    raise NetworkError(
        f"{path}: expected names of inputs and outputs that tell what the network gives, found "
        f"{problem} (docs/how-to/networks.md)."
    )


def fitting_formats(inputs: Sequence[Any], outputs: Sequence[Any]) -> list[str]:
    """Names of the formats whose exports have inputs and outputs of these names."""
    sides_of = {one.name: "x".join(map(str, one.shape[-2:])) for one in inputs}
    given = {one.name for one in outputs}

    def fits(names: str) -> bool:
        wanted, _, results = names.partition(" -> ")
        texts = [f"{name}[{sides}]" if "[" in names else name for name, sides in sides_of.items()]
        return wanted.split() == texts and set(results.split()) == given

    return [name for name, row in FORMATS.items() if any(map(fits, row.names))]


def _usable(path: Path, name: str) -> NetworkFormat:
    row = FORMATS[name]
    if row.format is None:
        raise NetworkError(f"{path}: expected a whole network, found {row.refusal}.")
    return row.format


def _of_settings(sidecar: Path, path: Path) -> tuple[str, NetworkFormat]:
    values = read_yaml(sidecar, NetworkError, f"the format of {path.name}")
    if not isinstance(values, dict):
        raise NetworkError(f"{sidecar}: expected keys with values, found {quoted(values)}.")
    name = values.pop(_FORMAT, None)
    if name is None and not {"task", "gives"} <= values.keys():
        raise NetworkError(
            f"{sidecar}: expected `format: NAME`, or at least `task` and `gives`, such "
            f"as {_DEPTH}, "
            f"found {shortened(', '.join(map(str, values)), _SEEN) or 'no key'}."
        )
    start: dict[str, Any] = {}
    if name is not None:
        if not isinstance(name, str) or name not in FORMATS:
            names = [key for key, row in FORMATS.items() if row.format]
            near = difflib.get_close_matches(str(name), names, n=1)
            known = f"; did you mean {near[0]}?" if near else f"; known are {', '.join(names)}."
            raise NetworkError(
                f"{sidecar}: 'format': expected the name of a format, found {quoted(name)}{known}"
            )
        start = _usable(path, name).model_dump()
    network = validated(NetworkFormat, {**start, **values}, sidecar, NetworkError)
    given = f"format {name}, from {sidecar.name}" if name else f"from {sidecar.name}"
    return given, network

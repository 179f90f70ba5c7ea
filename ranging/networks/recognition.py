"""The format of a network's file: its `MODEL.yaml`, else its names where only one format has them."""

from pathlib import Path
from typing import Any

from track_range.foundation.files.input_files import quoted, shortened
from track_range.foundation.files.structured_text import read_yaml
from track_range.foundation.schemas.validation import validated
from track_range.ranging.networks.formats import FORMATS
from track_range.ranging.networks.network_format import NetworkError, NetworkFormat, Task

_FORMAT = "format"  # key of MODEL.yaml that names the row it starts from
_SEEN = 100  # characters of inputs and outputs in a message


def settings_file(path: Path) -> Path:
    """`MODEL.yaml` beside `MODEL.onnx`."""
    return path.with_suffix(".yaml")


def format_of(path: Path, inputs: list[Any], outputs: list[Any]) -> tuple[str, NetworkFormat]:
    """Where the format is from, for display, and the format of the network in a file.

    Raises NetworkError if `MODEL.yaml` has a wrong key or value, or there is none and the names of
    inputs and outputs do not tell; the message has an example.
    """
    sidecar = settings_file(path)
    if sidecar.is_file():
        return _of_settings(sidecar, path)
    names = frozenset(one.name for one in inputs), frozenset(one.name for one in outputs)
    fitting = [name for name, row in FORMATS.items() if row.names == names]
    if len(fitting) == 1:
        return f"format {fitting[0]}, by its names", FORMATS[fitting[0]].format
    seen = shortened(", ".join(f"{one.name} {one.shape}" for one in (*inputs, *outputs)), _SEEN)
    known = f"; its names are those of {' and '.join(fitting)}" if fitting else ""
    raise NetworkError(
        f"{path}: expected a network whose names tell what it gives, found {seen}{known}; write "
        f"{sidecar.name} beside it, such as {example(fitting)}; see "
        "docs/how-to/networks.md."
    )


def example(fitting: list[str]) -> str:
    """A filled-in `MODEL.yaml` in one line."""
    if fitting:
        return f"`format: {fitting[0]}`"
    return (
        "`{task: depth, gives: depth, metric: true, colours: rgb, divisor: 255, "
        "mean: [0.485, 0.456, 0.406], std: [0.229, 0.224, 0.225], multiple: 14, area: 268324}`"
    )


def _of_settings(sidecar: Path, path: Path) -> tuple[str, NetworkFormat]:
    values = read_yaml(sidecar, NetworkError, f"the format of {path.name}")
    if not isinstance(values, dict):
        raise NetworkError(f"{sidecar}: expected keys with values, found {quoted(values)}.")
    name = values.pop(_FORMAT, None)
    start: dict[str, Any] = {}
    if name is not None:
        if not isinstance(name, str) or name not in FORMATS:
            known = ", ".join(FORMATS)
            raise NetworkError(f"{sidecar}: 'format': expected {known}, found {quoted(name)}.")
        start = FORMATS[name].format.model_dump()
    network = validated(NetworkFormat, {**start, **values}, sidecar, NetworkError)
    given = f"format {name}, from {sidecar.name}" if name else f"from {sidecar.name}"
    return given, network


def check_task(path: Path, network: NetworkFormat, task: Task) -> None:
    """NetworkError unless a network is for the task."""
    if network.task == task:
        return
    options = {"depth": "--depth-model", "stereo": "--stereo-model"}
    raise NetworkError(
        f"{path}: expected a {task} network for {options[task]}, found a {network.task} network; "
        f"give it as {options[network.task]}."
    )

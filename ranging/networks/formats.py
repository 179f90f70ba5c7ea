"""The formats of networks that are known by name: one row for each, and `MODEL.yaml` names one."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from track_range.detection.yolo.input_format import IMAGENET_MEAN, IMAGENET_STD
from track_range.ranging.networks.network_format import NetworkFormat


@dataclass(frozen=True, slots=True)
class KnownFormat:
    """A format by name, and the files that have it.

    Attributes:
        title: the project, for display and documentation.
        format: what it takes and gives.
        names: names of inputs and outputs in the project's export, which also other formats may
            have; empty = exports have names of their own.
    """

    title: str
    format: NetworkFormat
    names: tuple[frozenset[str], frozenset[str]] = (frozenset(), frozenset())


def _row(title: str, inputs: str = "", outputs: str = "", **values: Any) -> KnownFormat:
    names = frozenset(inputs.split()), frozenset(outputs.split())
    return KnownFormat(title, NetworkFormat(**values), names)


_IMAGENET: Mapping[str, Any] = {"mean": IMAGENET_MEAN, "std": IMAGENET_STD}

FORMATS: Mapping[str, KnownFormat] = {
    "depth": _row("any network: metres from an image / 255", task="depth", gives="depth"),
    "stereo": _row(
        "any network: disparity in pixels from two images / 255",
        task="stereo",
        gives="disparity",
        fit="pad",
        multiple=32,
    ),
    "psmnet": _row("PSMNet", task="stereo", gives="disparity", fit="pad", multiple=32, **_IMAGENET),
}

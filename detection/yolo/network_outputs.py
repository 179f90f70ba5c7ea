"""NetworkOutputs, from which a layout is identified, and MatchedLayout, the result."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from track_range.detection.models.metadata import Attribute, ModelMetadata
from track_range.detection.yolo.decoders import Decoder
from track_range.detection.yolo.input_format import InputFormat


@dataclass(frozen=True, slots=True, kw_only=True)
class MatchedLayout:
    """A known output layout and its defaults, matched to a network.

    Attributes:
        family: default family of networks with this layout.
        text: description of the outputs, for display.
        n_classes: number of classes; None = not determined by the outputs.
        input_format: default input format of the family.
        decoder: decoder of the outputs.
        attributes: attributes used by the decoder, by key, for `models info`.
        is_end_to_end: whether the network itself returns one box per object, without non-maximum suppression.
        is_square: whether an input of variable size has to be square, as it was in training.
    """

    family: str
    text: str
    n_classes: int | None
    input_format: InputFormat
    decoder: Decoder
    attributes: Mapping[str, Attribute] = field(default_factory=dict)
    is_end_to_end: bool = False
    is_square: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkOutputs:
    """A network's input size, outputs and metadata, from which its layout is identified.

    Attributes:
        path: the model's file, for messages.
        input_hw: (height, width) of the network's input in pixels.
        names: name of each output, in the network's order.
        shapes: shape of each output.
        is_integer: whether each output consists of integers.
        has_target_sizes: whether the network has the input `orig_target_sizes`.
        metadata: explicit attributes of the model, such as its anchors.
    """

    path: Path
    input_hw: tuple[int, int]
    names: tuple[str, ...]
    shapes: tuple[tuple[int, ...], ...]
    is_integer: tuple[bool, ...]
    has_target_sizes: bool
    metadata: ModelMetadata

    def n_cells(self, strides_px: Sequence[int]) -> int:
        """Total number of grid cells of the input at these strides."""
        return sum((self.input_hw[0] // stride) * (self.input_hw[1] // stride) for stride in strides_px)

    def matrices(self) -> Iterator[tuple[int, int, int]]:
        """Index, rows and columns of each output [1, rows, columns]; older YOLOv5 exports also have raw grids."""
        for i, shape in enumerate(self.shapes):
            if len(shape) == 3 and shape[0] == 1:
                yield i, shape[1], shape[2]

    @property
    def n_names(self) -> int | None:
        """Number of explicit class names; None without names."""
        names = self.metadata.get("names", None, "").value
        return None if names is None else len(names)


@dataclass(frozen=True, slots=True)
class DetectorLayout:
    """One known output layout of detectors.

    Attributes:
        name: description of the layout, for messages that list the known ones.
        match: function that returns the matched layout of a network's outputs, None if they have another layout.
    """

    name: str
    match: Callable[[NetworkOutputs], MatchedLayout | None]

"""NetworkOutputs, from which a layout is identified, and YoloModel, the result."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from track_range.detection.models.metadata import Attribute, ModelMetadata
from track_range.detection.yolo.decoders import Decoder
from track_range.detection.yolo.input_format import InputFormat


@dataclass(frozen=True, slots=True)
class YoloModel:
    """Everything needed to run a detection network on images and decode its outputs.

    The function of a layout returns the family's defaults; `identify_layout` adds the explicit attributes of the model.
    """

    family: str  # name of the family, for display
    layout: str  # description of the outputs, for display
    n_classes: int | None  # number of classes; None = not determined by the outputs
    input_format: InputFormat
    decoder: Decoder
    names: tuple[str, ...] = ()  # class names in the network's order
    attributes: Mapping[str, Attribute] = field(default_factory=dict)  # by key, with the defaults
    score_outputs: tuple[int, ...] = ()  # outputs that consist of class scores alone
    is_end_to_end: bool = False  # whether the network itself returns one box per object, without suppression
    is_square: bool = False  # whether an input of variable size has to be square, as it was in training


@dataclass(frozen=True, slots=True, kw_only=True)
class NetworkOutputs:
    """A network's input size, outputs and metadata, from which its layout is identified."""

    path: Path  # the model's file, for messages
    input_hw: tuple[int, int]  # (height, width) of the network's input in pixels
    names: tuple[str, ...]  # name of each output, in the network's order
    shapes: tuple[tuple[int, ...], ...]
    is_integer: tuple[bool, ...]  # whether each output consists of integers
    has_target_sizes: bool  # whether the network has the input `orig_target_sizes`
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

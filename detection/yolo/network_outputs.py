"""NetworkOutputs, from which a layout is identified, and YoloModel, the result."""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from track_range.detection.yolo.decoders import Decoder
from track_range.detection.yolo.input_format import InputFormat
from track_range.detection.yolo.metadata import Attribute, ModelMetadata
from track_range.foundation.arrays import FloatArray32

# of the grids of all families
STRIDES_PX = ((8, 16, 32), (8, 16, 32, 64), (4, 8, 16, 32), (16, 32))
N_MASKS = 32  # prototypes of segmentation networks, and coefficients of each box's mask
MASKS_NOTE = "Masks of the segmentation network are ignored."
KEYPOINTS_NOTE = "Keypoints of the pose network are ignored."


@dataclass(frozen=True, slots=True)
class YoloModel:
    """Everything needed to run a detection network on images and decode its outputs: one reading of
    the outputs.

    The function of a layout returns the family's defaults; `readings_of` adds the explicit
    attributes of the model.
    """

    family: str  # name of the family, for display
    layout: str  # description of the outputs, for display
    n_classes: int | None  # number of classes; None = not determined by the outputs
    input_format: InputFormat
    decoder: Decoder
    names: tuple[str, ...] = ()  # class names in the network's order
    attributes: Mapping[str, Attribute] = field(default_factory=dict)  # by key, with the defaults
    score_outputs: tuple[int, ...] = ()  # outputs that consist of class scores alone
    # whether the network itself returns one box per object, without suppression
    is_end_to_end: bool = False
    # whether an input of variable size has to be square, as it was in training
    is_square: bool = False
    name: str = ""  # of the reading, for `--layout`
    note: str = ""  # on what is ignored
    # whether the class numbers surely count from 0; EfficientDet's rows have COCO's ids
    is_numbering_known: bool = True
    # whether the outputs may have this meaning
    accepts: Callable[[Sequence[FloatArray32]], bool] | None = None


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
    has_integer_input: bool = False  # whether the network takes pixels 0..255 as uint8

    @property
    def input_wh(self) -> tuple[float, float]:
        """Width and height of the input, the unit of fractions."""
        return float(self.input_hw[1]), float(self.input_hw[0])

    def n_cells(self, strides_px: Sequence[int], *, is_rounded_up: bool = False) -> int:
        """Total number of grid cells of the input at these strides; if rounded up, the last cells
        may lie outside.
        """
        height, width = (-side if is_rounded_up else side for side in self.input_hw)
        return sum((height // stride) * (width // stride) for stride in strides_px)

    def grid_strides(
        self, n: int, per_cell: int = 1, *, is_rounded_up: bool = False
    ) -> tuple[int, ...] | None:
        """Strides of the grids that have `n` boxes in total, `per_cell` for each cell; None for any
        other `n`.
        """
        counts = {
            self.n_cells(strides, is_rounded_up=is_rounded_up): strides
            for strides in STRIDES_PX[::-1]
        }
        return counts.get(n // per_cell) if n % per_cell == 0 else None

    def is_grid(self, n_rows: int) -> bool:
        """Whether grids with one or three boxes for each cell have `n_rows` boxes."""
        return self.grid_strides(n_rows) is not None or self.grid_strides(n_rows, 3) is not None

    def matrices(self) -> Iterator[tuple[int, int, int]]:
        """Index, rows and columns of each output [1, rows, columns]; older YOLOv5 exports also have
        raw grids.
        """
        for i, shape in enumerate(self.shapes):
            if len(shape) == 3 and shape[0] == 1:
                yield i, shape[1], shape[2]

    @property
    def class_names(self) -> tuple[str, ...]:
        """The explicit class names; () without names."""
        names: tuple[str, ...] = self.metadata.get("names", (), "").value
        return names

    @property
    def n_names(self) -> int | None:
        """Number of explicit class names; None without names."""
        return len(self.class_names) or None

    @property
    def has_masks(self) -> bool:
        """Whether an output [1, 32, h, w] has the prototypes of masks."""
        return any(len(shape) == 4 and shape[:2] == (1, N_MASKS) for shape in self.shapes)

    @property
    def n_keypoints(self) -> int:
        """Number of values of a box's keypoints, from Ultralytics' metadata; 0 if there are
        none.
        """
        shape: tuple[int, ...] = self.metadata.get("kpt_shape", (0,), "").value
        return math.prod(shape)


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectorLayout:
    """A layout of network outputs."""

    title: str  # for messages
    # the possible meanings of outputs; none if their shapes do not fit
    readings: Callable[[NetworkOutputs], Iterator[YoloModel]]
    names: tuple[str, ...]  # of `YoloModel.name`, for `--layout`
    # 0 = the shapes fit no other layout, see `foundation.registry.Registry`
    priority: int = 0

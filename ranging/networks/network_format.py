"""NetworkFormat: what a depth or stereo network takes and gives, as its row or its MODEL.yaml
says.
"""

from typing import Annotated, Literal, Self, get_args

from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from track_range.detection.models.onnx_session import ModelError
from track_range.foundation.schemas.validation import Integer, Number, PositiveNumber
from track_range.ranging.size_models.network_scale import NetworkErrors

Task = Literal["depth", "stereo"]
Gives = Literal["depth", "inverse_depth", "points", "disparity"]
Fit = Literal["stretch", "letterbox", "pad"]
Content = Literal[
    "image", "left", "right", "pair", "left/2", "right/2", "intrinsics", "rays", "zeros"
]

MAX_SIDE_PX = 8192  # of an input
_Triple = tuple[Number, Number, Number]
_Positives = tuple[PositiveNumber, PositiveNumber, PositiveNumber]
_Side = Annotated[Integer, Field(ge=1, le=MAX_SIDE_PX)]


class NetworkError(ModelError):
    """A depth or stereo network that cannot be used, or whose output is none; the message gives the
    reason and what to do.
    """


def _known_content(value: object) -> object:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_number and value not in get_args(Content):
        expected = f"{', '.join(get_args(Content))} or a number"
        raise ValueError(f"expected {expected}, found {value!r}")
    return value


class NetworkFormat(BaseModel):
    """What a network takes and gives. The keys of `MODEL.yaml` are those of this class.

    Images become (pixel / divisor - mean) / std, by channel in the order of `colours`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, hide_input_in_errors=True)

    task: Task
    gives: Gives  # "points" = (3, h, w) or (h, w, 3) x, y, z, of which z is used
    # False = right up to a factor; inverse depths also up to an added constant
    metric: bool = True
    # the output times this factor is in m, 1/m or pixels of the input; -1 for negative disparities
    scale: Number = 1.0
    # depths of the output are those of a camera with this focal length in pixels of the input; None
    # = those of the image's own camera
    focal_px: PositiveNumber | None = None
    # z + a constant and metres times an output `factor`, which the known focal length determines
    affine_points: bool = False
    output: str | None = None  # name of the output; None = the only one
    confidence: str | None = None  # name of the output of a confidence 0..1
    factor: str | None = None  # name of an output of one value, by which the depth is multiplied
    mask: str | None = None  # name of an output that is below 0.5 where there is no depth
    # contents of the inputs in the file's order; None = "image"; "left" and "right" by their names;
    # or "pair" of six channels
    inputs: tuple[Annotated[Content | float, BeforeValidator(_known_content)], ...] | None = None
    colours: Literal["rgb", "bgr"] = "rgb"
    divisor: PositiveNumber = 255.0
    mean: _Triple = (0.0, 0.0, 0.0)
    std: _Positives = (1.0, 1.0, 1.0)
    # "stretch" to the input; "letterbox": scaled, with grey around it; "pad": own pixels, reduced
    # only where the input is smaller, and its border repeated
    fit: Fit = "stretch"
    multiple: _Side = 1  # of which sides of an input of variable size are multiples
    # number of pixels of an input of variable size; None = that of the image
    area: Annotated[Integer, Field(ge=32**2, le=MAX_SIDE_PX**2)] | None = None
    size: tuple[_Side, _Side] | None = None  # height, width of an input of variable size
    # of a depth network, as `track-range fit --depth-model` measured them; None = of any network
    errors: NetworkErrors | None = None

    @model_validator(mode="after")
    def _agrees(self) -> Self:
        if (self.gives == "disparity") != (self.task == "stereo"):
            raise ValueError(
                f"expected gives: disparity for task: stereo, and another for task: depth, found "
                f"task: {self.task} and gives: {self.gives}"
            )
        if self.scale == 0:
            raise ValueError("expected a scale other than 0, found 0")
        return self

"""Curve files: size models as JSON, with a version and the kind of model.

`cuboids` (packaged): priors over sizes, yaw and the ground plane (`cuboid_sizes`). `log-linear`: a
log-linear curve per class (`log_linear`). `table`: a plain curve per class, such as Zhang's
polynomial, made monotonic (`tables`).
"""

import json
from collections.abc import Callable, Mapping
from importlib import resources
from pathlib import Path
from typing import Any, Literal, cast

from pydantic import BaseModel

from track_range.foundation.errors import UserError
from track_range.foundation.files.atomic_files import writable, write_text
from track_range.foundation.files.structured_text import read_json
from track_range.foundation.schemas.validation import Integer, validated
from track_range.ranging.size_models import cuboid_sizes, log_linear, plain_curves
from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.region import Region
from track_range.ranging.size_models.regions import in_region
from track_range.ranging.size_models.size_model import StoredSizeModel

CURVE_VERSION = 2  # version of the file format that is written and read
# key of the version in a curve file, which also identifies the format
_VERSION_KEY = "track_range_size_curves"


class CurveError(UserError):
    """A curve file that cannot be used, or labels to which no curve can be fitted; the message
    gives the reason.
    """


# content, and size model from it
_MODELS: Mapping[str, tuple[type[BaseModel], Callable[[Any], StoredSizeModel]]] = {
    cuboid_sizes.KIND: (cuboid_sizes.CuboidFile, cuboid_sizes.cuboids_in),
    log_linear.KIND: (log_linear.LogLinearFile, log_linear.log_linear_in),
    plain_curves.KIND: (plain_curves.TableFile, plain_curves.tables_in),
}


class _CurveFile(BaseModel):
    track_range_size_curves: Integer
    kind: Literal["cuboids", "log-linear", "table"]


def load_curves(path: Path | None = None, region: Region = "unknown") -> StoredSizeModel:
    """The size model in a curve file, which has its own sizes; None = the packaged sizes of a
    region.

    Raises CurveError: no such file, another format or version, an unknown kind or class, or an
    invalid value.
    """
    if path is None:
        with resources.as_file(
            resources.files("track_range.ranging.size_models").joinpath("curves/cuboids.json")
        ) as packaged:
            return in_region(cast(CuboidSizes, load_curves(packaged)), region)
    document = read_json(path, CurveError, "a curve file written by `track-range fit`")
    head = validated(_CurveFile, document, path, CurveError)
    if head.track_range_size_curves != CURVE_VERSION:
        raise CurveError(
            f"{path}: expected curve file version {CURVE_VERSION}, got "
            f"{head.track_range_size_curves}; fit it again with `track-range fit`."
        )
    model, model_of = _MODELS[head.kind]
    content = validated(model, document, path, CurveError)
    try:
        return model_of(content)
    except ValueError as error:
        raise CurveError(f"{path}: {error}.") from error


def save_curves(model: StoredSizeModel, path: Path) -> None:
    """Write a size model as a curve file, atomically; CurveError if it cannot be written."""
    document = {_VERSION_KEY: CURVE_VERSION, **model.document()}
    with writable(path, CurveError):
        write_text(path, json.dumps(document, indent=2) + "\n")

"""Validation of structured files and options with pydantic: the first error as one sentence."""

import difflib
import sys
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import fields
from numbers import Real
from typing import Annotated, Any, Literal, TypeVar

from pydantic import BaseModel, BeforeValidator, Field, ValidationError

from track_range.foundation.files.input_files import quoted, shortened

_Model = TypeVar("_Model", bound=BaseModel)


def _not_boolean(value: object) -> object:
    if isinstance(value, bool):
        raise ValueError(f"expected a number, found {value}")
    return value


Number = Annotated[float, BeforeValidator(_not_boolean), Field(allow_inf_nan=False)]
PositiveNumber = Annotated[Number, Field(gt=0)]
Integer = Annotated[int, BeforeValidator(_not_boolean)]
Version1 = Annotated[Literal[1], BeforeValidator(_not_boolean)]  # version 1 of a file format
"""Finite numbers, integers and versions; true and false, which Python treats as 1 and 0, are
errors."""


def validated(model: type[_Model], content: Any, source: object, error: type[Exception]) -> _Model:
    """Plain values, usually of `read_yaml` or `read_json`, as a pydantic model; `source` is the
    file, for messages.

    Raises `error` if a key is missing, unknown, or has a wrong value; the message names file and
    key.
    """
    try:
        return model.model_validate(content)
    except ValidationError as reason:
        key, problem = first_problem(reason)
        if problem == _UNKNOWN and (
            near := difflib.get_close_matches(key, model.model_fields, n=1)
        ):
            problem += f"; did you mean {near[0]}?"
        place = f"'{key}': " if key else ""
        raise error(f"{source}: {place}{problem}{'' if problem.endswith('?') else '.'}") from reason


_Settings = TypeVar("_Settings")


def chosen_numbers(settings: type[_Settings], chosen: Mapping[str, Any]) -> _Settings:
    """Settings of a dataclass with `chosen` values by name, which it checks itself (`check_numbers`);
    raises ValueError for another name or value.
    """
    known = [field.name for field in fields(settings)]  # type: ignore[arg-type]  # every dataclass has fields
    for name in chosen:
        if name not in known:
            near = difflib.get_close_matches(name, known, n=1)
            raise ValueError(
                f"unknown setting {quoted(name)}" + (f"; did you mean {near[0]}?" if near else "")
            )
    return settings(**chosen)


def check_numbers(settings: Any) -> None:
    """ValueError unless all values of a dataclass are numbers >= 0, and probabilities <= 1."""
    for field in fields(settings):
        name, value = field.name, getattr(settings, field.name)
        is_probability = name.endswith("_probability")
        most = 1.0 if is_probability else sys.float_info.max
        is_number = isinstance(value, Real) and not isinstance(value, bool)
        if not (is_number and 0 <= value <= most):
            expected = "a probability from 0 to 1" if is_probability else "a number of at least 0"
            raise ValueError(f"{name}: expected {expected}, found {quoted(value)}")


def first_problem(error: ValidationError) -> tuple[str, str]:
    """Key of the first invalid value, such as "left.fx_px", and the expected and the found
    value.
    """
    first = error.errors(include_url=False)[0]
    key = shortened(repr(".".join(str(part) for part in first["loc"] if part != "[key]"))[1:-1])
    error_type, limits = first["type"], first.get("ctx", {})
    if error_type == "missing":
        return key, "expected a value, found none"
    if error_type in ("extra_forbidden", "unexpected_keyword_argument"):
        return key, _UNKNOWN
    if error_type in ("value_error", "assertion_error"):
        return key, shortened(first["msg"].partition(", ")[2].removesuffix("."), _MAX_PROBLEM)
    if error_type in _EXPECTED:
        expected = _EXPECTED[error_type].format_map(defaultdict(lambda: "?", limits))
    else:
        expected = first["msg"].removeprefix("Input should be ").removeprefix("a valid ")
    return key, f"expected {shortened(expected, _MAX_PROBLEM)}, found {quoted(first['input'])}"


_UNKNOWN = "this key is unknown"
_MAX_PROBLEM = 200  # characters of the description of a problem
_EXPECTED = {  # by pydantic's type of error
    "greater_than": "a number above {gt}",
    "greater_than_equal": "a number of at least {ge}",
    "less_than": "a number below {lt}",
    "less_than_equal": "a number of at most {le}",
    "finite_number": "a finite number",
    "int_type": "an integer",
    "int_parsing": "an integer",
    "int_from_float": "an integer",
    "int_parsing_size": "an integer of at most 64 bits",
    "float_type": "a number",
    "float_parsing": "a number",
    "string_type": "text",
    "bool_type": "true or false",
    "bool_parsing": "true or false",
    "list_type": "a list",
    "tuple_type": "a list",
    "dict_type": "keys with values",
    "model_type": "keys with values",
    "dataclass_type": "keys with values",
    "mapping_type": "keys with values",
    "path_type": "a path",
    "too_short": "at least {min_length} values",
    "too_long": "at most {max_length} values",
}

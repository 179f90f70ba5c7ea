"""Pydantic errors as one sentence with file and key."""

from __future__ import annotations

from typing import Annotated, Any, Literal

import numpy as np
import pytest
from pydantic import BaseModel, ConfigDict, Field

from track_range.foundation.errors import UserError
from track_range.foundation.schemas.validation import (
    Integer,
    Number,
    PositiveNumber,
    Version1,
    chosen_numbers,
    validated,
)
from track_range.ranging.warning.settings import WarningSettings
from track_range.results.events.event import EventSettings


class Inner(BaseModel):
    fx_px: PositiveNumber


class Content(BaseModel):
    model_config = ConfigDict(extra="forbid")
    version: Version1 = 1
    left: Inner = Inner(fx_px=1.0)
    shift: Number = 0.0
    width: Annotated[Integer, Field(ge=1, le=100)] = 1
    row: Annotated[list[Number], Field(min_length=2, max_length=3)] = [0.0, 0.0]
    pair: tuple[Number, Number] = (0.0, 0.0)
    name: str = ""
    kind: Literal["a", "b"] = "a"
    is_grey: bool = False


@pytest.mark.parametrize(
    ("content", "key", "key_word"),
    [
        ({"left": {}}, "left.fx_px", "none"),
        ({"left": None}, "left", "keys"),
        ({"left": {"fx_px": -1}}, "left.fx_px", "above 0"),
        ({"left": {"fx_px": "x" * 1000}}, "left.fx_px", "number"),
        ({"shift": float("nan")}, "shift", "finite"),
        ({"shift": 10**400}, "shift", "number"),
        ({"shift": True}, "shift", "True"),
        ({"shift": [1]}, "shift", "number"),
        ({"width": 2**70}, "width", "at most 100"),
        ({"width": 0}, "width", "at least 1"),
        ({"width": 1.5}, "width", "integer"),
        ({"width": False}, "width", "False"),
        ({"row": [1]}, "row", "at least 2"),
        ({"row": [1] * 1000}, "row", "at most 3"),
        ({"row": [1, None]}, "row.1", "None"),
        ({"pair": 3}, "pair", "list"),
        ({"name": 3}, "name", "text"),
        ({"kind": "c"}, "kind", "'a' or 'b'"),
        ({"is_grey": "maybe"}, "is_grey", "true or false"),
        ({"version": 2}, "version", "expected 1"),
        ({"version": True}, "version", "True"),
        ({"colour": 1}, "colour", "unknown"),
        ({"x" * 1000: 1}, "xxx", "unknown"),
        ([1], "", "keys"),
        (None, "", "keys"),
    ],
)
def test_first_error(content: Any, key: str, key_word: str) -> None:
    with pytest.raises(UserError) as raised:
        validated(Content, content, "a.yaml", UserError)
    message = str(raised.value)
    assert message.startswith(f"a.yaml: '{key}" if key else "a.yaml: ")
    assert key_word in message
    assert message.endswith(".")
    assert len(message) < 300


def test_valid_content() -> None:
    content = validated(Content, {"left": {"fx_px": "1e3"}, "row": [1, 2.5]}, "a.yaml", UserError)
    assert content.left.fx_px == 1000.0
    assert content.row == [1.0, 2.5]


@pytest.mark.parametrize(
    ("chosen", "expected"),
    [
        ({"on_probability": 55}, "on_probability: expected a probability from 0 to 1, found 55"),
        ({"off_probability": -0.1}, "off_probability: expected a probability from 0 to 1"),
        ({"on_probability": True}, "on_probability: expected a probability from 0 to 1"),
        ({"horizon_s": -1}, "horizon_s: expected a number of at least 0, found -1"),
        ({"horizon_s": float("nan")}, "horizon_s: expected a number of at least 0, found nan"),
        ({"horizon_s": 10**400}, "horizon_s: expected a number of at least 0"),
        ({"front_m": "2"}, "front_m: expected a number of at least 0, found '2'"),
        ({"on_probabilty": 0.3}, "did you mean on_probability"),
    ],
)
def test_chosen_numbers_that_are_none(chosen: dict[str, Any], expected: str) -> None:
    with pytest.raises(ValueError, match=expected):
        chosen_numbers(WarningSettings, chosen)


def test_settings_check_their_numbers() -> None:
    with pytest.raises(ValueError, match="on_probability: expected a probability from 0 to 1"):
        WarningSettings(on_probability=55)
    with pytest.raises(ValueError, match="max_gap_s: expected a number of at least 0, found nan"):
        EventSettings(max_gap_s=float("nan"))


def test_chosen_numbers() -> None:
    assert WarningSettings(on_probability=np.float32(0.5)).on_probability == 0.5
    chosen = chosen_numbers(WarningSettings, {"on_probability": 1, "horizon_s": 60})
    assert (chosen.on_probability, chosen.horizon_s) == (1, 60)

"""Flags in sentences, and the keywords that replace them in Python."""

from pathlib import Path
from typing import Annotated, Literal

import pytest

from track_range.foundation.errors import ConfigError
from track_range.foundation.schemas.keywords import KeywordsInErrors, flags_in_errors, with_keywords
from track_range.foundation.schemas.options import Options, option


class Recipe(Options):
    dish: Annotated[str, option("Dish.", metavar="DISH", is_argument=True)] = "soup"
    oven_c: Annotated[float, option("Temperature.", flag="--oven")] = 180.0
    heat: Annotated[Literal["low", "high"], option("Heat.")] = "low"
    salt: Annotated[str, option("Salt.", words=("auto", "off"), metavar="G")] = "auto"
    book: Annotated[Path | None, option("Book.")] = None
    two_pots: Annotated[bool, option("Pots.", flag="--two-pots/--no-two-pots")] = False


@pytest.mark.parametrize(
    ("sentence", "in_python"),
    [
        ("--oven: expected a number, found 'x'.", "oven_c: expected a number, found 'x'."),
        ("--book, --oven: give one of them.", "book, oven_c: give one of them."),
        (
            "a.yaml: expected a temperature; give it with --oven.",
            "a.yaml: expected a temperature; give it with oven_c=.",
        ),
        ("give --book or --oven, not both", "give book= or oven_c=, not both"),
        ("--two-pots needs --heat high", "two_pots=True needs heat=high"),
        (
            "not with --no-two-pots, --two-pots or --salt off.",
            "not with two_pots=False, two_pots=True or salt=off.",
        ),
        ("--oven 300: too hot", "oven_c=300: too hot"),
        ("--book a,b: expected one", "book=a,b: expected one"),
        ("use --book FILE, --book 'x y' or --book=z", "use book=FILE, book='x y' or book=z"),
        ("run `cook --oven 3` with --oven.", "run `cook --oven 3` with oven_c=."),
        (
            "run track-range calibrate --book FILE --oven 3.",
            "run track-range calibrate --book FILE --oven 3.",
        ),
        (
            "--spoon and --ovens are unknown; x--oven is no flag",
            "--spoon and --ovens are unknown; x--oven is no flag",
        ),
        ("DISH: expected a name", "DISH: expected a name"),
    ],
)
def test_flags_become_keywords(sentence, in_python):
    assert with_keywords(sentence, Recipe) == in_python


def fail():
    raise ConfigError("--oven: expected less.")


def test_only_the_command_line_keeps_flags():
    cook = KeywordsInErrors(Recipe)(fail)
    with pytest.raises(ConfigError, match=r"^oven_c: "):
        cook()
    with flags_in_errors(), pytest.raises(ConfigError, match=r"^--oven: "):
        cook()
    with pytest.raises(ConfigError, match=r"^oven_c: "):
        cook()


def test_other_errors_are_unchanged():
    with pytest.raises(ValueError, match=r"^--oven$"), KeywordsInErrors(Recipe):
        raise ValueError("--oven")

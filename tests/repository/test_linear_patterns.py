"""No regular expression of the product takes time that grows with the square of the text."""

import re

import pytest

from tests.repository.patterns import (
    Expression,
    TooSlow,
    expressions_of,
    processor_limit,
    product_modules,
)

N_CHARACTERS = (
    40_000  # of a text: a fifth of what each reader is given, since there are 7,000 texts
)
LIMIT_S = 2.0  # of one text; linear expressions need less than 0.05 s, quadratic ones 4 s and more

SHORT = {  # modules whose expressions only see short texts
    "track_range.fleet.storage.errors": "texts are cut to 4000 characters",
    "track_range.calibration.board_images": "patterns of the command line",
    "track_range.foundation.schemas.keywords": "messages of the program",
    "track_range.cli.commands.doctor": "requirements of installed packages",
    "track_range.recording.sources.live.address": "addresses of the command line",
    "track_range.views.live_view.server": "the program's own page",
}
EXPRESSIONS = {
    name: found
    for name, file in product_modules()
    if name not in SHORT and (found := expressions_of(name, file))
}


def texts_of(expression: Expression) -> set[str]:
    """Texts that are hard for an expression: what it repeats, as often as fits, and no end."""
    repeated = {(before, unit) for before, unit in expression.repeated() if unit}
    repeated |= {("", before + unit) for before, unit in repeated}
    repeated |= {("", start) for start in expression.starts()}
    return {before + unit * (N_CHARACTERS // len(unit)) + "\x00" for before, unit in repeated}


@pytest.mark.slow
@pytest.mark.parametrize("module", EXPRESSIONS)
def test_expressions_are_linear(module: str) -> None:
    for expression in EXPRESSIONS[module]:
        for text in texts_of(expression):
            try:
                with processor_limit(LIMIT_S):
                    expression.apply(text)
            except TooSlow:
                pytest.fail(f"{expression.pattern.pattern!r} is slow for {text[:40]!r}...")


def test_a_slow_expression_is_found() -> None:
    slow = Expression("", re.compile(r"^\s*\[", re.MULTILINE), ("search",))
    assert ("", "\n") in slow.repeated()
    with processor_limit(0.2), pytest.raises(TooSlow):
        slow.apply("\n" * N_CHARACTERS)


def test_texts_begin_as_an_expression_does() -> None:
    expression = Expression("", re.compile(r"K(?:1|_l)\s*=[^;]*;"), ("search",))
    assert expression.starts() == ["K", "K1", "K_", "K_l", "K1 ", "K1=", "K1=0", "K1=;"]
    assert ("K1", "\n") in expression.repeated()
    assert ("K1=", "a") in expression.repeated()

"""Conditions on the columns of events, such as `kind == "cut-in" and min_ttc_s < 2`, as an
expression of Arrow.

Only comparisons, `in`, `is None`, `and`, `or`, `not`, texts and numbers are understood: a condition
is read, never run as a program. An unknown value meets no comparison.
"""

import ast
import difflib
import operator
import re
from collections.abc import Callable, Mapping
from functools import reduce
from typing import TYPE_CHECKING, Any

from track_range.foundation.errors import UserError
from track_range.foundation.files.input_files import quoted, shortened
from track_range.results.events.event import EVENT_KINDS

if TYPE_CHECKING:
    import pyarrow.compute as pc

_EXAMPLE = "'kind == \"cut-in\" and min_ttc_s < 2'"
_MAX_TEXT = 1000  # longest condition, in characters
_CLASS = "class_name"  # column `class`, a word of Python
_COLUMNS = {  # by other names of the same figures
    _CLASS: "class",
    "ttc_front_s": "min_ttc_s",
    "min_ttc_front_s": "min_ttc_s",
    "min_gap_m": "gap_m",
    "min_headway_s": "headway_s",
}
_OPERATORS: Mapping[type[ast.cmpop], Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq,
    ast.NotEq: operator.ne,
    ast.Lt: operator.lt,
    ast.LtE: operator.le,
    ast.Gt: operator.gt,
    ast.GtE: operator.ge,
}
_SWAPPED = {ast.Lt: ast.Gt, ast.LtE: ast.GtE, ast.Gt: ast.Lt, ast.GtE: ast.LtE}


class EventQueryError(UserError):
    """A condition on events that is not understood."""


def event_condition(text: str, is_text: Mapping[str, bool]) -> "pc.Expression":
    """The condition as an expression; `is_text` are the columns, and whether they are texts.

    EventQueryError: the condition is no comparison of columns with values of their kind, or a
    column or kind of event does not exist.
    """
    # outside of quotation marks
    parts = re.split(r"(\"[^\"]*\"|'[^']*')", text.strip())
    parts[::2] = [re.sub(r"\bclass\b", _CLASS, part) for part in parts[::2]]
    try:
        if len(text) > _MAX_TEXT:
            raise ValueError("a text of this length")
        tree = ast.parse("".join(parts), mode="eval")
    except (SyntaxError, ValueError, RecursionError, MemoryError) as error:
        raise _unknown(text) from error
    return _Query(text, is_text).condition(tree.body)


def _unknown(text: str) -> EventQueryError:
    return EventQueryError(
        f"{quoted(shortened(text, 80))}: expected a condition on columns of the events, such as "
        f"{_EXAMPLE}, with ==, !=, <, <=, >, >=, in, and, or, not."
    )


class _Query:
    def __init__(self, text: str, is_text: Mapping[str, bool]) -> None:
        self._text, self._is_text = text, is_text

    def condition(self, node: ast.expr) -> Any:
        if isinstance(node, ast.BoolOp):
            joined = operator.and_ if isinstance(node.op, ast.And) else operator.or_
            return reduce(joined, map(self.condition, node.values))
        if isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not):
            return ~self.condition(node.operand)
        if isinstance(node, ast.Compare):
            sides = [node.left, *node.comparators]
            pairs = zip(sides, node.ops, sides[1:], strict=False)
            return reduce(operator.and_, (self._comparison(*pair) for pair in pairs))
        raise _unknown(self._text)

    def _comparison(self, left: ast.expr, operation: ast.cmpop, right: ast.expr) -> Any:
        import pyarrow.compute as pc

        kind = type(operation)
        if not isinstance(left, ast.Name):  # 2 > min_ttc_s
            if not isinstance(right, ast.Name) or isinstance(operation, ast.In | ast.NotIn):
                raise _unknown(self._text)
            left, right, kind = right, left, _SWAPPED.get(kind, kind)
        name = self._column(left.id)
        field = pc.field(name)
        if kind in _OPERATORS:
            if isinstance(right, ast.Name):
                other = self._column(right.id)
                if self._is_text[name] != self._is_text[other]:
                    raise EventQueryError(
                        f"{name}, {other}: expected two texts or two numbers to compare."
                    )
                return _OPERATORS[kind](field, pc.field(other))
            return _OPERATORS[kind](field, pc.scalar(self._value(name, right)))
        if kind in (ast.In, ast.NotIn) and isinstance(right, ast.Tuple | ast.List | ast.Set):
            is_in = field.isin([self._value(name, one) for one in right.elts])
            # isin takes an unknown value as one that is in no list
            known = pc.if_else(field.is_valid(), is_in, pc.scalar(None))
            return known if kind is ast.In else ~known
        if kind in (ast.Is, ast.IsNot) and ast.unparse(right) == "None":
            return field.is_null() if kind is ast.Is else field.is_valid()
        raise _unknown(self._text)

    def _column(self, name: str) -> str:
        column = _COLUMNS.get(name, name)
        if column not in self._is_text:
            near = difflib.get_close_matches(column, self._is_text, n=3, cutoff=0.4)
            hint = f"; did you mean {' or '.join(near)}?" if near else "."
            raise EventQueryError(
                f"{quoted(name)}: expected one of the columns {', '.join(self._is_text)}{hint}"
            )
        return column

    def _value(self, column: str, node: ast.expr) -> Any:
        """A text or number, as the column has it."""
        is_negative = isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.USub)
        written = node.operand if isinstance(node, ast.UnaryOp) and is_negative else node
        value = written.value if isinstance(written, ast.Constant) else None
        expected = str if self._is_text[column] else int | float
        is_huge = isinstance(value, int) and abs(value) >= 2**63
        if not isinstance(value, expected) or isinstance(value, bool) or is_huge:
            words = "a text in quotation marks" if self._is_text[column] else "a number"
            raise EventQueryError(
                f"{column}: expected {words} to compare with, found {quoted(ast.unparse(node))}."
            )
        if not isinstance(value, str):
            return -value if is_negative else value
        if column != "kind":
            return value
        kind = re.sub(r"[\s-]", "_", value.lower())
        if kind not in EVENT_KINDS:
            raise EventQueryError(
                f"kind: expected one of {', '.join(EVENT_KINDS)}, found {quoted(value)}."
            )
        return kind

"""The reader of all YAML and JSON files: limited in size and depth, without nested aliases; errors
are one sentence.

    regular file -> text -> events: depth, aliases, tags -> plain values -> pydantic model (`schemas.validation`)

An alias counts as many values as what it stands for, and is refused in what another one stands for:
a file of 500 bytes with nested aliases expands to gigabytes (the "billion laughs" attack).
"""

import json
import math
import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import yaml

from track_range.foundation.files.input_files import MAX_TEXT_BYTES, quoted, read_text, shortened

# lists and objects of a JSON file; empty ones take 3 bytes of it and 64 of memory
MAX_CONTAINERS = 10_000_000
# keys and values of a YAML file, which take half a second; 21,000 class names fit
MAX_YAML_VALUES = 25_000
# of nested lists and mappings; characters of a number (float64: 309 before the point)
MAX_DEPTH, _MAX_DIGITS = 32, 400
_TAGS = frozenset(
    f"tag:yaml.org,2002:{name}" for name in ("null", "bool", "int", "float", "str", "seq", "map")
)
"""Tags of the values that JSON also has; other tags are refused."""

_NOUNS = {
    "int": "an integer of at most 64 bits",
    "float": "a number",
    "bool": "true or false",
    "str": "text",
}
"""Noun phrases for messages by the last part of a tag."""

_BaseLoader: Any = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class _Loader(_BaseLoader):  # type: ignore[misc]
    """YAML's safe loader, with the line number in every error; dates are texts, and duplicate keys
    are errors.
    """

    yaml_implicit_resolvers = {  # noqa: RUF012 - PyYAML's way to set them
        first: [(tag, pattern) for tag, pattern in resolvers if tag in _TAGS]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        type_name = str(node.tag).rpartition(":")[2]
        try:
            if type_name in ("int", "float") and len(node.value) > _MAX_DIGITS:
                raise ValueError("too many digits")
            return _checked(super().construct_object(node, deep=deep))
        except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError) as reason:
            problem = f"expected {_NOUNS.get(type_name, type_name)}, got {quoted(node.value, 20)}"
            raise yaml.constructor.ConstructorError(
                None, None, problem, node.start_mark
            ) from reason

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        mapping: dict[Any, Any] = super().construct_mapping(node, deep=deep)
        if len(mapping) < len(node.value):
            problem = (
                f"the key {quoted(_first_duplicate(key.value for key, _ in node.value))} is given "
                "twice"
            )
            raise yaml.constructor.ConstructorError(None, None, problem, node.start_mark)
        return mapping


def read_yaml(
    path: Path, error: type[Exception], expected: str, *, max_bytes: int = MAX_TEXT_BYTES
) -> Any:
    """Content of a YAML file as plain values: None, bool, int, float, str, list, dict.

    Raises `error` if the file cannot be read, or is not YAML within the limits; the message names
    file, line and `expected`, a noun phrase such as "the settings.yaml of a run".
    """
    return parse_yaml(read_text(path, error, expected, max_bytes=max_bytes), path, error, expected)


def read_json(
    path: Path, error: type[Exception], expected: str, *, max_bytes: int = MAX_TEXT_BYTES
) -> Any:
    """Content of a JSON file as plain values; see `read_yaml` for the arguments and errors."""
    return parse_json(read_text(path, error, expected, max_bytes=max_bytes), path, error, expected)


def parse_yaml(text: str, source: object, error: type[Exception], expected: str) -> Any:
    """Plain values of a YAML text of `source`, a file; raises `error` if it is not YAML within the
    limits.
    """
    try:
        _check_events(text)
        return yaml.load(text, _Loader)  # noqa: S506 - derived from the safe loader
    except yaml.YAMLError as reason:
        mark = getattr(reason, "problem_mark", None)
        line = "" if mark is None else f", line {mark.line + 1}"
        problem = shortened(_problem(reason), 100)
        raise error(
            f"{source}{line}: expected {expected} in YAML, found an error: {problem}."
        ) from reason
    # of the parser itself
    except (ArithmeticError, LookupError, RecursionError, TypeError, ValueError) as reason:
        raise error(
            f"{source}: expected {expected} in YAML, found text that is not YAML."
        ) from reason


def parse_json(text: str, source: object, error: type[Exception], expected: str) -> Any:
    """Plain values of a JSON text of `source`, a file; raises `error` if it is invalid, too large,
    or repeats a key.
    """
    if text.count("[") + text.count("{") > MAX_CONTAINERS:
        raise error(
            f"{source}: expected {expected} in JSON, found more than {MAX_CONTAINERS} "
            "lists and objects."
        )
    try:
        value = json.loads(
            text,
            object_pairs_hook=_unique,
            parse_constant=_finite,
            parse_float=_finite,
            parse_int=_integer,
        )
        # half a character, with which a text may not be encodable
        if re.search(r"\\u[dD][89a-fA-F]", text):
            json.dumps(value, ensure_ascii=False).encode()
        is_deep = _is_deeper(value, MAX_DEPTH)
    except json.JSONDecodeError as reason:
        raise error(
            f"{source}, line {reason.lineno}: expected {expected} in JSON, found an error: "
            f"{reason.msg}."
        ) from reason
    except UnicodeEncodeError as reason:
        raise error(
            f"{source}: expected {expected} in JSON, found a text that is not Unicode."
        ) from reason
    except ValueError as reason:  # of the hooks
        raise error(f"{source}: expected {expected} in JSON, found {reason}.") from reason
    except RecursionError:
        is_deep = True
    if is_deep:
        raise error(
            f"{source}: expected {expected} in JSON, found more than {MAX_DEPTH} nested brackets."
        )
    return value


class _Dumper(yaml.SafeDumper):
    """YAML's safe writer, without aliases for lists that occur twice, which `parse_yaml`
    refuses.
    """

    def ignore_aliases(self, data: Any) -> bool:
        return True


def yaml_text(content: Mapping[str, Any], **style: Any) -> str:
    """A YAML text of plain values, not recursive, in their order; `style`: arguments of
    `yaml.dump`, such as width.
    """
    return str(yaml.dump(dict(content), Dumper=_Dumper, sort_keys=False, **style))


def _problem(error: yaml.YAMLError) -> str:
    """Description of a syntax error, with its context if the parser splits the description."""
    problem = str(getattr(error, "problem", None) or "characters that YAML does not allow")
    # libyaml from 0.2.6 reads ahead and may reach its own limit, 1000, first
    if "nesting depth" in problem:
        return f"more than {MAX_DEPTH} nested lists or keys"
    context = str(getattr(error, "context", None) or "")
    # such as "found duplicate anchor" and "second occurrence"
    if context and not context.startswith("while "):
        problem = f"{context}, {problem}"
    return problem.removeprefix("but ").removeprefix("found ")


class _Anchors:
    """The anchors of a YAML text, and how many values each stands for."""

    def __init__(self) -> None:
        self.sizes: dict[str | None, int] = {}  # of those that are closed
        self.opened: list[tuple[int, str, int]] = []  # depth, name and first value

    def see(self, event: yaml.Event, depth: int, n_values: int) -> None:
        """Note an anchor that begins or ends with an event."""
        anchor = getattr(event, "anchor", None)
        if isinstance(event, yaml.CollectionStartEvent) and anchor is not None:
            self.opened.append((depth, anchor, n_values))
        elif isinstance(event, yaml.ScalarEvent) and anchor is not None:
            self.sizes[anchor] = 1
        elif isinstance(event, yaml.CollectionEndEvent) and self.opened:
            opened_depth, anchor, first = self.opened[-1]
            if opened_depth == depth:
                self.opened.pop()
                self.sizes[anchor] = n_values - first + 1


def _check_events(text: str) -> None:
    """Raise yaml.YAMLError for invalid syntax, too much depth, nested aliases, and tags of other
    types.
    """
    depth = n_values = 0
    anchors = _Anchors()
    for event in yaml.parse(text, _BaseLoader):
        problem = ""
        n_values += isinstance(event, yaml.NodeEvent)
        if isinstance(event, yaml.AliasEvent):
            if anchors.opened or event.anchor not in anchors.sizes:
                problem = f"the alias '*{shortened(str(event.anchor))}'; write the value itself"
            n_values += anchors.sizes.get(event.anchor, 0)
        elif isinstance(event, yaml.CollectionStartEvent):
            depth += 1
            problem = f"more than {MAX_DEPTH} nested lists or keys" if depth > MAX_DEPTH else ""
        anchors.see(event, depth, n_values)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if (tag := getattr(event, "tag", None)) not in (None, "!", *_TAGS):
            problem = f"the tag {quoted(tag)}; write plain values"
        if n_values > MAX_YAML_VALUES:
            problem = f"more than {MAX_YAML_VALUES} values"
        if problem:
            raise yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)  # type: ignore[arg-type]


def _is_deeper(value: object, depth: int) -> bool:
    """Whether lists and dicts are nested more than `depth` deep."""
    level: list[Any] = [value] if isinstance(value, list | dict) else []
    for _ in range(depth):
        parts = (
            part for item in level for part in (item.values() if isinstance(item, dict) else item)
        )
        level = [part for part in parts if isinstance(part, list | dict)]
    return bool(level)


def _unique(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    values = dict(pairs)
    if len(values) < len(pairs):
        raise ValueError(f"the key {quoted(_first_duplicate(name for name, _ in pairs))} twice")
    return values


def _first_duplicate(names: Iterable[str]) -> str:
    """The first name that occurs a second time; empty if there is none."""
    seen: set[str] = set()
    for name in names:
        if name in seen:
            return name
        seen.add(name)
    return ""


def _finite(text: str) -> float:
    """The number of a JSON text; raises ValueError if it is NaN or infinite."""
    if not math.isfinite(value := float(text)):
        raise ValueError(f"the number {shortened(text, 20)}, which is not finite")
    return value


def _integer(digits: str) -> int:
    if len(digits) > _MAX_DIGITS:
        raise ValueError("an integer of more than 64 bits")
    return int(_checked(int(digits)))


def _checked(value: Any) -> Any:
    """The value; raises ValueError for an integer of more than 64 bits and a text that cannot be
    encoded.
    """
    if isinstance(value, int) and not -(2**63) <= value < 2**63:
        raise ValueError("an integer of more than 64 bits")
    if isinstance(value, str) and not value.isascii():
        value.encode()
    return value

"""The regular expressions of the product, texts that begin as they do, and a limit of processor time.

Python's `re` tries all ways in which an expression can match. Where two repetitions can take the same characters, or a
repetition is tried from each of them, the time grows with the square of the text: 200 kB then take minutes instead of
milliseconds. Possessive repetitions (`\\s*+`), and classes without the first character, avoid it.
"""

import ast
import dataclasses
import importlib
import re
import signal
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from re import _constants as codes, _parser as parser  # type: ignore[attr-defined]
from types import FrameType, ModuleType
from typing import Any

from tests.repository.structure import PROJECT, rooms

N_BYTES = 200_000  # length of the texts
_METHODS = ("search", "match", "fullmatch", "findall", "finditer", "sub", "split")
_MANY = 20  # repetitions from which an expression counts as unlimited
_CHARACTERS = "0aZ_ \n\t-.:=[](){}<>/\\\"',;#$%&*+!?@^`|~eE\x01\xff"  # one of each kind
_CLASSES = {
    codes.CATEGORY_DIGIT: str.isdecimal,
    codes.CATEGORY_SPACE: str.isspace,
    codes.CATEGORY_WORD: lambda text: text.isalnum() or text == "_",
    codes.CATEGORY_NOT_DIGIT: lambda text: not text.isdecimal(),
    codes.CATEGORY_NOT_SPACE: lambda text: not text.isspace(),
    codes.CATEGORY_NOT_WORD: lambda text: not (text.isalnum() or text == "_"),
}
_SINGLE = (codes.LITERAL, codes.NOT_LITERAL, codes.ANY, codes.IN)
_REPEATS = (codes.MAX_REPEAT, codes.MIN_REPEAT, codes.POSSESSIVE_REPEAT)


class TooSlow(BaseException):
    """The limit of processor time was reached; no reader can catch it as a damaged file."""


@contextmanager
def processor_limit(limit_s: float) -> Iterator[None]:
    """Context that ends with TooSlow after `limit_s` of processor time of this process."""

    def stop(number: int, frame: FrameType | None) -> None:
        raise TooSlow(f"expected less than {limit_s:g} s of processor time")

    before = signal.signal(signal.SIGPROF, stop)
    signal.setitimer(signal.ITIMER_PROF, limit_s)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, before)


@dataclass(frozen=True)
class Expression:
    """A regular expression of a module, and the methods with which it is used."""

    module: str
    pattern: re.Pattern[Any]
    methods: tuple[str, ...]

    def apply(self, text: str) -> None:
        """Use the expression as the product does."""
        given: Any = text.encode("latin-1") if isinstance(self.pattern.pattern, bytes) else text
        for method in self.methods:
            if method == "sub":
                self.pattern.sub(lambda match: match[0], given)
            elif method == "finditer":
                list(self.pattern.finditer(given))
            else:
                getattr(self.pattern, method)(given)

    @property
    def parsed(self) -> Any:
        """The tree of Python's parser."""
        text = self.pattern.pattern
        flags = self.pattern.flags
        if isinstance(text, bytes):
            return parser.parse(text.decode("latin-1"), flags & ~re.UNICODE)
        return parser.parse(text, flags)

    def starts(self) -> list[str]:
        """Texts that begin as a match does: its first parts, one more each."""
        return list(dict.fromkeys(start for start in _starts(self.parsed) if start))

    def repeated(self) -> list[tuple[str, str]]:
        """For each repetition in the expression, a text before it and one that it repeats."""
        return list(dict.fromkeys(_repeated(self.parsed, "")))


def product_modules() -> Iterator[tuple[str, Path]]:
    """Name and file of each module of the product."""
    for files in rooms().values():
        for file in files:
            parts = list(file.relative_to(PROJECT).with_suffix("").parts)
            if parts[0] != "track_range":
                parts.insert(0, "track_range")
            yield ".".join(parts).removesuffix(".__init__"), file


def expressions_of(name: str, file: Path) -> list[Expression]:
    """The expressions that a module compiles, or passes to functions of `re`."""
    source = file.read_text()
    if not re.search(r"^import re$", source, re.MULTILINE):
        return []
    tree = ast.parse(source)
    module = importlib.import_module(name)
    used = _methods_by_name(tree)
    imported = {
        alias.asname or alias.name
        for node in tree.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }
    found = [
        Expression(name, pattern, tuple(sorted(used.get(owner, {"search"}))))
        for owner, value in vars(module).items()
        if owner not in imported
        for pattern in _patterns_in(value, module)
    ]
    found += [
        Expression(name, pattern, (method,)) for method, pattern in _inline_patterns(tree, module)
    ]
    return list(dict.fromkeys(found))


def _patterns_in(value: object, module: ModuleType, depth: int = 0) -> Iterator[re.Pattern[Any]]:
    """The expressions in a value of a module, also in its tables."""
    if isinstance(value, re.Pattern):
        yield value
    if depth > 3:
        return
    parts: Collection[object] = ()
    if isinstance(value, Mapping):
        parts = list(value.values())
    elif isinstance(value, tuple | list):
        parts = value
    elif dataclasses.is_dataclass(value) and not isinstance(value, type):
        parts = [getattr(value, field.name) for field in dataclasses.fields(value)]
    for part in parts:
        yield from _patterns_in(part, module, depth + 1)


def _methods_by_name(tree: ast.AST) -> dict[str, set[str]]:
    """The methods of expressions that are used of each global name."""
    used: dict[str, set[str]] = {}
    for node in ast.walk(tree):
        if (
            isinstance(node, ast.Attribute)
            and node.attr in _METHODS
            and isinstance(node.value, ast.Name)
        ):
            used.setdefault(node.value.id, set()).add(node.attr)
    return used


def _inline_patterns(tree: ast.AST, module: ModuleType) -> Iterator[tuple[str, re.Pattern[Any]]]:
    """Function of `re` and expression of its calls whose arguments are constants of the module."""
    places = {"sub": 4, "split": 3}
    for node in ast.walk(tree):
        if not (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Attribute)
            and node.func.attr in _METHODS
            and ast.unparse(node.func.value) == "re"
        ):
            continue
        method, place = node.func.attr, places.get(node.func.attr, 2)
        given = [word.value for word in node.keywords if word.arg == "flags"] + node.args[place:]
        try:
            text, *flags = (
                eval(ast.unparse(part), vars(module))  # noqa: S307 - the product's source
                for part in (node.args[0], *given[:1])
            )
        except NameError:  # of a local variable
            continue
        if isinstance(text, str | bytes):
            yield method, re.compile(text, *flags)


def _characters(code: Any, argument: Any) -> list[str]:
    """Characters that an item of an expression matches, one of each kind."""
    if code is codes.LITERAL:
        return [chr(argument)]
    if code is codes.NOT_LITERAL:
        return [text for text in _CHARACTERS if ord(text) != argument]
    if code is codes.ANY:
        return ["a", " "]
    is_negated = argument[0][0] is codes.NEGATE
    items = argument[1:] if is_negated else argument
    return [text for text in _CHARACTERS if _is_in(text, items) != is_negated] or ["\x80"]


def _is_in(text: str, items: Any) -> bool:
    for code, argument in items:
        if code is codes.LITERAL and ord(text) == argument:
            return True
        if code is codes.RANGE and argument[0] <= ord(text) <= argument[1]:
            return True
        if code is codes.CATEGORY and _CLASSES[argument](text):
            return True
    return False


def _sample(tree: Any) -> str:
    """A short text that a part of an expression matches."""
    return "".join(_sample_of(code, argument) for code, argument in tree)


def _sample_of(code: Any, argument: Any) -> str:
    if code in _SINGLE:
        return _characters(code, argument)[0]
    if code in _REPEATS:
        return _sample(argument[2]) * argument[0]
    if code is codes.SUBPATTERN:
        return _sample(argument[3])
    if code is codes.ATOMIC_GROUP:
        return _sample(argument)
    if code is codes.BRANCH:
        return _sample(argument[1][0])
    return ""


def _starts(tree: Any, prefix: str = "") -> Iterator[str]:
    """Texts that begin as matches of an expression do."""
    for code, argument in tree:
        if code is codes.BRANCH:
            for branch in argument[1]:
                yield from _starts(branch, prefix)
        elif code is codes.SUBPATTERN:
            yield from _starts(argument[3], prefix)
        elif code in _REPEATS:
            yield from _starts(argument[2], prefix)
        prefix += _sample_of(code, argument)
        yield prefix


def _repeated(tree: Any, prefix: str) -> Iterator[tuple[str, str]]:
    for code, argument in tree:
        if code in _REPEATS:
            least, most, part = argument
            if most > _MANY:
                is_single = len(part) == 1 and part[0][0] in _SINGLE
                units = _characters(*part[0]) if is_single else [_sample(part) or "a"]
                yield from ((prefix, unit) for unit in units)
            yield from _repeated(part, prefix)
            prefix += _sample(part) * least
            continue
        if code is codes.SUBPATTERN:
            yield from _repeated(argument[3], prefix)
        elif code is codes.BRANCH:
            for branch in argument[1]:
                yield from _repeated(branch, prefix)
        elif code is codes.ATOMIC_GROUP:
            yield from _repeated(argument, prefix)
        prefix += _sample_of(code, argument)

"""Files that match patterns such as `DIR/*/front_*.mp4`, local and remote."""

from __future__ import annotations

import re
from collections.abc import Iterator

from track_range.fleet.storage.entry import Entry, is_hidden
from track_range.fleet.storage.location import Location

_MAGIC = re.compile(r"[*?\[]")


def split_pattern(location: Location) -> tuple[Location, list[str]] | None:
    """The folder before the first wildcard, and the names below it; None = no wildcard, or a file with this name."""
    address, query = location.address_and_options()
    if not _MAGIC.search(address) or location.exists():
        return None
    parts = address.split("/")
    first = next(index for index, part in enumerate(parts) if _MAGIC.search(part))
    return Location.of("/".join(parts[:first]) + query if any(parts[:first]) else "/"), parts[first:]


def matching(folder: Location, names: list[str]) -> Iterator[Entry]:
    """Files and folders below a folder that match; `**` matches any number of folders. Hidden ones match no `*`.

    Raises:
        StorageError: a folder cannot be read.
    """
    yield from _matching(folder, "", names)


def _matching(folder: Location, prefix: str, names: list[str]) -> Iterator[Entry]:
    if "**" in names[:1]:
        expression = _expression(names)
        for entry in folder.list(recursive=True):
            if expression.fullmatch(entry.name) and not is_hidden(entry.name):
                yield Entry(prefix + entry.name, entry.stat)
        return
    expression, is_hidden_matched = _expression(names[:1]), names[0].startswith(".")
    for entry in folder.list():
        if not expression.fullmatch(entry.name) or (entry.name.startswith(".") and not is_hidden_matched):
            continue
        if len(names) == 1:
            yield Entry(prefix + entry.name, entry.stat)
        elif entry.stat.is_folder:
            yield from _matching(folder.child(entry.name), f"{prefix}{entry.name}/", names[1:])


def _expression(names: list[str]) -> re.Pattern[str]:
    """Regular expression of relative paths that match the names."""
    parts = []
    for index, name in enumerate(names):
        is_last = index == len(names) - 1
        if name == "**":
            parts.append(".*" if is_last else "(?:[^/]+/)*")
        else:
            parts.append(_translated(name) + ("" if is_last else "/"))
    return re.compile("".join(parts), re.DOTALL)


def _translated(name: str) -> str:
    """Regular expression of one name with `*`, `?` and `[...]`; a bracket that is not closed is a character."""
    result, index = [], 0
    while index < len(name):
        character = name[index]
        end = name.find("]", index + 2) if character == "[" else -1
        if character == "*":
            result.append("[^/]*")
        elif character == "?":
            result.append("[^/]")
        elif end > 0:
            inner = re.sub(r"([\\\[&~|])", r"\\\1", name[index + 1 : end])
            result.append(f"[^{inner[1:]}]" if inner.startswith("!") else f"[{_escaped_caret(inner)}]")
            index = end
        else:
            result.append(re.escape(character))
        index += 1
    return "".join(result)


def _escaped_caret(inner: str) -> str:
    return f"\\{inner}" if inner.startswith("^") else inner

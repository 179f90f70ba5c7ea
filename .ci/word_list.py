"""Words and names that the project's language rules exclude (CONVENTIONS.md, section Language).

`python .ci/word_list.py [PATH ...]` prints every use as `path:line: word: text` and exits with 1 if
there is one that `.ci/word_list_exceptions.txt` does not justify. Without paths it checks the
product code, the README and the docs.
"""

from __future__ import annotations

import ast
import os
import re
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
EXCEPTIONS = Path(__file__).with_name("word_list_exceptions.txt")
"""One justified use per line: `path: part of the line  # reason`. At most `MAX_EXCEPTIONS`."""

MAX_EXCEPTIONS = 40
CHECKED = (
    *("detection", "tracking", "stereo", "ranging", "track_range", "docs"),
    *("README.md", "CONVENTIONS.md", "CONTRIBUTING.md", "CHANGELOG.md"),
)
SUFFIXES = {".py", ".md", ".j2", ".js", ".html", ".css", ".yaml", ".yml"}

WORDS = [
    r"mend(?:ed|s|ing)?",  # correct, repair
    r"reckon(?:s|ed|ing)?",  # estimate; dead reckoning is odometry here
    r"heed(?:s|ed)?",  # use
    r"own lane",  # ego lane
    r"shares? of",  # fraction
    r"looks of",  # appearance
    r"sold as",  # reported as
    r"passed over",  # skipped
    r"restless(?:ness)?",  # noise, jitter
    r"begun",
    r"anew",
]
"""Words for which the field has a term, as regular expressions of whole words."""

NAME_PARTS = {"share", "shares", "nearness", "way", "ways"}
"""Words that no identifier contains: a fraction, an inverse depth, a path or a distance travelled."""

CONTRACT_NAMES = {
    *(
        "visible_share",
        "share",
        "rough_share",
        "noise_share",
        "noise_shares",
        "min_valid_share",
    ),
    *("shape_share", "last_share", "average_share"),
}
"""Names of columns, keys of files and of the Python API, which users' files and programs have."""

NAMES = {
    *("this", "those", "these", "each", "found", "here", "there", "taken", "such", "ours", "keep"),
    *("of_class", "of_classes", "of_run", "of_image", "of_track"),
}
"""Identifiers that name nothing; a noun takes their place. (Settings are called `settings`, a mask
`is_...`.)"""

_PATTERN = re.compile(r"\b(?:" + "|".join(WORDS) + r")\b", re.IGNORECASE)


def uses_in_text(lines: list[str]) -> Iterator[tuple[int, str]]:
    """Line numbers from 1 and the phrases found there; underscores part words."""
    for number, line in enumerate(lines, start=1):
        for match in _PATTERN.finditer(line.replace("_", " ")):
            yield number, match.group()


def uses_in_names(source: str) -> Iterator[tuple[int, str]]:
    """Line numbers from 1 and names of variables, parameters, attributes, functions and classes
    that are excluded.
    """
    for node in ast.walk(ast.parse(source)):
        names: list[tuple[int, str]] = []
        if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
            names = [(node.lineno, node.id)]
        elif isinstance(node, ast.Attribute) and isinstance(node.ctx, ast.Store):
            names = [(node.lineno, node.attr)]
        elif isinstance(node, ast.arg):
            names = [(node.lineno, node.arg)]
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef | ast.ClassDef):
            names = [(node.lineno, node.name)]
        for line, name in names:
            bare = name.strip("_")
            if bare not in CONTRACT_NAMES and (
                bare in NAMES or NAME_PARTS & set(bare.lower().split("_"))
            ):
                yield line, f"name {name}"


def files_under(paths: list[Path]) -> Iterator[Path]:
    """The text files to check, each once: symbolic links are not followed."""
    for path in paths:
        if path.is_file():
            yield path
            continue
        for folder, folders, names in os.walk(path):
            folders[:] = sorted(name for name in folders if not name.startswith((".", "__")))
            yield from (
                Path(folder, name) for name in sorted(names) if Path(name).suffix in SUFFIXES
            )


def exceptions() -> list[tuple[str, str]]:
    """The justified uses as (path, part of the line)."""
    if not EXCEPTIONS.is_file():
        return []
    lines = [line.split("  # ")[0].rstrip() for line in EXCEPTIONS.read_text().splitlines()]
    return [tuple(line.split(": ", 1)) for line in lines if line and not line.startswith("#")]  # type: ignore[misc]


def main(arguments: list[str]) -> int:
    """Print the uses that nothing justifies; 0 if there are none."""
    paths = [Path(argument).resolve() for argument in arguments] or [
        ROOT / name for name in CHECKED
    ]
    justified, used = exceptions(), set()
    n_uses = 0
    for path in files_under([path for path in paths if path.exists()]):
        name = path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else str(path)
        source = path.read_text(encoding="utf-8")
        lines = source.splitlines()
        uses = [*uses_in_text(lines), *(uses_in_names(source) if path.suffix == ".py" else ())]
        for number, word in sorted(set(uses)):
            line = lines[number - 1].strip()
            reason = next(
                (entry for entry in justified if entry[0] == name and entry[1] in line), None
            )
            if reason is not None:
                used.add(reason)
                continue
            print(f"{name}:{number}: {word}: {line[:110]}")
            n_uses += 1
    stale = [] if arguments else [entry for entry in justified if entry not in used]
    for entry in stale:
        print(f"{EXCEPTIONS.name}: no longer needed: {entry[0]}: {entry[1]}")
    if len(justified) > MAX_EXCEPTIONS:
        print(
            f"{EXCEPTIONS.name}: {len(justified)} justified uses, at most {MAX_EXCEPTIONS} are "
            "allowed"
        )
    if n_uses:
        print(f"{n_uses} uses of excluded words; use the field's terms (CONVENTIONS.md, Language).")
    return int(bool(n_uses or stale or len(justified) > MAX_EXCEPTIONS))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

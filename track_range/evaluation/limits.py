"""Limits of the figures of runs, as an acceptance test asks them: `fused.median_relative_error_pct < 5`.

A limit is a figure of summary.json, an operator and a number or word. A figure is named by its keys,
joined by points; the first is a method or a section. There is no other syntax, so that nothing of a file
is executed.

    LIMIT   FIGURE OPERATOR VALUE | abs(FIGURE) OPERATOR VALUE       OPERATOR   < <= > >= == !=
    FIGURE  KEY.KEY..., such as fused.bias_pct, tracks.mota, events.by_kind.cut-in, fused.bands.0.n
"""

import difflib
import math
import operator
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any
from xml.etree import ElementTree

from track_range.foundation.errors import ConfigError, UsageError
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.output_files import OutputError, write_text
from track_range.foundation.files.structured_text import read_json, read_yaml
from track_range.foundation.schemas.options import Options, option
from track_range.results.folder import read_run_folder

_LIMIT = re.compile(
    r"(abs\(\s*+)?([A-Za-z_][\w.-]*+)\s*+(\)\s*+)?(<=|>=|==|!=|<|>)\s*+([^\s<>=!].*)"
)
_COMPARE: Mapping[str, Callable[[Any, Any], bool]] = {
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
    "==": operator.eq,
    "!=": operator.ne,
}
_WORDS: Mapping[str, Any] = {"true": True, "false": False}
_NO_XML = re.compile("[^\t\n\r -\ud7ff\ue000-\ufffd\U00010000-\U0010ffff]")
_EXAMPLE = "such as 'fused.median_relative_error_pct < 5'"
_N_NEAR = 4  # names that an error suggests


class CheckSettings(Options):
    """Runs and limits of `track-range check`."""

    folders: Annotated[
        tuple[Path, ...],
        option(
            "Result folder of a run, or local folder of a fleet with reports; several folders are "
            "checked one by one.",
            metavar="DIR...",
            is_argument=True,
            is_repeated=True,
        ),
    ]
    require: Annotated[
        tuple[str, ...],
        option(
            "Limit of a figure of summary.json, such as 'fused.median_relative_error_pct < 5' or "
            "'abs(fused.bias_pct) <= 3'; repeatable.",
            metavar="LIMIT",
            is_repeated=True,
        ),
    ] = ()
    limits: Annotated[
        Path | None,
        option("YAML file with a list of limits under the key `limits`.", metavar="FILE"),
    ] = None
    min_coverage: Annotated[
        float,
        option(
            "Fraction of the boxes that a method has to measure; the limits of a method with a "
            "smaller coverage are broken.",
            ge=0.0,
            le=1.0,
        ),
    ] = 0.5
    junit: Annotated[
        Path | None, option("JUnit XML file for the results, for CI servers.", metavar="FILE.xml")
    ] = None


def check(settings: CheckSettings) -> dict[str, Any]:
    """`holds`, whether all limits hold, and `limits`, a row per run and limit with the value and a
    sentence.

    Raises UsageError: a limit cannot be understood, or names an unknown figure; OutputError: a folder
    has no run, or the JUnit file cannot be written; ConfigError: the file of limits is no such file.
    """
    texts = [*settings.require, *_of_file(settings.limits)]
    if not texts:
        raise UsageError(f"--require: expected a limit {_EXAMPLE}, or a file of --limits.")
    rows = [
        {"run": str(folder), "limit": " ".join(text.split()), **row}
        for folder in _runs(settings.folders)
        for text, row in _checked(folder, texts, settings.min_coverage)
    ]
    rows += [row for folder in settings.folders for row in _without_results(folder)]
    figures = {"holds": all(row["holds"] for row in rows), "limits": rows}
    if settings.junit is not None:
        write_text(settings.junit, _junit(rows))
    return figures


def _of_file(path: Path | None) -> list[str]:
    document = None if path is None else read_yaml(path, ConfigError, "a YAML file of limits")
    listed = document.get("limits") if isinstance(document, dict) else document
    if path is not None and (
        not isinstance(listed, list) or not all(isinstance(text, str) for text in listed)
    ):
        raise ConfigError(f"{path}: expected a list 'limits:' of limits {_EXAMPLE}.")
    return listed or []


def _runs(folders: Sequence[Path]) -> Iterator[Path]:
    """The folders of runs: those given, and the clips of a fleet."""
    for folder in folders:
        clips = sorted((folder / "runs").glob("clip=*"))
        yield from clips or [folder]


def _without_results(folder: Path) -> Iterator[dict[str, Any]]:
    """A broken limit for a fleet in which clips failed or are left, which have no figures."""
    file = folder / "fleet.json"
    state = read_json(file, OutputError, "the state of a fleet") if file.exists() else None
    total = state.get("total") if isinstance(state, dict) else None
    n_clips = len(list((folder / "runs").glob("clip=*")))
    if isinstance(total, int) and n_clips < total:
        sentence = f"{n_clips} of {total} clips have results"
        limit = {"run": str(folder), "limit": "results of all clips", "value": n_clips}
        yield {**limit, "holds": False, "sentence": sentence}


def _checked(
    folder: Path, texts: Sequence[str], min_coverage: float
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Each limit with its `value`, whether it `holds`, and a `sentence`."""
    summary = read_run_folder(folder, has_events=False).summary
    for text in texts:
        match = _LIMIT.fullmatch(text.strip())
        if match is None or bool(match[1]) != bool(match[3]):
            raise UsageError(f"--require {quoted(text)}: expected a limit {_EXAMPLE}.")
        absolute, name, _, sign, word = match.groups()
        section, value = _figure(summary, name)
        coverage = section.get("coverage")
        coverage = float(coverage) if isinstance(coverage, int | float) else 1.0
        if absolute and isinstance(value, int | float):
            value = abs(value)
        row: dict[str, Any] = {"value": value, "holds": False}
        if value is None or (isinstance(value, float) and math.isnan(value)):
            row["sentence"] = f"{name} was not measured"
        elif coverage < min_coverage and not name.endswith(("coverage", ".n")):
            row["sentence"] = (
                f"{name} is {value}, of only {100 * coverage:.0f} % of the boxes "
                f"(--min-coverage {min_coverage:g})"
            )
        else:
            row["holds"] = _holds(value, sign, word, text)
            row["sentence"] = f"{name} is {value}"
        yield text, row


def _figure(summary: Mapping[str, Any], name: str) -> tuple[Mapping[str, Any], Any]:
    """The section of a method, or an empty one, and the value of a name in it."""
    methods = summary.get("methods") or {}
    first, *keys = name.split(".")
    value: Any = {**summary, **methods}
    section = methods.get(first) or {}
    for place, key in enumerate([first, *keys]):
        parts = dict(enumerate(value)) if isinstance(value, list) else value
        named = parts.items() if isinstance(parts, dict) else ()
        known: dict[str, Any] = {str(one): part for one, part in named}
        if key not in known:
            near = difflib.get_close_matches(key, known, _N_NEAR, 0.5) or sorted(known)[:_N_NEAR]
            before = ".".join([first, *keys][:place])
            raise UsageError(
                f"--require {name}: expected a figure of summary.json, found no {quoted(key)} in "
                f"{before or 'it'}; near are {', '.join(near) or 'none'}."
            )
        value = known[key]
    return section, value


def _holds(value: Any, sign: str, word: str, text: str) -> bool:
    """Whether a value compares with a number or word; UsageError for another kind of value."""
    try:
        limit: Any = float(word)
    except ValueError:
        limit = _WORDS.get(word.lower(), word.strip("'\""))
    is_ordered = isinstance(value, int | float) and isinstance(limit, int | float)
    if not is_ordered and (sign not in ("==", "!=") or isinstance(value, list | dict)):
        raise UsageError(
            f"--require {quoted(text)}: expected a number on both sides, found {quoted(value)} and "
            f"{quoted(word)}."
        )
    return _COMPARE[sign](value, limit)


def _junit(rows: Sequence[Mapping[str, Any]]) -> str:
    """A test suite per run and a test case per limit, as CI servers read them."""
    root = ElementTree.Element("testsuites")
    for run in dict.fromkeys(row["run"] for row in rows):
        listed_rows = [row for row in rows if row["run"] == run]
        counts = {
            "tests": len(listed_rows),
            "failures": sum(not row["holds"] for row in listed_rows),
        }
        suite = ElementTree.SubElement(
            root, "testsuite", {"name": run, **{key: str(n) for key, n in counts.items()}}
        )
        for row in listed_rows:
            case = ElementTree.SubElement(
                suite, "testcase", {"name": row["limit"], "classname": "track-range check"}
            )
            if not row["holds"]:
                ElementTree.SubElement(case, "failure", {"message": row["sentence"]})
    for element in root.iter():
        for key, text in element.items():
            element.set(key, _NO_XML.sub("?", text))
    ElementTree.indent(root)
    return ElementTree.tostring(root, encoding="unicode", xml_declaration=True) + "\n"

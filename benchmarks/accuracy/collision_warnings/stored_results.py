"""Results of a benchmark by case, in a file of JSON lines: an interrupted benchmark continues where it ended."""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import track_range

PROGRESS_S = 20.0
"""Time between two lines of progress, s."""


class StoredResults:
    """The results in a file; those of another version of the source code are ignored."""

    def __init__(self, path: Path | None) -> None:
        """Read a file, which need not exist; None = nothing is stored."""
        self._path = path
        self._results: dict[str, Any] = {}
        if path is not None and path.exists():
            for line in path.read_text(encoding="utf-8").splitlines():
                try:
                    stored = json.loads(line)
                except json.JSONDecodeError:  # the last line of an interrupted benchmark
                    continue
                if stored["version"] == source_version():
                    self._results[stored["case"]] = stored["result"]

    def mapped(
        self, label: str, function: Callable[[Any], dict[str, Any]], cases: Sequence[Any], n_jobs: int
    ) -> Iterator[dict[str, Any]]:
        """Yield the result of the function for each case, in order, as JSON values; prints the progress.

        Args:
            label: name of the results, which with the case identifies each.
            function: returns a dictionary of JSON values and numpy arrays, in another process if there are several.
            cases: its arguments.
            n_jobs: number of processes.
        """
        keys = [f"{label} {case}" for case in cases]
        missing = [case for case, key in zip(cases, keys, strict=True) if key not in self._results]
        start_s = last_s = time.monotonic()
        n_done = 0
        with ProcessPoolExecutor(n_jobs) as pool:
            results = iter(pool.map(function, missing) if n_jobs > 1 else map(function, missing))
            for key in keys:
                if key not in self._results:
                    self._add(key, next(results))
                    n_done += 1
                    now_s = time.monotonic()
                    if now_s - last_s > PROGRESS_S or n_done == len(missing):
                        last_s, left_s = now_s, (now_s - start_s) / n_done * (len(missing) - n_done)
                        print(
                            f"{label}: {n_done} of {len(missing)}, {left_s / 60:.1f} min left",
                            file=sys.stderr,
                            flush=True,
                        )
                yield self._results[key]

    def _add(self, key: str, result: dict[str, Any]) -> None:
        line = json.dumps({"version": source_version(), "case": key, "result": result}, default=_json_value)
        self._results[key] = json.loads(line)["result"]
        if self._path is not None:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            with self._path.open("a", encoding="utf-8") as file:
                file.write(line + "\n")


@cache
def source_version() -> str:
    """Digest of the package's source code."""
    root = Path(track_range.__file__).parent
    digest = hashlib.sha256()
    for path in sorted(root.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _json_value(value: Any) -> Any:
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    raise TypeError(f"{type(value).__name__} is no JSON value")

"""Attempts: whether a clip is repeated after its worker died, hung, or took too much memory.

failure                              attempts in all
input (application error)            1
network while fetching               2
over the limit of time or memory     2
worker died                          2; 4 if workers died with other clips too, since the machine is then the cause
node lost                            not counted
"""

from __future__ import annotations

from collections import defaultdict
from typing import Literal

ErrorKind = Literal["", "input", "crash", "memory", "timeout", "fetch", "internal"]
"""Kind of a failure; "" = none."""

_REPEATED: tuple[ErrorKind, ...] = ("crash", "memory", "timeout", "fetch")

_N_ATTEMPTS, _N_ATTEMPTS_ELSEWHERE = 2, 4
"""Attempts for a clip, and those if workers died with other clips as well."""


class Attempts:
    """Failed attempts of the clips of a fleet."""

    def __init__(self) -> None:
        self._failures: dict[str, list[tuple[ErrorKind, str]]] = defaultdict(list)
        self._crashed: set[str] = set()

    def add(self, clip: str, kind: ErrorKind, node: str = "") -> None:
        """Count a failed attempt.

        Args:
            clip: name of the clip.
            kind: kind of the failure.
            node: id of the node that the worker was on.
        """
        self._failures[clip].append((kind, node))
        if kind == "crash":
            self._crashed.add(clip)

    def forget_node(self, node: str) -> None:
        """Take back the attempts that a lost node ended."""
        for clip, failures in list(self._failures.items()):
            left = [(kind, on) for kind, on in failures if on != node or kind != "crash"]
            self._failures[clip] = left
            if not any(kind == "crash" for kind, _ in left):
                self._crashed.discard(clip)

    def n_failed(self, clip: str) -> int:
        """Number of failed attempts."""
        return len(self._failures.get(clip, ()))

    def number(self, clip: str) -> int:
        """Number of the next attempt, from 1."""
        return self.n_failed(clip) + 1

    def is_repeated(self, clip: str) -> bool:
        """Whether the clip is attempted again after its last failure."""
        failures = self._failures.get(clip, [])
        if not failures:
            return True
        kinds = {kind for kind, _ in failures}
        if not kinds <= set(_REPEATED):
            return False
        is_elsewhere = kinds == {"crash"} and bool(self._crashed - {clip})
        return len(failures) < (_N_ATTEMPTS_ELSEWHERE if is_elsewhere else _N_ATTEMPTS)

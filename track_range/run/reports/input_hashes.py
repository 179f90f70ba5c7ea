"""Hashes of the files that a run reads, so that its results can be traced to their content.

Files up to 16 MiB are hashed before the first frame, and samples of larger ones; `settings_hash`
covers these. The SHA-256 of larger files, up to 1 GiB, follows in a thread of low priority beside
the run.
"""

import threading
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path
from typing import Any

from track_range.foundation.files.content_hashes import ContentHash, content_hash
from track_range.foundation.installed import commit_of_package
from track_range.foundation.prefetch import lower_thread_priority
from track_range.run.reports.report import Reports

_WHOLE_BYTES = 1 << 30  # 2 s of processor time; a recording of this size takes minutes to process
_MOST_LISTED = 16  # files of a recording that have a hash each; more have one in common


class InputHashes(Reports):
    """Hashes of files by role (recordings, calibration, labels), and of the detector, whose hash is
    known, by its description.
    """

    def __init__(self, files: Mapping[str, list[Path]], detector: Mapping[str, Any]) -> None:
        groups = [(role, group) for role, paths in files.items() for group in _groups(paths)]
        self._detector = detector
        quick = [(role, group, content_hash(group)) for role, group in groups]
        self._read = [
            (role, group, content) for role, group, content in quick if content is not None
        ]
        self._commit = ""
        self._thread = threading.Thread(target=self._read_whole, name="hashes", daemon=True)
        # before the thread replaces hashes of samples
        self.hashes = self._by_role()
        self._thread.start()

    def summary(self) -> Mapping[str, Any]:
        """Section `provenance`: version, commit, and the files with their hashes."""
        self._thread.join()
        files = [{"role": role, **_entry(group, content)} for role, group, content in self._read]
        if "sha256" in self._detector:
            names = {key: self._detector[key] for key in ("file", "sha256")}
            files.append({"role": "detector", "name": names["file"], "sha256": names["sha256"]})
        head = {"version": version("track-range"), "commit": self._commit or None}
        return {"provenance": {**head, "files": files}}

    def _by_role(self) -> dict[str, list[str]]:
        """Hashes by role; of large files those of samples."""
        hashes: dict[str, list[str]] = {}
        for role, _, content in self._read:
            hashes.setdefault(role, []).append(content.sha256)
        if "sha256" in self._detector:
            hashes["detector"] = [self._detector["sha256"]]
        return hashes

    def _read_whole(self) -> None:
        lower_thread_priority()
        for index, (role, group, content) in enumerate(self._read):
            if content.is_sampled and content.n_bytes <= _WHOLE_BYTES:
                whole = content_hash(group, _WHOLE_BYTES)
                self._read[index] = (role, group, content if whole is None else whole)
        self._commit = commit_of_package(Path(__file__).parent, "track-range")


def _groups(files: list[Path]) -> list[list[Path]]:
    """The files that have a hash each, or all of them."""
    return [[file] for file in files] if len(files) <= _MOST_LISTED else [files]


def _entry(group: list[Path], content: ContentHash) -> dict[str, Any]:
    counts = {"files": content.n_files} if content.n_files > 1 else {}
    kind = "sha256_of_samples" if content.is_sampled else "sha256"
    name = {"name": group[0].name}
    return {**name, **counts, "bytes": content.n_bytes, kind: content.sha256}

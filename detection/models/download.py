"""Fetching a catalogue model: resumed where it broke off, checked against its published checksum, whole or not at all.

A download grows as NAME.part in the cache folder and gets its name only when its checksum is right, so a file of the
right name is a good one, however the program ended, and two programs at once cannot make a bad one.
"""

from __future__ import annotations

import hashlib
import http.client
import os
import urllib.error
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any
from urllib.parse import urlparse

from track_range.detection.darknet.importer import import_darknet
from track_range.detection.models.catalogue import CatalogueEntry, ModelFile
from track_range.foundation.errors import UserError

Progress = Callable[[int, int | None], None]
"""Called with the bytes there so far, and all that are to come where the server says so."""

_CHUNK_BYTES = 1 << 18
_TIMEOUT_S = 30.0
_RANGE_NOT_SATISFIABLE = 416
_PARTIAL_CONTENT = 206


class DownloadError(UserError):
    """A model that cannot be fetched; the message says why, and where to put the file if it is fetched otherwise."""


def pull(entry: CatalogueEntry, cache: Path, progress: Progress | None = None) -> Path:
    """The entry's ONNX file in the cache folder, fetched and converted unless it is there already.

    Raises:
        DownloadError: it cannot be fetched or kept.
        ModelError: Darknet files that cannot be imported.
    """
    model = cache / f"{entry.name}.onnx"
    if model.is_file() and (entry.is_darknet or _is_right(model, entry.files[0].checksum)):
        return model
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DownloadError(
            f"{cache}: no models can be kept there ({error.strerror}); set TRACK_RANGE_CACHE to another folder."
        ) from error
    paths = {Path(file.name).suffix: fetch(file, cache / file.name, progress) for file in entry.files}
    if entry.is_darknet:
        import_darknet(paths[".cfg"], paths[".weights"], model, names=entry.classes)
        paths[".weights"].unlink()
    return model


def fetch(file: ModelFile, target: Path, progress: Progress | None = None) -> Path:
    """One file under its name, unless it is there already and its checksum right; an earlier part is resumed.

    Raises:
        DownloadError: it cannot be fetched, is not what was published, or cannot be written.
    """
    if target.is_file() and _is_right(target, file.checksum):
        return target
    if urlparse(file.url).scheme not in ("http", "https"):
        raise DownloadError(f"{file.url}: only http and https addresses are fetched.")
    part = target.with_name(target.name + ".part")
    otherwise = f"Try again later (what came is kept), or fetch it by other means and put it as {target}."
    try:
        _append(file.url, part, progress or _unheard)
    except urllib.error.HTTPError as error:
        raise DownloadError(f"{file.url}: the server answers {error.code} {error.reason}. {otherwise}") from error
    except urllib.error.URLError as error:
        raise DownloadError(f"{file.url}: cannot be reached ({error.reason}). {otherwise}") from error
    except (http.client.HTTPException, ConnectionError, TimeoutError) as error:
        reason = str(error) or type(error).__name__
        raise DownloadError(f"{file.url}: the connection broke off ({reason}). {otherwise}") from error
    except OSError as error:
        raise DownloadError(f"{part}: cannot be written ({error.strerror or error}).") from error
    found = _digest(part, file.checksum)
    if found != file.checksum:
        part.unlink()
        raise DownloadError(
            f"{file.url}: what came is not the published file (checksum {found}, {file.checksum} wanted) and was "
            f"removed; try again, or put the right file as {target}."
        )
    os.replace(part, target)
    return target


def _unheard(done_bytes: int, total_bytes: int | None) -> None:
    """Progress that nobody wants."""


def _append(url: str, part: Path, progress: Progress) -> None:
    """Add to `part` what is missing of it; begin anew where the server does not resume."""
    there = part.stat().st_size if part.is_file() else 0
    request = urllib.request.Request(url, headers={"User-Agent": "track-range"})  # noqa: S310 (http or https: checked)
    if there:
        request.add_header("Range", f"bytes={there}-")
    try:
        answer = urllib.request.urlopen(request, timeout=_TIMEOUT_S)  # noqa: S310 (as above)
    except urllib.error.HTTPError as error:
        if error.code != _RANGE_NOT_SATISFIABLE or not there:
            raise
        error.close()
        return  # it is all there: the checksum tells
    with answer:
        is_rest = answer.status == _PARTIAL_CONTENT
        done = there if is_rest else 0
        length = answer.headers.get("Content-Length")
        total = done + int(length) if length else None
        with part.open("ab" if is_rest else "wb") as file:
            _copy(answer, file, done, total, progress)


def _copy(answer: Any, file: Any, done: int, total: int | None, progress: Progress) -> None:
    while chunk := answer.read(_CHUNK_BYTES):
        file.write(chunk)
        done += len(chunk)
        progress(done, total)
    if total is not None and done < total:
        raise http.client.HTTPException(f"{done} of {total} bytes came")


def _is_right(path: Path, checksum: str) -> bool:
    with suppress(OSError):
        return _digest(path, checksum) == checksum
    return False


def _digest(path: Path, checksum: str) -> str:
    """The file's checksum in the algorithm of `checksum`, such as `sha256:...`."""
    algorithm = checksum.partition(":")[0]
    with path.open("rb") as file:
        return f"{algorithm}:{hashlib.file_digest(file, algorithm).hexdigest()}"

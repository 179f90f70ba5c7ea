"""Download of a catalogue model: resumed after an interruption and verified with its published
checksum.

A download is written to NAME.part in the cache folder and renamed to NAME once its checksum is
correct. A file NAME is therefore always complete, even if the program was killed or two programs
download the same file at once.
"""

import hashlib
import http.client
import os
import urllib.error
import urllib.request
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from urllib.parse import urlparse

from track_range.detection.catalogue.darknet.importer import import_darknet
from track_range.detection.catalogue.entries import CatalogueEntry, ModelFile
from track_range.foundation.errors import UserError
from track_range.foundation.files.atomic_files import writable, write_text
from track_range.foundation.files.input_files import shortened

Progress = Callable[[int, int | None], None]  # (bytes so far, total if the server reports it)
_CHUNK_BYTES = 1 << 18
_MAX_UNPUBLISHED_BYTES = 1_000_000  # files of unpublished size are text of a few kB
_TIMEOUT_S = 30.0
# HTTP status: the requested range starts at or after the end of the file
_RANGE_NOT_SATISFIABLE = 416
_PARTIAL_CONTENT = 206  # HTTP status: the answer contains only the requested range


class DownloadError(UserError):
    """Failed download of a model; the message gives the reason, and where to put a file downloaded
    by other means.
    """


def pull(entry: CatalogueEntry, cache: Path, progress: Progress | None = None) -> Path:
    """Path of the entry's ONNX file in the cache folder, downloaded and converted if it is not
    there yet.

    The size of an input of variable size is written to `NAME.yaml` beside it
    (`detection.yolo.metadata`). DownloadError: the download failed, or the cache folder cannot be
    written.
    """
    model = cache / f"{entry.name}.onnx"
    if model.is_file() and (entry.is_darknet or _has_checksum(model, entry.files[0].checksum)):
        return model
    try:
        cache.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DownloadError(
            f"{cache}: cannot create this folder ({error.strerror}); set TRACK_RANGE_CACHE to "
            "another folder."
        ) from error
    sidecar = cache / f"{entry.name}.yaml"
    # else the user has attributes for this model
    if entry.size_px is not None and not sidecar.exists():
        with writable(sidecar, DownloadError):
            write_text(sidecar, f"size: {entry.size_px}\n")
    paths = {
        Path(file.name).suffix: fetch(file, cache / file.name, progress) for file in entry.files
    }
    if entry.is_darknet:
        import_darknet(paths[".cfg"], paths[".weights"], model, names=entry.classes)
        paths[".weights"].unlink()
    return model


def fetch(file: ModelFile, target: Path, progress: Progress | None = None) -> Path:
    """Download one file to `target` and return that path; an earlier partial download is resumed.

    Nothing is downloaded if `target` exists and has the correct checksum. DownloadError if the file
    cannot be downloaded or written, or its checksum is wrong.
    """
    if target.is_file() and _has_checksum(target, file.checksum):
        return target
    if urlparse(file.url).scheme not in ("http", "https"):
        raise DownloadError(f"{file.url}: expected an http or https address.")
    part = target.with_name(target.name + ".part")
    advice = f"try again later to resume the download, or save the file as {target} by other means."
    try:
        _append(file, part, progress or (lambda done_bytes, total_bytes: None))
    except urllib.error.HTTPError as error:
        raise DownloadError(
            f"{file.url}: the server responded {error.code} {shortened(str(error.reason))}; "
            f"{advice}"
        ) from error
    except urllib.error.URLError as error:
        raise DownloadError(
            f"{file.url}: cannot connect ({shortened(str(error.reason))}); {advice}"
        ) from error
    except (http.client.HTTPException, ConnectionError, TimeoutError) as error:
        reason = shortened(str(error) or type(error).__name__)
        raise DownloadError(f"{file.url}: connection lost ({reason}); {advice}") from error
    except OSError as error:
        raise DownloadError(f"{part}: cannot be written ({error.strerror or error}).") from error
    checksum = _digest(part, file.checksum)
    if checksum != file.checksum:
        part.unlink()
        raise DownloadError(
            f"{file.url}: expected checksum {file.checksum}, got {checksum}; the download was "
            f"removed: try again, or save the correct file as {target}."
        )
    os.replace(part, target)
    return target


def _append(model_file: ModelFile, part: Path, progress: Progress) -> None:
    """Append the missing bytes to `part`; restart the download if the server cannot resume it.

    If there are more bytes than published, some are left out: the checksum is wrong in any case.
    """
    present_bytes = part.stat().st_size if part.is_file() else 0
    request = urllib.request.Request(model_file.url, headers={"User-Agent": "track-range"})  # noqa: S310 (http or https: checked)
    if present_bytes:
        request.add_header("Range", f"bytes={present_bytes}-")
    try:
        response = urllib.request.urlopen(request, timeout=_TIMEOUT_S)  # noqa: S310 (as above)
    except urllib.error.HTTPError as error:
        if error.code != _RANGE_NOT_SATISFIABLE or not present_bytes:
            raise
        error.close()
        return  # `part` has all bytes; its checksum is verified by the caller
    with response:
        is_resumed = response.status == _PARTIAL_CONTENT
        done_bytes = present_bytes if is_resumed else 0
        length = response.headers.get("Content-Length") or ""
        total_bytes = done_bytes + int(length) if length.isascii() and length.isdecimal() else None
        max_bytes = max(model_file.size_bytes or 0, _MAX_UNPUBLISHED_BYTES)
        with part.open("ab" if is_resumed else "wb") as file:
            while chunk := response.read(_CHUNK_BYTES):
                if done_bytes > max_bytes:
                    return
                file.write(chunk)
                done_bytes += len(chunk)
                progress(done_bytes, total_bytes)
    if total_bytes is not None and done_bytes < total_bytes:
        raise http.client.HTTPException(f"received {done_bytes} of {total_bytes} bytes")


def _has_checksum(path: Path, checksum: str) -> bool:
    with suppress(OSError):
        return _digest(path, checksum) == checksum
    return False


def _digest(path: Path, checksum: str) -> str:
    algorithm = checksum.partition(":")[0]
    with path.open("rb") as file:
        return f"{algorithm}:{hashlib.file_digest(file, algorithm).hexdigest()}"

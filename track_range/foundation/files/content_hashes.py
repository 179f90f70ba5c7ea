"""Hashes of the content of input files, so that results can be traced to them."""

import hashlib
import stat
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

# parts of the content that stand for files that are too large to be read whole
N_SAMPLES, SAMPLE_BYTES = 64, 1 << 18


@dataclass(frozen=True, slots=True)
class ContentHash:
    """SHA-256 of the content of one or several files.

    Of one file that was read whole, it is the plain SHA-256, as `sha256sum` prints it. Otherwise the
    hash is of a line `SIZE NAME` per file, followed by the content of the files in the order of
    their names: all of it, or with `is_sampled` 64 parts of 256 KiB at equal distances, the first
    and last one included.
    """

    n_files: int
    n_bytes: int
    sha256: str  # hexadecimal
    is_sampled: bool


def content_hash(paths: Sequence[Path], whole_bytes: int = 0) -> ContentHash | None:
    """Hash of the regular files among `paths`, and directly in the folders among them; None = there
    is none, or one cannot be read.

    More than `whole_bytes`, or 16 MiB, are not read whole.
    """
    try:
        files = sorted(
            (file for path in paths for file in (path.iterdir() if path.is_dir() else (path,))),
            key=lambda file: file.name,
        )
        states = {file: file.stat() for file in files}
        sizes = {
            file: state.st_size for file, state in states.items() if stat.S_ISREG(state.st_mode)
        }
        return _hashed(sizes, whole_bytes) if sizes else None
    except (OSError, ValueError):  # ValueError: a name that is no path
        return None


def _hashed(sizes: Mapping[Path, int], whole_bytes: int) -> ContentHash:
    n_bytes = sum(sizes.values())
    is_sampled = n_bytes > max(whole_bytes, N_SAMPLES * SAMPLE_BYTES)
    digest = hashlib.sha256()
    if is_sampled or len(sizes) > 1:
        for file, size in sizes.items():
            digest.update(f"{size} {file.name}\n".encode("utf-8", "surrogateescape"))
    parts: Iterable[tuple[Path, int, int]] = ((file, 0, size) for file, size in sizes.items())
    for file, offset, length in _samples(sizes, n_bytes) if is_sampled else parts:
        with file.open("rb") as content:
            content.seek(offset)
            left = length
            while left > 0 and (data := content.read(min(left, SAMPLE_BYTES))):
                digest.update(data)
                left -= len(data)
    return ContentHash(len(sizes), n_bytes, digest.hexdigest(), is_sampled)


def _samples(sizes: Mapping[Path, int], n_bytes: int) -> Iterator[tuple[Path, int, int]]:
    """File, offset and length of each sample of files one after another; a sample ends with its
    file.
    """
    starts = [k * (n_bytes - SAMPLE_BYTES) // (N_SAMPLES - 1) for k in range(N_SAMPLES)]
    end = 0
    for file, size in sizes.items():
        begin, end = end, end + size
        while starts and starts[0] < end:
            offset = starts.pop(0) - begin
            yield file, offset, min(SAMPLE_BYTES, size - offset)

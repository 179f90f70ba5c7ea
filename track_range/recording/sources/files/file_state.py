"""FileState: detects that a video file was replaced, shortened or overwritten while it was read."""

from __future__ import annotations

import hashlib
import os
from dataclasses import dataclass
from pathlib import Path

from track_range.foundation.files.input_files import open_regular, readable
from track_range.recording.video.frame import VideoError

# samples by which contents are compared if the time of change differs
_N_SAMPLES, _SAMPLE_BYTES = 16, 4096
_DIGEST_BYTES = 16  # size of the digest of a sample, bytes; recordings may have thousands of files


@dataclass(frozen=True, slots=True)
class FileState:
    """Size, time of change, and digests of parts of a file's content at regular distances, at one
    moment.
    """

    n_bytes: int
    modified_ns: int
    samples: tuple[bytes, ...]

    @classmethod
    def of(cls, path: Path, n_bytes: int | None = None) -> FileState:
        """The state of a file, with samples at the offsets for a size of `n_bytes`; VideoError if
        it cannot be read.
        """
        with open_regular(path, VideoError, "a video file or a folder of numbered images") as file:
            status = os.fstat(file.fileno())
            step = (status.st_size if n_bytes is None else n_bytes) / _N_SAMPLES
            samples = []
            with readable(path, VideoError):
                for number in range(_N_SAMPLES):
                    file.seek(int(number * step))
                    sample = file.read(min(_SAMPLE_BYTES, max(1, int(step))))
                    samples.append(hashlib.blake2b(sample, digest_size=_DIGEST_BYTES).digest())
        return cls(status.st_size, status.st_mtime_ns, tuple(samples))

    def check_unchanged(self, path: Path) -> None:
        """Raise a VideoError if the file with this path was replaced, shortened or overwritten.

        A file that was deleted, or has grown while its beginning stayed the same, counts as
        unchanged.
        """
        try:
            status = path.stat()
        except OSError:
            return
        if (status.st_size, status.st_mtime_ns) == (self.n_bytes, self.modified_ns):
            return
        try:
            present = FileState.of(path, self.n_bytes)
            n_different = sum(a != b for a, b in zip(self.samples, present.samples, strict=True))
            # a recorder that ends meanwhile may write the header again
            is_other = n_different > (_N_SAMPLES // 4 if present.n_bytes > self.n_bytes else 0)
            change = "replaced or overwritten" if is_other else ""
        except VideoError:
            change = "replaced"
        if status.st_size < self.n_bytes:
            change = f"shortened from {self.n_bytes} to {status.st_size} bytes"
        if change:
            raise VideoError(
                f"{path}: the file was {change} while it was read; repeat the run "
                "with the complete file."
            )

    def has_grown(self, path: Path) -> bool:
        """Whether the file with this path is larger than before."""
        try:
            return path.stat().st_size > self.n_bytes
        except OSError:
            return False

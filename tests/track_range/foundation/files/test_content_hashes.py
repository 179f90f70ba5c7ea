"""Hashes of the content of files, read whole or by samples."""

import hashlib
import os
from pathlib import Path

from track_range.foundation.files.content_hashes import N_SAMPLES, SAMPLE_BYTES, content_hash
from track_range.foundation.installed import commit_of_package

LARGE_BYTES = N_SAMPLES * SAMPLE_BYTES + 1000


def test_one_file_has_its_plain_sha256(tmp_path: Path) -> None:
    file = tmp_path / "a.txt"
    file.write_bytes(b"abc")
    found = content_hash([file])
    assert found is not None
    assert not found.is_sampled
    assert (found.n_files, found.n_bytes) == (1, 3)
    assert found.sha256 == hashlib.sha256(b"abc").hexdigest()


def test_samples_show_changes_of_size_begin_and_end_but_not_of_every_byte(tmp_path: Path) -> None:
    content = bytearray(os.urandom(1000) * (LARGE_BYTES // 1000 + 1))[:LARGE_BYTES]
    file = tmp_path / "video.mp4"

    def hashed(whole_bytes: int = 0, **changed: int) -> tuple[str, bool]:
        data = bytearray(content)
        for place in changed.values():
            data[place] ^= 1
        file.write_bytes(data)
        found = content_hash([file], whole_bytes)
        assert found is not None
        return found.sha256, found.is_sampled

    first, is_sampled = hashed()
    assert is_sampled
    between = SAMPLE_BYTES + 5  # sample 1 begins 15 bytes after sample 0 ends
    assert hashed(at=between)[0] == first
    assert first not in (hashed(at=0)[0], hashed(at=LARGE_BYTES - 1)[0])
    content.append(0)
    assert hashed()[0] != first
    whole, is_sampled = hashed(LARGE_BYTES + 1)
    assert not is_sampled
    assert whole == hashlib.sha256(content).hexdigest()
    assert hashed(LARGE_BYTES + 1, at=between)[0] != whole


def test_samples_go_across_the_files_of_a_folder(tmp_path: Path) -> None:
    names = [f"{k:03}.png" for k in range(40)]
    for name in names:
        (tmp_path / name).write_bytes(os.urandom(LARGE_BYTES // 20))
    (tmp_path / "folder").mkdir()
    found = content_hash([tmp_path])
    assert found is not None
    assert found.is_sampled
    assert (found.n_files, found.n_bytes) == (40, 40 * (LARGE_BYTES // 20))
    assert found == content_hash([tmp_path / name for name in reversed(names)])
    (tmp_path / names[-1]).rename(tmp_path / "zzz.png")
    renamed = content_hash([tmp_path])
    assert renamed is not None
    assert renamed.sha256 != found.sha256


def test_what_is_no_file_has_no_hash(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    assert content_hash([tmp_path / "pipe"]) is None
    assert content_hash([tmp_path / "missing.mp4"]) is None
    assert content_hash([Path("\0")]) is None


def test_only_a_package_of_a_checkout_has_a_commit(tmp_path: Path) -> None:
    assert commit_of_package(tmp_path, "no-such-distribution") == ""

"""Files on this machine, in an S3 store and on a web server: real servers on the loopback
interface."""

import errno
import os
import pickle
import re
import socket
import time
from pathlib import Path

import pytest

from track_range.fleet.storage.errors import StorageError, fault_of, reason_of, storage_error
from track_range.fleet.storage.location import FolderListings, Location, shown

NAMES = ["a b.bin", "ü=%41?#+&.gz", "..x", "-", "a\\b", "x" * 200]


@pytest.fixture(params=["local", "s3"])
def folder(request, tmp_path):
    """An empty folder of each kind of storage that can be written to."""
    if request.param == "local":
        return Location.of(tmp_path)
    return request.getfixturevalue("bucket").child("a folder")


def kind_of(error):
    assert len(str(error.value)) < 300 + 100
    return error.value.kind


def test_write_read_list_remove(folder, tmp_path_factory):
    local = tmp_path_factory.mktemp("local") / "file"
    for name in NAMES:
        file = folder.child("sub", name)
        assert file.stat() is None
        file.write_bytes(b"first" + name.encode())
        file.write_bytes(name.encode())
        assert file.read_bytes() == name.encode()
        assert file.stat().size == len(name.encode())
        assert abs(file.stat().mtime_ns / 1e9 - time.time()) < 100
        assert Location.of(file.address) == file == pickle.loads(pickle.dumps(file))  # noqa: S301
        assert (file.name, file.parent) == (name, folder.child("sub"))
        assert file.download(local) == len(name.encode())
        assert local.read_bytes() == name.encode()
    assert sorted(entry.name for entry in folder.child("sub").list()) == sorted(NAMES)
    listed = {entry.name: entry.stat.is_folder for entry in folder.list(recursive=True)}
    assert listed == {"sub": True, **{f"sub/{name}": False for name in NAMES}}
    assert folder.child("sub").stat().is_folder
    assert FolderListings().state(folder.child("sub")).size == sum(
        len(name.encode()) for name in NAMES if name[0] != "."
    )
    folder.child("sub", "-").remove()
    folder.child("sub", "-").remove()
    assert not folder.child("sub", "-").exists()


def test_upload_of_a_large_file(folder, tmp_path_factory):
    local, copy = (tmp_path_factory.mktemp("local") / name for name in ("file", "copy"))
    local.write_bytes(bytes(range(256)) * 40_000)
    folder.child("large").upload(local)
    folder.child("large").download(copy)
    assert copy.read_bytes() == local.read_bytes()
    for read in (
        lambda: folder.child("large").download(copy, 1000),
        lambda: folder.child("large").read_bytes(1000),
    ):
        with pytest.raises(StorageError, match="at most"):
            read()


def test_upload_that_fails_leaves_no_file(bucket, tmp_path):
    (tmp_path / "folder").mkdir()
    for name in ("none", "folder"):
        with pytest.raises(StorageError):
            bucket.child("x").upload(tmp_path / name)
    assert not bucket.child("x").exists()


def test_missing_files(folder):
    for read in (folder.child("none").read_bytes, lambda: list(folder.child("none").list())):
        with pytest.raises(StorageError, match="none") as error:
            read()
        assert kind_of(error) == "missing"
    with pytest.raises(StorageError) as error:
        folder.child("none").download(Path("/dev/null"))
    assert kind_of(error) == "missing"


def test_missing_bucket_is_not_created(s3):
    nowhere = Location.of("s3://no-such-bucket/x")
    assert nowhere.stat() is None
    with pytest.raises(StorageError, match="no-such-bucket") as error:
        nowhere.write_bytes(b"x")
    assert kind_of(error) == "missing"
    assert nowhere.parent.stat() is None


def test_wrong_credentials(bucket, s3_endpoint):
    import urllib.request

    def require_credentials(after: str) -> None:
        request = urllib.request.Request(f"{s3_endpoint}/moto-api/reset-auth", after.encode())  # noqa: S310
        request.add_header("Content-Type", "text/plain")
        urllib.request.urlopen(request).close()  # noqa: S310

    bucket.child("x").write_bytes(b"x")
    require_credentials("0")
    try:
        for act in (
            bucket.child("x").stat,
            bucket.child("x").read_bytes,
            lambda: bucket.child("x").write_bytes(b""),
        ):
            with pytest.raises(StorageError, match="credentials") as error:
                act()
            assert kind_of(error) == "permission"
            assert "secret" not in str(error.value)
        with pytest.raises(StorageError) as error:
            list(bucket.list())
        assert kind_of(error) == "permission"
    finally:
        require_credentials("1000000000")


@pytest.mark.slow
def test_server_that_refuses_or_is_silent(s3, monkeypatch):
    with socket.socket() as silent:
        silent.bind(("127.0.0.1", 0))
        silent.listen(5)
        for port in (9, silent.getsockname()[1]):
            location = Location.of(f"s3://bucket/x?endpoint_override=127.0.0.1:{port}&scheme=http")
            monkeypatch.delenv("AWS_ENDPOINT_URL", raising=False)
            monkeypatch.setattr("track_range.fleet.storage.file_systems.REQUEST_TIMEOUT_S", 2.0)
            start_s = time.monotonic()
            with pytest.raises(StorageError, match="connection") as error:
                location.stat()
            assert kind_of(error) == "network"
            assert error.value.is_transient
            assert time.monotonic() - start_s < 60


def test_local_faults(tmp_path):
    (tmp_path / "file").write_bytes(b"x")
    with pytest.raises(StorageError) as error:
        Location.of(tmp_path / "file" / "below").write_bytes(b"x")
    assert kind_of(error) in ("missing", "other")
    with pytest.raises(StorageError, match="folder"):
        Location.of(tmp_path).read_bytes()
    with pytest.raises(StorageError) as error:
        list(Location.of(tmp_path / "file").list())
    assert kind_of(error) == "missing"
    assert Location.of(tmp_path / "file" / "below").stat() is None


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="no device that is always full")
def test_full_disk():
    with pytest.raises(StorageError) as error:
        Location.of("/dev/full").write_bytes(b"x")
    assert kind_of(error) == "full"


@pytest.mark.skipif(
    not hasattr(os, "geteuid") or os.geteuid() == 0, reason="root may read all files"
)
def test_no_permission(tmp_path):
    (tmp_path / "closed").mkdir(mode=0)
    with pytest.raises(StorageError) as error:
        list(Location.of(tmp_path / "closed").list())
    assert kind_of(error) == "permission"


@pytest.mark.parametrize(
    ("error", "kind"),
    [
        (OSError(errno.ENOSPC, "No space left on device"), "full"),
        (OSError(errno.EACCES, "Permission denied"), "permission"),
        (OSError(errno.EIO, "Input/output error"), "network"),
        (OSError("AWS Error SLOW_DOWN during PutObject operation: Please reduce your request rate"), "network"),
        (OSError("When uploading 'status 403': AWS Error UNKNOWN (HTTP status 507) during X operation: "), "full"),
        (OSError("google::cloud::Status(PERMISSION_DENIED: no access)"), "permission"),
        (OSError("google::cloud::Status(NOT_FOUND: no bucket)"), "missing"),
        (OSError("google::cloud::Status(UNAVAILABLE: try later)"), "network"),
        (ValueError("Invalid path"), "other"),
    ],
)  # fmt: skip
def test_kinds_of_errors(error, kind):
    assert fault_of(error) == kind
    assert storage_error("s3://bucket/x", "read", error).kind == kind


def test_credentials_are_not_shown():
    text = "AWS Error UNKNOWN during GetObject operation: secret_key=abc123, X-Amz-Signature=xyz789"
    assert not re.search("abc123|xyz789", reason_of(OSError(text)))
    assert "secret" not in shown("https://user:secret@host/a.mp4?X-Amz-Signature=secret")
    assert shown("https://user:secret@host/a.mp4").endswith("://host/a.mp4")
    for address in ("s3://key:secret@bucket/x", "gs://key:secret@bucket/x"):
        with pytest.raises(StorageError, match="environment") as error:
            Location.of(address)
        assert "secret" not in str(error.value)


@pytest.mark.parametrize("address", ["", "s3://", "s3:///key", "s3://../x", "ftp://host/x", "a\0b"])
def test_invalid_addresses(address):
    with pytest.raises(StorageError):
        Location.of(address)


def test_addresses(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert Location.of("a/../b").path == tmp_path / "b"
    assert Location.of(f"file://{tmp_path}/x").path == tmp_path / "x"
    assert Location.of("/").parent is None
    assert Location.of("s3://bucket").parent is None
    location = Location.of("s3://bucket/a?region=eu-west-1&scheme=http")
    assert location.child("b c").address == "s3://bucket/a/b c?region=eu-west-1&scheme=http"
    assert Location.of("s3://bucket/a?b=c").name == "a?b=c"
    assert Location.of("https://host/a%20b.mp4?sig=1").name == "a b.mp4"
    with pytest.raises(StorageError, match="machine"):
        _ = location.path


def test_pyarrow_file_system(folder):
    import pyarrow as pa
    import pyarrow.dataset as ds
    import pyarrow.parquet as pq

    files, path = folder.arrow()
    folder.child("clip=a", "x").write_bytes(b"")
    folder.child("clip=a", "x").remove()
    pq.write_table(pa.table({"n": [1, 2]}), f"{path}/clip=a/t.parquet", filesystem=files)
    assert ds.dataset(path, filesystem=files, partitioning="hive").to_table().num_rows == 2


def test_folder_listings(folder):
    folder.child("sub", "a").write_bytes(b"abc")
    listings = FolderListings()
    for name, size in (("sub/a", 3), ("sub/none", None), ("none/a", None)):
        status = listings.stat(folder.child(name))
        assert (None if status is None else status.size) == size
    assert listings.state(folder.child("sub")).size == 3


def test_web_server(web, tmp_path):
    address, folder = web
    (folder / "a b%.bin").write_bytes(b"abc")
    location = Location.of(address).child("a b%.bin")
    status = location.stat()
    assert status.size == 3
    assert abs(status.mtime_ns / 1e9 - time.time()) < 100
    assert location.read_bytes() == b"abc"
    assert location.download(tmp_path / "copy") == 3
    with pytest.raises(StorageError, match="at most"):
        location.read_bytes(2)
    assert Location.of(f"{address}/none").stat() is None
    for act in (
        lambda: location.write_bytes(b""),
        lambda: location.upload(tmp_path / "copy"),
        location.remove,
    ):
        with pytest.raises(StorageError, match="web server"):
            act()
    with pytest.raises(StorageError) as error:
        Location.of(f"{address}/none").read_bytes()
    assert kind_of(error) == "missing"
    with pytest.raises(StorageError) as error:
        Location.of("http://127.0.0.1:9/x").read_bytes()
    assert kind_of(error) == "network"
    with pytest.raises(StorageError) as error:
        Location.of("http://127.0.0.1:9/x").stat()
    assert kind_of(error) == "network"
    with pytest.raises(StorageError):
        location.arrow()


def test_options_of_a_bucket_reach_pyarrow(monkeypatch):
    monkeypatch.delenv("AWS_ENDPOINT_URL", raising=False)
    location = Location.of(
        "s3://bucket/x?endpoint_override=127.0.0.1:1&scheme=http&region=eu-west-1"
    )
    assert location.arrow()[0].region == "eu-west-1"

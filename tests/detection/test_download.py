"""Downloads from a local server: complete, resumed, interrupted, with a wrong checksum, refused."""

import hashlib
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from track_range.detection.catalogue.download import DownloadError, fetch, pull
from track_range.detection.catalogue.entries import ModelFile, entry_named

BODY = np.random.default_rng(0).integers(0, 256, 700_000, np.uint8).tobytes()
SHA1 = hashlib.sha1(BODY, usedforsecurity=False).hexdigest()
CHECKSUM = f"sha256:{hashlib.sha256(BODY).hexdigest()}"


class Server(ThreadingHTTPServer):
    """Server of BODY.

    Attributes:
        resumes: ranges are supported.
        cut_after: number of bytes after which the first response is interrupted; None = it is not.
        status: HTTP error of every response; None = no error.
        requested: the Range header of each request.
    """

    daemon_threads = True
    resumes = True
    cut_after = None
    status = None

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.requested = []

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}/model.onnx"


class Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        server = self.server
        byte_range = self.headers.get("Range")
        server.requested.append(byte_range)
        if server.status is not None:
            self.send_error(server.status)
            return
        start = (
            int(byte_range.removeprefix("bytes=").removesuffix("-"))
            if byte_range and server.resumes
            else 0
        )
        if start >= len(BODY):
            self.send_error(416)
            return
        self.send_response(206 if start else 200)
        self.send_header("Content-Length", str(len(BODY) - start))
        self.end_headers()
        end, server.cut_after = server.cut_after or len(BODY), None
        self.wfile.write(BODY[start:end])

    def log_message(self, *_):
        pass


@pytest.fixture
def server():
    with Server() as running:
        thread = threading.Thread(target=running.serve_forever, kwargs={"poll_interval": 0.01})
        thread.start()
        yield running
        running.shutdown()
        thread.join()


def file_of(server, checksum=CHECKSUM):
    return ModelFile("model.onnx", server.url, checksum, None)


def test_download_then_cache(server, tmp_path):
    progress = []
    path = fetch(file_of(server), tmp_path / "model.onnx", lambda *counts: progress.append(counts))
    assert path.read_bytes() == BODY
    assert progress[-1] == (len(BODY), len(BODY))
    assert [done for done, _ in progress] == sorted(done for done, _ in progress)
    assert fetch(file_of(server), path) == path
    assert server.requested == [None]
    assert [file.name for file in tmp_path.iterdir()] == ["model.onnx"]


@pytest.mark.parametrize("resumes", [True, False])
def test_interrupted_download_is_resumed(server, tmp_path, resumes):
    server.resumes, server.cut_after = resumes, 300_000
    target = tmp_path / "model.onnx"
    with pytest.raises(DownloadError, match=r"model\.onnx: connection lost"):
        fetch(file_of(server), target)
    assert (tmp_path / "model.onnx.part").stat().st_size == 300_000
    assert not target.exists()
    progress = []
    fetch(file_of(server), target, lambda *counts: progress.append(counts))
    assert target.read_bytes() == BODY
    assert server.requested == [None, "bytes=300000-"]
    assert progress[-1] == (len(BODY), len(BODY))


def test_complete_part_is_only_verified(server, tmp_path):
    (tmp_path / "model.onnx.part").write_bytes(BODY)
    assert fetch(file_of(server), tmp_path / "model.onnx").read_bytes() == BODY


def test_size_of_a_variable_input_is_stored(server, tmp_path):
    file = ModelFile("rf-detr-nano.onnx", server.url, CHECKSUM, None)
    entry = replace(entry_named("rf-detr-nano"), files=(file,))
    pull(entry, tmp_path)
    assert (tmp_path / "rf-detr-nano.yaml").read_text() == "size: 384\n"
    (tmp_path / "rf-detr-nano.yaml").write_text("size: 512\n")  # the user's
    (tmp_path / "rf-detr-nano.onnx").unlink()
    pull(entry, tmp_path)
    assert (tmp_path / "rf-detr-nano.yaml").read_text() == "size: 512\n"


def test_wrong_checksum_removes_the_file(server, tmp_path):
    checksum = "sha1:" + "0" * 40
    with pytest.raises(DownloadError, match=rf"model\.onnx: .*{checksum}.*{SHA1}"):
        fetch(file_of(server, checksum), tmp_path / "model.onnx")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "model.onnx").write_bytes(b"an older release")  # replaced by the right one
    assert fetch(file_of(server), tmp_path / "model.onnx").read_bytes() == BODY


def test_http_error(server, tmp_path):
    server.status = 404
    with pytest.raises(DownloadError, match=r"model\.onnx: .*404"):
        fetch(file_of(server), tmp_path / "model.onnx")


def test_no_network(tmp_path):
    with Server() as closed:
        url = closed.url
    with pytest.raises(DownloadError, match=r"model\.onnx: cannot connect"):
        fetch(ModelFile("model.onnx", url, CHECKSUM, None), tmp_path / "model.onnx")


def test_only_http_addresses(tmp_path):
    secret = tmp_path / "secret"
    secret.touch()
    with pytest.raises(DownloadError, match=r"secret: .*http"):
        fetch(ModelFile("model.onnx", secret.as_uri(), CHECKSUM, None), tmp_path / "model.onnx")


def test_unwritable_folder(server, tmp_path):
    with pytest.raises(DownloadError, match=r"model\.onnx\.part: "):
        fetch(file_of(server), tmp_path / "none" / "model.onnx")
    (tmp_path / "file").touch()
    entry = replace(entry_named("yolov5n"), files=(file_of(server),))
    with pytest.raises(DownloadError, match=r"models: .*TRACK_RANGE_CACHE"):
        pull(entry, tmp_path / "file" / "models")


def test_second_pull_does_not_download(server, tmp_path):
    entry = replace(entry_named("yolov5n"), files=(file_of(server),))
    cache = tmp_path / "new" / "models"
    for _ in range(2):
        # in the cache, the file has the name of the entry
        assert pull(replace(entry, name="model"), cache).read_bytes() == BODY
    assert len(server.requested) == 1

"""Downloads from a server in this process: whole, resumed, cut off, wrong, refused."""

import hashlib
import threading
from dataclasses import replace
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import numpy as np
import pytest

from track_range.detection.models.catalogue import ModelFile, entry_named
from track_range.detection.models.download import DownloadError, fetch, pull

BODY = np.random.default_rng(0).integers(0, 256, 700_000, np.uint8).tobytes()
SHA1 = hashlib.sha1(BODY, usedforsecurity=False).hexdigest()
CHECKSUM = f"sha256:{hashlib.sha256(BODY).hexdigest()}"


class Server(ThreadingHTTPServer):
    """Serves BODY; `resumes`: knows ranges; `cut_after`: breaks off once; `asked`: the ranges asked for."""

    daemon_threads = True
    resumes = True
    cut_after = None
    status = None

    def __init__(self):
        super().__init__(("127.0.0.1", 0), Handler)
        self.asked = []

    @property
    def url(self):
        return f"http://127.0.0.1:{self.server_port}/model.onnx"


class Handler(BaseHTTPRequestHandler):
    def do_GET(self):
        server = self.server
        asked = self.headers.get("Range")
        server.asked.append(asked)
        if server.status is not None:
            self.send_error(server.status)
            return
        start = int(asked.removeprefix("bytes=").removesuffix("-")) if asked and server.resumes else 0
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


def test_whole_with_progress_then_from_the_cache(server, tmp_path):
    told = []
    path = fetch(file_of(server), tmp_path / "model.onnx", lambda *seen: told.append(seen))
    assert path.read_bytes() == BODY
    assert told[-1] == (len(BODY), len(BODY))
    assert [done for done, _ in told] == sorted(done for done, _ in told)
    assert fetch(file_of(server), path) == path
    assert server.asked == [None]
    assert [file.name for file in tmp_path.iterdir()] == ["model.onnx"]


@pytest.mark.parametrize("resumes", [True, False])
def test_a_cut_connection_is_resumed(server, tmp_path, resumes):
    server.resumes, server.cut_after = resumes, 300_000
    target = tmp_path / "model.onnx"
    with pytest.raises(DownloadError, match=r"broke off .*what came is kept.*, or fetch it by other means"):
        fetch(file_of(server), target)
    assert (tmp_path / "model.onnx.part").stat().st_size == 300_000
    assert not target.exists()
    told = []
    fetch(file_of(server), target, lambda *seen: told.append(seen))
    assert target.read_bytes() == BODY
    assert server.asked == [None, "bytes=300000-"]
    assert told[-1] == (len(BODY), len(BODY))


def test_a_part_that_is_already_whole_is_only_checked(server, tmp_path):
    (tmp_path / "model.onnx.part").write_bytes(BODY)
    assert fetch(file_of(server), tmp_path / "model.onnx").read_bytes() == BODY


def test_what_is_not_the_published_file_is_removed(server, tmp_path):
    wanted = "sha1:" + "0" * 40
    with pytest.raises(DownloadError, match=rf"not the published file \(checksum sha1:{SHA1}"):
        fetch(file_of(server, wanted), tmp_path / "model.onnx")
    assert list(tmp_path.iterdir()) == []
    (tmp_path / "model.onnx").write_bytes(b"an older release")  # replaced by the right one
    assert fetch(file_of(server), tmp_path / "model.onnx").read_bytes() == BODY


def test_a_server_that_refuses(server, tmp_path):
    server.status = 404
    with pytest.raises(DownloadError, match=r"the server answers 404 Not Found\. .*put it as .*model\.onnx"):
        fetch(file_of(server), tmp_path / "model.onnx")


def test_no_network(tmp_path):
    with Server() as gone:
        url = gone.url
    with pytest.raises(DownloadError, match=r"cannot be reached .*put it as .*model\.onnx"):
        fetch(ModelFile("model.onnx", url, CHECKSUM, None), tmp_path / "model.onnx")


def test_only_the_web_is_fetched_from(tmp_path):
    secret = tmp_path / "secret"
    secret.touch()
    with pytest.raises(DownloadError, match="only http and https"):
        fetch(ModelFile("model.onnx", secret.as_uri(), CHECKSUM, None), tmp_path / "model.onnx")


def test_a_folder_that_cannot_be_written(server, tmp_path):
    with pytest.raises(DownloadError, match="cannot be written"):
        fetch(file_of(server), tmp_path / "none" / "model.onnx")
    (tmp_path / "file").touch()
    entry = replace(entry_named("yolov5n"), files=(file_of(server),))
    with pytest.raises(DownloadError, match="set TRACK_RANGE_CACHE to another folder"):
        pull(entry, tmp_path / "file" / "models")


def test_pulling_an_onnx_model_twice_asks_once(server, tmp_path):
    entry = replace(entry_named("yolov5n"), files=(file_of(server),))
    cache = tmp_path / "new" / "models"
    for _ in range(2):
        # the file is named after the entry in the cache
        assert pull(replace(entry, name="model"), cache).read_bytes() == BODY
    assert len(server.asked) == 1

"""Remote clips in the local cache of a worker."""

import hashlib
from pathlib import Path

import pytest

from track_range.fleet.inputs.clip import Clip, FleetInputError
from track_range.fleet.inputs.fetch import fetched
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location

LIMIT = 10**6


def sha256(content):
    return hashlib.sha256(content).hexdigest()


def test_remote_files_are_local_for_a_while(bucket, tmp_path):
    contents = {
        "a b_left.mp4": b"left",
        "a b_right.mp4": b"right",
        "rig.yaml": b"rig",
        "speed.csv": b"speed",
    }
    for name, content in contents.items():
        bucket.child("day 1", name).write_bytes(content)
    left, right, _, speed = (bucket.child("day 1", name).address for name in contents)
    clip = Clip("a", left, right, {"ego_speed": speed, "focal": "800"}, {"vehicle": "v1"})
    with fetched(clip, tmp_path, LIMIT) as (local, files):
        assert (Path(local.left).name, Path(local.right).name) == ("a b_left.mp4", "a b_right.mp4")
        assert Path(local.left).with_name("rig.yaml").read_bytes() == b"rig"
        assert (local.settings["focal"], local.labels) == ("800", {"vehicle": "v1"})
        assert "rig" not in local.settings
        assert {role: file.sha256 for role, file in files.items()} == {
            "left": sha256(b"left"),
            "right": sha256(b"right"),
            "ego_speed": sha256(b"speed"),
            "rig": sha256(b"rig"),
        }
        state = bucket.child("day 1", "a b_left.mp4").stat()
        assert (files["left"].size, files["left"].mtime_ns) == (state.size, state.mtime_ns)
        assert Path(local.settings["ego_speed"]).read_bytes() == b"speed"
    assert list(tmp_path.iterdir()) == []


def test_folder_of_images(bucket, tmp_path):
    for name in ("data/0.png", "data/1.png", "timestamps.txt"):
        bucket.child("drive/image_02", name).write_bytes(name.encode())
    clip = Clip("a", bucket.child("drive/image_02/data").address)
    with fetched(clip, tmp_path, LIMIT) as (local, files):
        folder = Path(local.left)
        assert sorted(path.name for path in folder.iterdir()) == ["0.png", "1.png"]
        assert folder.name == "data"
        assert (folder.parent / "timestamps.txt").read_bytes() == b"timestamps.txt"
        assert set(files) == {"left", "left_timestamps"}
        before = files["left"].sha256
    bucket.child("drive/image_02/data/1.png").write_bytes(b"data/x.png")
    with fetched(clip, tmp_path, LIMIT) as (local, files):
        assert files["left"].sha256 != before


def test_local_files_are_used_in_place(tmp_path, filled):
    filled(tmp_path / "in", "a.mp4", "calib.txt")
    with fetched(Clip("a", str(tmp_path / "in/a.mp4")), tmp_path / "cache", 0) as (local, files):
        assert local.left == str(tmp_path / "in/a.mp4")
        assert set(files) == {"left", "rig"}
    assert not (tmp_path / "cache").exists()


def test_equal_content_has_equal_hashes(bucket, tmp_path, filled):
    filled(tmp_path / "in", "a.mp4", "images/0.png", "images/1.png")
    for name in ("a.mp4", "images/0.png", "images/1.png"):
        bucket.child(name).write_bytes(b"x")
    for name in ("a.mp4", "images"):
        hashes = []
        for address in (str(tmp_path / "in" / name), bucket.child(name).address):
            with fetched(Clip("a", address), tmp_path / "cache", LIMIT) as (_, files):
                hashes.append(files["left"].sha256)
        assert hashes[0] == hashes[1]


def test_web_server(web, tmp_path):
    address, folder = web
    (folder / "a%.mp4").write_bytes(b"abc")
    with fetched(
        Clip("a", Location.of(address).child("a%.mp4").address), tmp_path / "cache", LIMIT
    ) as (local, _):
        assert Path(local.left).read_bytes() == b"abc"
        assert Path(local.left).name == "a%.mp4"


def test_too_large_or_missing(bucket, tmp_path):
    bucket.child("a.mp4").write_bytes(bytes(2000))
    with (
        pytest.raises(StorageError, match="--cache-size"),
        fetched(Clip("a", bucket.child("a.mp4").address), tmp_path, 10),
    ):
        pass
    missing = Clip("a", bucket.child("a.mp4").address, bucket.child("b.mp4").address)
    with pytest.raises(StorageError, match=r"b\.mp4") as error, fetched(missing, tmp_path, LIMIT):
        pass
    assert error.value.kind == "missing"
    with (
        pytest.raises(FleetInputError, match="half"),
        fetched(Clip("a", "/x", problem="half a pair."), tmp_path, LIMIT),
    ):
        pass
    assert list(tmp_path.iterdir()) == []


def test_name_too_long_for_a_file(bucket, tmp_path):
    name = "ü" * 300 + ".mp4"
    bucket.child(name).write_bytes(b"x")
    with fetched(Clip("a", bucket.child(name).address), tmp_path, LIMIT) as (local, _):
        assert Path(local.left).suffix == ".mp4"


def test_names_of_objects_that_leave_the_folder(bucket, tmp_path):
    import boto3

    client = boto3.client("s3", region_name="us-east-1")
    outside = tmp_path / "outside.png"
    for key in (
        "images/1.png",
        "images/2.png",
        f"images/{outside}",
        "images/../3.png",
        "images//4.png",
    ):
        client.put_object(Bucket=bucket.name, Key=key, Body=b"x")
    with fetched(Clip("a", bucket.child("images").address), tmp_path / "cache", LIMIT) as (
        local,
        _,
    ):
        assert sorted(path.name for path in Path(local.left).rglob("*")) == ["1.png", "2.png"]
    assert [path.name for path in tmp_path.iterdir()] == ["cache"]


def test_error_in_a_folder(bucket, tmp_path):
    for number in range(20):
        bucket.child("images", f"{number}.png").write_bytes(bytes(100))
    with (
        pytest.raises(StorageError),
        fetched(Clip("a", bucket.child("images").address), tmp_path, 1999),
    ):
        pass
    assert list(tmp_path.iterdir()) == []

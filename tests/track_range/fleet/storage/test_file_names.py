"""Names of files in the results of a fleet, with and without --anonymize."""

from dataclasses import replace

from track_range.fleet.engine.plan import FileNames
from track_range.fleet.inputs.clip import Clip

CLIP = Clip("a", "/data/j.doe/a_left.mp4", "/data/j.doe/a_right.mp4", {"rig": "/cars/red/rig.yaml"})


def test_addresses_without_anonymization():
    names = FileNames(CLIP, is_anonymized=False)
    assert (names.left, names.right) == (CLIP.left, CLIP.right)
    assert names.text(f"{CLIP.left}: damaged.") == f"{CLIP.left}: damaged."


def test_no_folders_with_anonymization():
    names = FileNames(CLIP, is_anonymized=True)
    assert (names.left, names.right) == ("a_left.mp4", "a_right.mp4")
    text = names.text(
        "/data/j.doe/a_left.mp4, /data/j.doe/calib.txt and /cars/red/rig.yaml differ."
    )
    assert text == "a_left.mp4, calib.txt and rig.yaml differ."


def test_no_folders_of_images_and_buckets():
    images = FileNames(Clip("a", "/data/j.doe/left"), is_anonymized=True)
    assert images.text("/data/j.doe/left/000001.png: damaged.") == "left/000001.png: damaged."
    address = "s3://cars/j.doe/a.mp4?endpoint_override=host:1&scheme=http"
    remote = FileNames(replace(CLIP, left=address, right=None), is_anonymized=True)
    assert (remote.left, remote.right) == ("a.mp4", "")
    assert "j.doe" not in remote.text(f"{address}: no such file.")


def test_home_folder_with_anonymization(tmp_path, monkeypatch):
    monkeypatch.setenv("HOME", str(tmp_path))
    assert (
        FileNames(CLIP, is_anonymized=True).text(f"{tmp_path}/x.onnx: damaged.")
        == "~/x.onnx: damaged."
    )

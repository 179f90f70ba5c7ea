"""Clips of folders and patterns of files."""

import os
import re

import pytest

from track_range.fleet.inputs.clip import Clip, FleetInputError
from track_range.fleet.inputs.listing import clips_of, matched_clips
from track_range.fleet.inputs.pattern import FilePattern
from track_range.fleet.inputs.tree import FileTree
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Entry, FileStat, Location, with_folders

PAIR = "{clip}_left.mp4,{clip}_right.mp4"
VEHICLE_PAIR = "{vehicle}/{clip}_left.mp4,{vehicle}/{clip}_right.mp4"


def names_of(*recordings, pattern=None, rig=None):
    return [clip.name for clip in clips_of([str(name) for name in recordings], pattern, rig)]


def test_every_recording_of_a_folder(tmp_path, filled):
    filled(
        tmp_path,
        "b.MP4",
        "day 1/a.b.mkv",
        "day 1/rig.yaml",
        "day 1/.hidden.mp4",
        ".trash/c.mp4",
        "notes.txt",
    )
    filled(
        tmp_path,
        "images/000001.png",
        "images/000002.png",
        "day 1/thumbnail1.jpg",
        "day 1/thumbnail2.jpg",
    )
    filled(
        tmp_path,
        "bag/metadata.yaml",
        "bag/bag_0.db3",
        "bag/bag_1.db3",
        "x.mcap",
        "run/overlay.mp4",
        "run/run.mcap",
    )
    filled(tmp_path, "run/clips/01-cut_in-7.mp4")
    clips = clips_of([str(tmp_path)], None, None)
    assert [clip.name for clip in clips] == ["b", "bag", "day 1/a.b", "images", "x"]
    assert clips[0] == Clip("b", str(tmp_path / "b.MP4"))
    assert clips[1].left == str(tmp_path / "bag")


def test_folder_of_images_alone(tmp_path, filled):
    folder = filled(tmp_path / "drive 7", "000001.png", "000002.png")
    assert clips_of([str(folder)], None, None) == [Clip("drive 7", str(folder))]


def test_pairs_with_labels(tmp_path, filled):
    filled(
        tmp_path,
        *(
            f"{car}/{clip}_{side}.mp4"
            for car, clip in (("v1", "a b"), ("v2", "c"))
            for side in ("left", "right")
        ),
    )
    filled(tmp_path, "rigs/v1.yaml", "rigs/v2.yaml")
    first, second = clips_of([str(tmp_path)], VEHICLE_PAIR, f"{tmp_path}/rigs/{{vehicle}}.yaml")
    assert first == Clip(
        "a b",
        str(tmp_path / "v1" / "a b_left.mp4"),
        str(tmp_path / "v1" / "a b_right.mp4"),
        {"rig": str(tmp_path / "rigs" / "v1.yaml")},
        {"vehicle": "v1"},
    )
    assert (second.name, second.labels, second.problem) == ("c", {"vehicle": "v2"}, "")


def test_pairs_of_image_folders(tmp_path, filled):
    filled(
        tmp_path,
        *(f"{clip}/{side}/{n:06d}.png" for clip in "ab" for side in ("l", "r") for n in range(2)),
    )
    clips = clips_of([str(tmp_path)], "{clip}/l,{clip}/r", None)
    assert [(clip.name, clip.right) for clip in clips] == [
        (name, str(tmp_path / name / "r")) for name in "ab"
    ]


def test_listing_without_folders(tmp_path):
    names = [f"{clip}/x/{side}/{n}.png" for clip in "ab" for side in ("l", "r") for n in range(2)]
    tree = FileTree.of_entries(
        Location.of(tmp_path), with_folders(Entry(name, FileStat(1, 1)) for name in names)
    )
    assert "a/x" in tree
    clips = matched_clips(tree, FilePattern.of("{clip}/x/l,{clip}/x/r"), tree.folder)
    assert sorted((clip.name, clip.problem) for clip in clips) == [("a", ""), ("b", "")]


def test_half_of_a_pair_is_a_problem_of_one_clip(tmp_path, filled):
    filled(tmp_path, "a_left.mp4", "a_right.mp4", "b_left.mp4", "c_right.mp4")
    problems = {clip.name: clip.problem for clip in clips_of([str(tmp_path)], PAIR, None)}
    assert problems["a"] == ""
    assert "b_right.mp4" in problems["b"]
    assert "c_left.mp4" in problems["c"]


def test_rig_of_one_vehicle_is_missing(tmp_path, filled):
    filled(tmp_path, "v1/a.mp4", "v2/b.mp4", "v1.yaml")
    one, other = clips_of([str(tmp_path)], "{vehicle}/{clip}.mp4", f"{tmp_path}/{{vehicle}}.yaml")
    assert one.problem == ""
    assert "v2.yaml" in other.problem


@pytest.mark.parametrize(
    ("pattern", "rig", "word"),
    [
        (PAIR, None, "b_l.mp4"),
        ("{clip}_l.mp4,{clip}_rechts.mp4", None, "without"),
        (None, "none.yaml", "none.yaml"),
        (None, "{vehicle}.yaml", "vehicle"),
        (None, "{clip.yaml", "--rig"),
        ("{clip", None, "--pattern"),
    ],
)
def test_wrong_options(tmp_path, filled, pattern, rig, word):
    filled(tmp_path, "b_l.mp4", "b_r.mp4")
    with pytest.raises(FleetInputError, match=re.escape(word)):
        clips_of([str(tmp_path)], pattern, rig)


def test_nothing_found(tmp_path, filled):
    filled(tmp_path / "folder", "notes.txt")
    for name, word in (("folder", "videos"), ("none", "no such"), ("*.mp4", "pattern")):
        with pytest.raises(FleetInputError, match=word):
            clips_of([str(tmp_path / name)], None, None)
    with pytest.raises(FleetInputError):
        clips_of([], None, None)
    with pytest.raises(StorageError, match="ftp"):
        clips_of(["ftp://host/x"], None, None)


def test_equal_names(tmp_path, filled):
    filled(tmp_path, "a.mp4", "a.avi")
    with pytest.raises(FleetInputError) as error:
        clips_of([str(tmp_path)], None, None)
    assert "a.mp4" in str(error.value)
    assert "a.avi" in str(error.value)
    with pytest.raises(FleetInputError, match="twice"):
        clips_of([str(tmp_path / "a.mp4")] * 2, None, None)


def test_wildcards(tmp_path, filled):
    filled(
        tmp_path,
        "day1/a.mp4",
        "day1/b.mp4",
        "day2/a.mp4",
        "day2/deep/c.mp4",
        "other/a.mp4",
        "[x]/d.mp4",
    )
    assert names_of(tmp_path / "day*/a.mp4") == ["day1/a", "day2/a"]
    assert names_of(tmp_path / "day[!1]") == ["day2/a", "day2/deep/c"]
    assert names_of(tmp_path / "day2/**/?.mp4") == ["a", "deep/c"]
    assert names_of(tmp_path / "**/c.mp4") == ["day2/deep/c"]
    assert names_of(tmp_path / "[x]") == ["d"]


def test_file_and_several_folders(tmp_path, filled):
    filled(tmp_path, "x/a.mp4", "y/b.mp4", "c.mp4")
    assert names_of(tmp_path / "x", tmp_path / "y", tmp_path / "c.mp4") == ["a", "b", "c"]
    with pytest.raises(FleetInputError, match="folder"):
        clips_of([str(tmp_path / "c.mp4")], "{clip}.mp4", None)


@pytest.mark.parametrize("name", ["ü %20 a=b&c", "..", "a\nb", "'\"$(x)", "{clip}", "*", "a\\b"])
def test_strange_names(tmp_path, filled, name):
    filled(tmp_path, f"{name}.mp4", "plain.mp4")
    clips = {clip.name: clip.left for clip in clips_of([str(tmp_path)], "{clip}.mp4", None)}
    expected = {} if name.startswith(".") else {name: f"{tmp_path}/{name}.mp4"}
    assert clips == {"plain": f"{tmp_path}/plain.mp4", **expected}


def test_name_too_long(tmp_path, filled):
    filled(tmp_path, "ü" * 100 + ".mp4")
    with pytest.raises(FleetInputError, match="bytes"):
        clips_of([str(tmp_path)], None, None)


@pytest.mark.skipif(os.name != "posix", reason="names of other systems are Unicode")
def test_name_that_is_not_utf_8(tmp_path, filled):
    filled(tmp_path, "a.mp4", os.fsdecode(b"b\xff.mp4"))
    one, other = clips_of([str(tmp_path)], None, None)
    assert one.problem == ""
    assert "UTF-8" in other.problem
    assert (other.name + other.left + other.problem).encode()


def test_links(tmp_path, filled):
    filled(tmp_path / "disk", "a.mp4")
    recordings = filled(tmp_path / "recordings", "b.mp4")
    (recordings / "linked").symlink_to(tmp_path / "disk")
    (recordings / "loop").symlink_to(recordings)
    (recordings / "broken.mp4").symlink_to(tmp_path / "none")
    assert names_of(recordings) == ["b", "linked/a"]


def test_bucket(bucket):
    for name in (
        "v 1/a_left.mp4",
        "v 1/a_right.mp4",
        "v 1/b=%20_left.mp4",
        "v 1/b=%20_right.mp4",
        "rigs/v 1.yaml",
    ):
        bucket.child(name).write_bytes(b"x")
    one, other = clips_of([bucket.address], VEHICLE_PAIR, f"{bucket.address}/rigs/{{vehicle}}.yaml")
    assert (one.name, other.name) == ("a", "b=%20")
    assert other.left == f"{bucket.address}/v 1/b=%20_left.mp4"
    assert one.settings == {"rig": f"{bucket.address}/rigs/v 1.yaml"}
    assert names_of(f"{bucket.address}/v*/*_left.mp4") == ["v 1/a_left", "v 1/b=%20_left"]
    with pytest.raises(FleetInputError, match="bucket"):
        clips_of([f"{bucket.address}/none"], None, None)


def test_web_server(web, filled):
    address, folder = web
    filled(folder, "day 1/a.mp4", "day 1/b%.mp4", "c.mp4")
    clips = clips_of([address], None, None)
    assert [clip.name for clip in clips] == ["c", "day 1/a", "day 1/b%"]
    assert clips[2].left == f"{address}/day%201/b%25.mp4"
    assert names_of(f"{address}/c.mp4") == ["c"]
    assert names_of(f"{address}/day 1/*.mp4") == ["a", "b%"]
    with pytest.raises(StorageError, match="no such"):
        clips_of([f"{address}/none"], None, None)


def test_left_folder_without_images(tmp_path, filled):
    filled(tmp_path, "a_left.mp4", "a_right.mp4", "b_right.mp4", "b_left.mp4/notes.txt")
    clips = clips_of([str(tmp_path)], PAIR, None)
    assert [(clip.name, bool(clip.problem)) for clip in clips] == [("a", False), ("b", True)]
    assert "b_left.mp4" in clips[1].problem


def test_results_below_the_recordings(tmp_path, filled):
    filled(
        tmp_path,
        "a.mp4",
        "out/b.mp4",
        "out/fleet.json",
        "out/runs/clip=a/overlay.mp4",
        "runs/c.mp4",
    )
    assert names_of(tmp_path, pattern="{clip}.mp4") == ["a", "out/b", "runs/c"]
    filled(tmp_path, "fleet.json")
    assert names_of(tmp_path, pattern="{clip}.mp4") == ["a", "out/b"]

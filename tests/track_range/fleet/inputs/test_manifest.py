"""Manifests of clips."""

import csv
import io
from dataclasses import replace

import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from hypothesis import given, settings, strategies as st

from track_range.fleet.inputs.clip import Clip, FleetInputError
from track_range.fleet.inputs.listing import clips_of, label_note

FULL = {
    "clip": ["a", "b"],
    "left": ["day 1/a_l.mp4", "/data/b.mp4"],
    "right": ["day 1/a_r.mp4", None],
    "rig": ["../rigs/v1.yaml", "s3://bucket/v 2.yaml"],
    "ego_speed": ["50", "speed/b.csv"],
    "focal_px": [None, None],
    "vehicle": ["v1", None],
}


def csv_text(columns):
    text = io.StringIO()
    rows = csv.writer(text)
    rows.writerow(columns)
    rows.writerows(zip(*columns.values(), strict=True))
    return text.getvalue()


def write_manifest(folder, text):
    path = folder / "manifest.csv"
    path.write_text(text, encoding="utf-8")
    return str(path)


@pytest.mark.parametrize("suffix", [".csv", ".parquet"])
def test_all_kinds_of_columns(tmp_path, suffix):
    path = tmp_path / "fleet" / f"manifest{suffix}"
    path.parent.mkdir()
    if suffix == ".csv":
        path.write_text(csv_text(FULL), encoding="utf-8")
    else:
        pq.write_table(pa.table(FULL), path)
    folder = str(path.parent)
    assert clips_of([str(path)], None, None) == [
        Clip(
            "a",
            f"{folder}/day 1/a_l.mp4",
            f"{folder}/day 1/a_r.mp4",
            {"rig": f"{tmp_path}/rigs/v1.yaml", "ego_speed": "50"},
            {"vehicle": "v1"},
        ),
        Clip(
            "b",
            "/data/b.mp4",
            None,
            {"rig": "s3://bucket/v 2.yaml", "ego_speed": f"{folder}/speed/b.csv"},
            {"vehicle": ""},
        ),
    ]


def test_numbers_and_dates_in_parquet(tmp_path):
    import datetime

    columns = {
        "Left": ["a.mp4"],
        "ego_speed": [50.5],
        "start_utc": [datetime.datetime(2026, 1, 31, 14, 25, tzinfo=datetime.UTC)],
        "trip": [7],
        "night": [True],
        "driver": pa.array(["x"]).dictionary_encode(),
    }
    pq.write_table(pa.table(columns), tmp_path / "m.parquet")
    (clip,) = clips_of([str(tmp_path / "m.parquet")], None, None)
    assert clip.name == "a"
    assert clip.settings == {"ego_speed": "50.5", "start_utc": "2026-01-31T14:25:00+00:00"}
    assert clip.labels == {"trip": "7", "night": "True", "driver": "x"}


def test_labels_with_the_name_of_nearly_a_setting(tmp_path):
    clips = clips_of([write_manifest(tmp_path, "left,focal,vehicle\na.mp4,800,van\n")], None, None)
    assert label_note(clips).endswith(": focal (did you mean focal_px?), vehicle.")
    assert label_note([replace(clips[0], labels={})]) == ""


def test_names_without_the_column_clip(tmp_path):
    text = "left\nday1/a.mp4\n./b.mp4\n/data/c.mp4\ns3://x/y/d.mp4\nhttps://host/e.1.mp4?sign=a.b\n"
    clips = clips_of([write_manifest(tmp_path, text)], None, None)
    assert [clip.name for clip in clips] == ["b", "c", "d", "day1/a", "e.1"]


def test_earlier_name_of_a_setting(tmp_path):
    path = write_manifest(tmp_path, "left,folder_fps\na.mp4,20\n")
    (clip,) = clips_of([path], None, None)
    assert (clip.settings, clip.labels) == ({"fps": "20"}, {})


def test_rig_option_and_column(tmp_path, filled):
    filled(tmp_path, "v1.yaml", "own.yaml")
    path = write_manifest(
        tmp_path, "left,rig,focal_px,vehicle\na.mp4,,,v1\nb.mp4,own.yaml,,v1\nc.mp4,,800,v1\n"
    )
    rigs = [
        clip.settings.get("rig") for clip in clips_of([path], None, f"{tmp_path}/{{vehicle}}.yaml")
    ]
    assert rigs == [f"{tmp_path}/v1.yaml", f"{tmp_path}/own.yaml", None]


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("", "empty"),
        ("clip,right\na,b\n", "left"),
        ("left\n", "line"),
        ("clip,left\na,x.mp4\na,y.mp4\n", "line 3"),
        ("clip,left\na,\n", "line 2"),
        ("left,left\na,b\n", "'left'"),
        ("left,vehicle,vehicle\na,b,c\n", "'vehicle'"),
        ("left,focal_px\na,8oo\n", "line 2"),
        ("left,focal_px\na,nan\n", "line 2"),
        ("left,start_utc\na,yesterday\n", "line 2"),
        ("left,detector\na,x.onnx\n", "detector"),
        ("left,rig,focal_px\na,x.yaml,800\n", "both"),
        ("left\nftp://host/a.mp4\n", "line 2"),
        ("left\ns3://user:secret@bucket/a.mp4\n", "line 2"),
        ("left,vehicle\na,b,c,d\n", "line 2"),
        ('left\n"a\n', "quotation"),
        ("left\n" + "a" * 20_000 + "\n", "line 2"),
    ],
)
def test_damaged_csv(tmp_path, text, word):
    path = write_manifest(tmp_path, text)
    with pytest.raises(FleetInputError) as error:
        clips_of([path], None, None)
    message = str(error.value)
    assert message.startswith(path)
    assert word in message
    assert len(message) - len(path) < 300
    assert "secret" not in message


def test_damaged_parquet(tmp_path):
    path = tmp_path / "m.parquet"
    pq.write_table(pa.table({"left": [f"{n}.mp4" for n in range(100)]}), path)
    content = path.read_bytes()
    for damaged in (
        b"",
        b"PAR1",
        content[:-20],
        content[:40] + b"\xff" * 40 + content[80:],
        b"clip,left\na,b\n",
    ):
        path.write_bytes(damaged)
        with pytest.raises(FleetInputError, match=r"m\.parquet"):
            clips_of([str(path)], None, None)
    pq.write_table(pa.table({"left": ["a"], "right": [["a", "b"]]}), path)
    with pytest.raises(FleetInputError, match="right"):
        clips_of([str(path)], None, None)


def test_not_a_regular_file(tmp_path):
    for name in ("none.csv", "folder.csv", "none.parquet", "folder.parquet"):
        if name.startswith("folder"):
            (tmp_path / name).mkdir()
        with pytest.raises(FleetInputError, match=name):
            clips_of([str(tmp_path / name)], None, None)


def test_pattern_with_a_manifest(tmp_path):
    with pytest.raises(FleetInputError, match="--pattern"):
        clips_of([write_manifest(tmp_path, "left\na\n")], "{clip}.mp4", None)


@settings(max_examples=15, deadline=None)
@given(
    rows=st.lists(
        st.tuples(
            *[st.text(st.characters(codec="utf-8", exclude_characters="\0"), max_size=6)] * 3
        ),
        max_size=4,
    )
)
def test_any_cells_are_clips_or_an_error(tmp_path_factory, rows):
    text = io.StringIO()
    csv.writer(text).writerows([("clip", "left", "vehicle"), *rows])
    path = write_manifest(tmp_path_factory.mktemp("any"), text.getvalue())
    clips, message = [], ""
    try:
        clips = clips_of([path], None, None)
    except FleetInputError as error:
        message = str(error)
    assert len({clip.name for clip in clips}) == len(clips)
    assert clips or message.startswith(path) or "expected a" in message


@pytest.mark.parametrize("suffix", ["csv", "parquet"])
def test_remote_manifest(bucket, tmp_path, suffix):
    local = tmp_path / f"m.{suffix}"
    columns = {"clip": ["a"], "left": ["../videos/a b.mp4"], "right": ["s3://other/r.mp4"]}
    if suffix == "csv":
        local.write_text(csv_text(columns), encoding="utf-8")
    else:
        pq.write_table(pa.table(columns), local)
    remote = bucket.child("lists", local.name)
    remote.upload(local)
    (clip,) = clips_of([remote.address], None, None)
    assert (clip.left, clip.right) == (f"{bucket.address}/videos/a b.mp4", "s3://other/r.mp4")
    remote.write_bytes(b"clip,left\n,\n" if suffix == "csv" else b"PAR1")
    with pytest.raises(FleetInputError) as error:
        clips_of([remote.address], None, None)
    assert str(error.value).startswith(remote.address)


def test_manifest_on_a_web_server(web):
    address, folder = web
    (folder / "m.csv").write_text("left,rig\nday 1/a%.mp4,/data/rig.yaml\n", encoding="utf-8")
    (clip,) = clips_of([f"{address}/m.csv"], None, None)
    assert clip == Clip("day 1/a%", f"{address}/day%201/a%25.mp4", None, {"rig": "/data/rig.yaml"})
    (folder / "m.csv").write_text("left\n../../a.mp4\n", encoding="utf-8")
    with pytest.raises(FleetInputError, match="line 2"):
        clips_of([f"{address}/m.csv"], None, None)


@pytest.mark.slow
def test_100_000_clips(tmp_path):
    rows = (
        f"clip{n},day{n % 50}/{n}_l.mp4,day{n % 50}/{n}_r.mp4,rigs/{n % 20}.yaml,v{n % 20}"
        for n in range(100_000)
    )
    clips = clips_of(
        [write_manifest(tmp_path, "clip,left,right,rig,vehicle\n" + "\n".join(rows) + "\n")],
        None,
        None,
    )
    assert len(clips) == 100_000

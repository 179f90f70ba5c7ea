"""docs/how-to/fleet.md: its queries give the figures of the report, and its manifests are valid."""

from __future__ import annotations

import json
import math
import re
import shutil
from pathlib import Path

import pytest
import yaml

from tests.documentation.documented_commands import PAGES, PROJECT, python_blocks
from tests.support.results.events import event
from tests.track_range.fleet.fleet_results import (
    done_record,
    rows_table,
    track_rows,
    write_clip,
    write_fleet,
)
from track_range.fleet.inputs.clip import CLIP_SETTINGS
from track_range.fleet.inputs.listing import clips_of
from track_range.fleet.output.data_set import ClipTable
from track_range.fleet.output.record import ClipRecord
from track_range.fleet.report.fleet_figures import fleet_figures
from track_range.fleet.storage.location import Location
from track_range.results.events.event import EVENT_KINDS

PAGE = PAGES["docs/how-to/fleet.md"]
EXAMPLES = PROJECT / "docs/examples"


@pytest.fixture
def results(tmp_path, monkeypatch):
    """A folder `results` in the current folder, also with clips whose names are numbers."""
    out = Location.of(tmp_path / "results")
    write_fleet(out, tmp_path)
    for number, name in enumerate(("0001", "0002")):
        table = rows_table(track_rows(7, "car", near_m=8.0 + number, x_m=0.0, utc_s=None))
        events = [event(probability=0.5 + number / 4), event(kind="near_miss", warning_s=math.nan)]
        write_clip(out, done_record(name), table, tmp_path, events)
    ClipTable(out).compile()
    monkeypatch.chdir(tmp_path)
    return fleet_figures(out).figures


TRACK = track_rows(7, "car", near_m=8.0, x_m=0.0, utc_s=None)


def run_block(word):
    """Variables of the Python block of the page with a word."""
    (code,) = (code for code in python_blocks(PAGE) if word in code)
    names = {}
    exec(compile(code, "fleet.md", "exec"), names)  # noqa: S102 - our own text
    return names


def test_duckdb_queries(results):
    pytest.importorskip("duckdb")
    names = run_block("closest = duckdb")
    rows = names["closest"].fetchall()
    ranked = [(row["clip"], row["track_id"], row["distance_m"]) for row in results["closest"]]
    assert sorted(row for row in rows if row in ranked) == sorted(ranked)
    assert names["failures"].fetchall() == [("input", 1)]


def test_queries_of_events(results, tmp_path):
    pytest.importorskip("duckdb")
    out = Location.of("results")
    write_clip(
        out, done_record("quiet", labels={"vehicle": "bus"}), rows_table(TRACK), tmp_path, []
    )
    ClipTable(out).compile()
    van, bus = run_block("warnings = duckdb")["warnings"].fetchall()
    assert (van[0], *van[2:]) == ("van", "0002", 0.75)
    assert van[1] == pytest.approx(2 / results["video_h"])
    assert bus == ("bus", 0.0, None, None)
    kinds = run_block("events = duckdb")["events"].fetchall()
    assert [row[:2] for row in kinds[:2]] == [("forward_collision", 2), ("near_miss", 2)]
    assert {kind: n for kind, n, _ in kinds}.keys() == set(EVENT_KINDS)
    assert sum(rate for *_, rate in kinds) == pytest.approx(4 / (results["video_h"] + 1 / 3))


def test_page_of_queries(results, capsys):
    pytest.importorskip("duckdb")
    shutil.copytree("results", "results-before")
    before = ClipTable(Location.of("results-before"))
    row = done_record("0001").row()
    before.add({**row, "tracks": row["tracks"] + 3, "focal_px": 500.0}, is_in_journal=False)
    before.compile()
    names = {}
    for code in python_blocks(PAGES["docs/how-to/duckdb.md"]):
        exec(compile(code, "duckdb.md", "exec"), names)  # noqa: S102 - our own text
    closest = {row[0]: row[1:3] for row in names["closest"].fetchall()}
    assert closest["car"] == (
        min(row["distance_m"] for row in results["closest"]),
        results["closest"][0]["clip"],
    )
    first, *others = names["compared"].fetchall()
    assert (first[0], first[2] - first[1], first[6]) == ("0001", 3, 2.0)
    assert others
    assert all(row[1] == row[2] for row in others)
    printed = capsys.readouterr().out
    assert all(word in printed for word in ("hours", "error_kind", "reason"))


def test_pandas_queries(results):
    pytest.importorskip("pandas")
    names = run_block("pandas")
    assert names["hours"].sum() == pytest.approx(results["video_h"])
    assert names["rows"].loc["0001"]["fused_kf_m"].min() == 8.0
    assert len(names["rows"]) == 40


def test_pyarrow_query(results):
    n_near = run_block("pyarrow")["n_near"]
    # cars at 4.0 to 9.0 m, signs at 1 to 9 m, and cars at 8 and 9 m of the two numbered clips
    assert n_near == 6 + 9 + 2 + 1


def test_manifest_of_the_page(tmp_path):
    (text,) = re.findall(r"```csv\n(.*?)```", PAGE, re.DOTALL)
    (tmp_path / "clips.csv").write_text(text)
    first, second = clips_of((str(tmp_path / "clips.csv"),), None, None)
    assert (first.name, first.labels["vehicle"], first.settings["start_utc"]) == (
        "0001",
        "van-1",
        "2026-05-04T07:50:00Z",
    )
    assert (second.left, second.right) == ("s3://bucket/b.mp4", None)


def test_settings_of_clips_are_documented():
    sentence = PAGE.partition("\nThe columns `rig`")[2].partition("are settings of the clip")[0]
    assert {"rig", *re.findall(r"`(\w+)`", sentence)} == CLIP_SETTINGS


def test_columns_are_documented():
    table = PAGE.partition("| columns | content |")[2].partition("\n\n")[0]
    fixed = ClipRecord(clip="a", status="done").row()
    assert [name for name in fixed if f"`{name}`" not in table] == []


def test_kuberay_manifest():
    """Required fields of KubeRay's API ray.io/v1 (RayJobSpec, RayClusterSpec, HeadGroupSpec,
    WorkerGroupSpec)."""
    job = yaml.safe_load((EXAMPLES / "fleet-kuberay.yaml").read_text())
    assert (job["apiVersion"], job["kind"]) == ("ray.io/v1", "RayJob")
    assert re.fullmatch(r"[a-z0-9]([-a-z0-9]{0,45}[a-z0-9])?", job["metadata"]["name"])
    spec = job["spec"]
    assert spec.keys() <= {
        *(
            "entrypoint",
            "backoffLimit",
            "shutdownAfterJobFinishes",
            "ttlSecondsAfterFinished",
            "rayClusterSpec",
        ),
    }
    cluster = spec["rayClusterSpec"]
    assert cluster.keys() == {"rayVersion", "headGroupSpec", "workerGroupSpecs"}
    (workers,) = cluster["workerGroupSpecs"]
    assert workers.keys() == {
        "groupName",
        "replicas",
        "minReplicas",
        "maxReplicas",
        "rayStartParams",
        "template",
    }
    assert all(
        isinstance(workers[name], int) for name in ("replicas", "minReplicas", "maxReplicas")
    )
    for group in (cluster["headGroupSpec"], workers):
        assert all(isinstance(value, str) for value in group["rayStartParams"].values())
        (container,) = group["template"]["spec"]["containers"]
        assert {"name", "image", "resources"} <= container.keys()
        assert container["resources"]["limits"] == container["resources"]["requests"]
        mounted = {mount["name"] for mount in container.get("volumeMounts", ())}
        assert mounted == {
            volume["name"] for volume in group["template"]["spec"].get("volumes", ())
        }


def test_vm_configuration():
    """Ray's own schema of the files of its cluster launcher."""
    ray = pytest.importorskip("ray")
    jsonschema = pytest.importorskip("jsonschema")
    config = yaml.safe_load((EXAMPLES / "fleet-vms.yaml").read_text())
    schema = json.loads((Path(ray.__file__).parent / "autoscaler/ray-schema.json").read_text())
    jsonschema.validate(config, schema)
    assert config["head_node_type"] in config["available_node_types"]


@pytest.mark.parametrize("name", ["fleet-kuberay.yaml", "fleet-vms.yaml"])
def test_versions_and_images_agree(name):
    text = (EXAMPLES / name).read_text()
    (version,) = set(re.findall(r"rayproject/ray:([\d.]+)-", PAGE))
    assert set(re.findall(r'rayVersion: "([\d.]+)"', text)) <= {version}
    assert len(set(re.findall(r"image: (\S+)", text))) == 1


def test_options_of_the_examples_exist():
    from tests.documentation.documented_commands import OPTION, command_of, options_of

    job = yaml.safe_load((EXAMPLES / "fleet-kuberay.yaml").read_text())
    lines = [job["spec"]["entrypoint"], *re.findall(r"track-range fleet run [^'#\n]*", PAGE)]
    for line in lines:
        _, command, rest = command_of(line.strip())
        assert {word for word in rest if OPTION.fullmatch(word)} <= options_of(command)

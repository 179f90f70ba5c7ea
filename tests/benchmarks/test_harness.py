"""Tests of the harness of the benchmarks: options, tables and comparisons, with hand-made
figures."""

import importlib
import json
import re

import pytest

from benchmarks.__main__ import WORKLOADS
from benchmarks.gate import BASELINES, FAST, compare
from benchmarks.harness import Workload, numbers, option, print_figures, workload
from benchmarks.speed.processor_time import STEPS, WAITS, functions_at

README = BASELINES.with_name("README.md")
FIGURES = {
    "frames": 300,
    "median": {"pair": 58.7, "ordinary": None},
    "drives": {"town": {"n": 3, "bands": {"near": {"error": 0.5}}}, "city": {"n": 4}},
    "rounds": [{"pair": 58.0}, {"pair": 59.0}],
}


@pytest.mark.parametrize("name", WORKLOADS)
def test_every_workload_of_the_table_exists(name):
    module = importlib.import_module(f"benchmarks.{WORKLOADS[name][0]}")
    assert isinstance(getattr(module, name), Workload)


def test_readme_has_a_row_for_each_workload():
    text = README.read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|", text.partition("| folder |")[0], re.MULTILINE)
    assert rows == sorted(WORKLOADS)
    assert len(text.splitlines()) <= 200


def test_defaults_give_the_types_of_options():
    @workload(
        option("--frames", default=3, help="number of frames"),
        option("--seeds", default=(1, 2), help="seeds"),
        option("--out", help="a folder"),
        option("--steady", default=False, help="steady"),
    )
    def measure(options):
        return {
            "frames": options.frames,
            "seeds": options.seeds,
            "out": options.out,
            "steady": options.steady,
        }

    assert measure() == {"frames": 3, "seeds": (1, 2), "out": None, "steady": False}
    given = measure(*"--frames 5 --seeds 7 8 9 --out place --steady".split())
    assert given == {"frames": 5, "seeds": [7, 8, 9], "out": "place", "steady": True}


def test_run_writes_figures_and_machine(tmp_path, capsys):
    @workload(option("--n", default=2, help="number"))
    def measure(options):
        return {"n": options.n}

    measure.run("name", ["--n", "4", "--json", str(tmp_path / "figures.json")])
    content = json.loads((tmp_path / "figures.json").read_text(encoding="utf-8"))
    assert content["name"] == {"n": 4}
    assert {"date", "cpu", "commit", "options"} == set(content["about"])
    assert "name" in capsys.readouterr().out


def test_tables_have_the_innermost_names_as_columns(capsys):
    print_figures("pipeline", FIGURES)
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["frames", "300"] in lines
    assert ["pair", "ordinary"] in lines
    assert ["median", "58.7", "-"] in lines
    assert ["city", "4"] in lines
    assert ["near", "0.5"] in lines


def test_numbers_are_named_by_their_path_without_rounds():
    assert dict(numbers(FIGURES)) == {
        "frames": 300,
        "median.pair": 58.7,
        "drives.town.n": 3,
        "drives.town.bands.near.error": 0.5,
        "drives.city.n": 4,
    }


def write(path, name, **figures):
    path.parent.mkdir(exist_ok=True)
    path.write_text(
        json.dumps({name: figures, "about": {"date": "2026-01-01", "n": 1}}), encoding="utf-8"
    )


def test_compare_marks_ratios_outside_of_the_tolerance(tmp_path):
    write(tmp_path / "a.json", "pipeline", ms=50.0, frames=300, old=1.0, zero=0)
    write(tmp_path / "b.json", "pipeline", ms=60.0, frames=300, zero=0)
    result = compare(str(tmp_path / "a.json"), str(tmp_path / "b.json"), "--tolerance", "0.15")
    assert result["figures"] == {
        "pipeline.ms": {"A": 50.0, "B": 60.0, "B/A": pytest.approx(1.2), "outside": "*"}
    }
    assert (result["figures in both"], result["outside of the tolerance"], result["only in A"]) == (
        3,
        1,
        1,
    )
    everything = compare(
        str(tmp_path / "a.json"), str(tmp_path / "b.json"), "--tolerance", "0.25", "--all"
    )["figures"]
    assert [row["outside"] for row in everything.values()] == ["", "", ""]


def test_compare_reads_folders(tmp_path):
    for folder, ms in (("a", 50.0), ("b", 25.0)):
        write(tmp_path / folder / "pipeline.json", "pipeline", ms=ms)
        write(tmp_path / folder / "stereo.json", "stereo", ms=2.0)
    result = compare(str(tmp_path / "a"), str(tmp_path / "b"))
    assert {name: row["B/A"] for name, row in result["figures"].items()} == {"pipeline.ms": 0.5}


@pytest.mark.parametrize(
    ("before", "after", "failed"),
    [
        ({"error_px": 1.0}, {"error_px": 1.09}, []),
        ({"error_px": 1.0}, {"error_px": 1.2}, ["stereo.error_px"]),
        ({"error_px": 1.0}, {"error_px": 0.2}, []),
        ({"bias_pct": -1.0}, {"bias_pct": 1.05}, []),
        ({"bias_pct": -1.0}, {"bias_pct": -2.0}, ["stereo.bias_pct"]),
        ({"failures": 0}, {"failures": 1}, ["stereo.failures"]),
        ({"coverage": 0.9}, {"coverage": 0.7}, ["stereo.coverage"]),
        ({"coverage": 0.7}, {"coverage": 0.9}, []),
        (
            {"ms_per_frame": 1.0, "median_lead_s": 2.0},
            {"ms_per_frame": 9.0, "median_lead_s": 9.0},
            [],
        ),
        (
            {"growth_mib": 1.0, "n": 3, "sigma_px": 1.0},
            {"growth_mib": 9.0, "n": 9, "sigma_px": 9.0},
            [],
        ),
        ({"error_px": 1.0, "ms": 1.0}, {"ms": 1.0}, ["stereo.error_px"]),
    ],
)
def test_exit_status_of_compare(tmp_path, before, after, failed):
    files = [tmp_path / "a.json", tmp_path / "b.json"]
    for path, figures in zip(files, (before, after), strict=True):
        write(path, "stereo", **figures)
    assert list(compare(*map(str, files))["failed"]) == failed
    if failed:
        with pytest.raises(SystemExit, match="1"):
            compare.run("compare", list(map(str, files)))
    else:
        compare.run("compare", list(map(str, files)))


def test_workloads_of_one_side_only(tmp_path):
    """A baseline that is not recorded again is no failure; a recording without a baseline is one."""
    for folder, names in (("a", ("stereo", "fusion")), ("b", ("stereo", "lanes"))):
        for name in names:
            write(tmp_path / folder / f"{name}.json", name, error_px=1.0)
    failed = compare(str(tmp_path / "a"), str(tmp_path / "b"))["failed"]
    assert failed == {"lanes": "no baseline"}


def test_every_fast_workload_has_a_baseline():
    assert {path.stem for path in BASELINES.glob("*.json")} == set(FAST)


@pytest.mark.parametrize("content", ["", "[1, 2]", "{}", None])
def test_compare_names_a_file_without_figures(tmp_path, content):
    path = tmp_path / "bad.json"
    if content is not None:
        path.write_text(content, encoding="utf-8")
    with pytest.raises(SystemExit, match=r"bad\.json"):
        compare(str(path), str(path))


@pytest.mark.parametrize(
    "path", [path for paths in (*STEPS.values(), *WAITS.values()) for path in paths]
)
def test_measured_functions_exist(path):
    assert all(callable(function) for _, function in functions_at(path))

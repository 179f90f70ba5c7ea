"""Tests of `track-range check`: limits of figures, exit status, JUnit."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import pytest

import track_range as tr
from tests.support.results.run_folder import write_run


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """A run with a median error of 5 % of fused, 6 boxes, and figures that were not measured."""
    folder = write_run(tmp_path / "run")
    summary = json.loads((folder / "summary.json").read_text())
    method = {
        "coverage": 0.9,
        "n": 6,
        "bias_pct": -5.0,
        "median_relative_error_pct": 5.0,
        "median_relative_error_pct_ci95": [4.0, 6.5],
        "bands": [{"from_m": 5.0, "to_m": 10.0, "n": 0}],
    }
    poor = {**method, "coverage": 0.3}
    methods = {"methods": {"fused": method, "lane": poor}, "tracks": {"mota": None, "n": 1}}
    methods["inputs"] = {"mono": "drive.mp4"}
    (folder / "summary.json").write_text(json.dumps({**summary, **methods}))
    return folder


@pytest.mark.parametrize(
    ("limit", "holds"),
    [
        ("fused.median_relative_error_pct < 5", False),
        ("fused.median_relative_error_pct<=5", True),
        ("fused.bias_pct > -6", True),
        ("abs(fused.bias_pct) < 5", False),
        ("abs( fused.bias_pct ) <= 5.0", True),
        ("fused.median_relative_error_pct_ci95.1 < 6", False),
        ("fused.bands.0.n == 0", True),
        ("methods.fused.n != 6", False),
        ("tracks.n >= 1e0", True),
        ("tracks.mota >= 0", False),  # not measured
        ("tracks.mota < 1000", False),
        ("lane.median_relative_error_pct < 50", False),  # of 30 % of the boxes
        ("lane.n > 5", True),
        ("lane.coverage < 0.5", True),
        ("inputs.mono == 'drive.mp4'", True),
    ],
)
def test_limits(run: Path, limit: str, holds: bool) -> None:
    figures = tr.check(run, require=[limit])
    assert figures["holds"] is figures["limits"][0]["holds"] is holds
    assert figures["limits"][0]["sentence"]


def test_smaller_coverage_may_be_allowed(run: Path) -> None:
    limit = ["lane.median_relative_error_pct < 50"]
    assert tr.check(run, require=limit, min_coverage=0.3)["holds"]
    assert "30 %" in tr.check(run, require=limit)["limits"][0]["sentence"]


@pytest.mark.parametrize(
    ("limit", "word"),
    [
        ("fused.median_error_pct < 5", "median_relative_error_pct"),
        ("fusd.n < 5", "fused"),
        ("fused.n.more < 5", "more"),
        ("fused < 5", "number"),
        ("inputs.mono < 5", "number"),
        ("fused.n", "such as"),
        ("fused.n = 5", "such as"),
        ("fused.n < 5 or True", "number"),
        ("abs(fused.n < 5", "such as"),
        ("().__class__ == 1", "such as"),
    ],
)
def test_limits_that_cannot_be_understood(
    run: Path, limit: str, word: str, cli: Callable[..., Any]
) -> None:
    with pytest.raises(tr.errors.UsageError, match=word):
        tr.check(run, require=[limit])
    assert cli("check", run, "--require", limit)[0] == 2


def test_command_with_a_file_of_limits(run: Path, tmp_path: Path, cli: Callable[..., Any]) -> None:
    limits, junit = tmp_path / "limits.yaml", tmp_path / "check.xml"
    limits.write_text(
        "limits:\n  - fused.n >= 6\n  - fused.median_relative_error_pct < 4 # strict\n"
    )
    status, printed, _ = cli("check", run, "--limits", limits, "--junit", junit)
    assert status == 1
    assert "holds  fused.n >= 6: fused.n is 6" in printed
    assert "1 of 2 limits broken." in printed
    (suite,) = ElementTree.parse(junit).getroot()  # noqa: S314 - our own file
    assert (suite.get("tests"), suite.get("failures")) == ("2", "1")
    failures = [case.find("failure") for case in suite]
    assert failures[0] is None
    assert failures[1] is not None
    assert "5.0" in str(failures[1].get("message"))
    assert cli("check", run, "--require", "fused.n >= 6")[0] == 0
    limits.write_text("limits: 5\n")
    assert cli("check", run, "--limits", limits)[0] == 1
    assert cli("check", run)[0] == 2


def test_clips_of_a_fleet(run: Path, tmp_path: Path) -> None:
    for name in ("a", "b"):
        clip = tmp_path / "fleet" / "runs" / f"clip={name}"
        clip.parent.mkdir(parents=True, exist_ok=True)
        shutil.copytree(run, clip)
        rows = tmp_path / "fleet" / "tracks" / f"clip={name}"
        rows.mkdir(parents=True)
    figures = tr.check([tmp_path / "fleet", run], require=["fused.n == 6"])
    assert [Path(row["run"]).name for row in figures["limits"]] == ["clip=a", "clip=b", "run"]
    assert figures["holds"]
    (tmp_path / "fleet" / "fleet.json").write_text('{"total": 3, "failed": 1}')
    figures = tr.check(tmp_path / "fleet", require=["fused.n == 6"])
    assert not figures["holds"]
    assert figures["limits"][-1]["sentence"] == "2 of 3 clips have results"


def test_names_that_xml_does_not_have(run: Path, tmp_path: Path) -> None:
    folder, junit = run.rename(tmp_path / "a <&\x01\udcff ü"), tmp_path / "check.xml"
    tr.check(folder, require=["fused.n == 6"], junit=junit)
    (suite,) = ElementTree.parse(junit).getroot()  # noqa: S314 - our own file
    assert str(suite.get("name")).endswith("a <&?? ü")


@pytest.mark.parametrize("flag", ["--json", "--junit"])
def test_figures_of_the_run_are_not_replaced(run: Path, flag: str, cli: Callable[..., Any]) -> None:
    before = (run / "summary.json").read_text()
    limit = ("--require", "fused.n == 6")
    assert cli("check", run, *limit, flag, run / "summary.json")[0] == 1
    assert (run / "summary.json").read_text() == before
    own = run / {"--json": "check.json", "--junit": "check.xml"}[flag]
    assert [cli("check", run, *limit, flag, own)[0] for _ in range(2)] == [0, 0]

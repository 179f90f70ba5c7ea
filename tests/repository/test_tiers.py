"""The table of test tiers: what it counts, also with pytest-xdist, and when it is a failure."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.tiers import OUTCOMES, TIERS, main, table_lines

PROJECT = Path(__file__).resolve().parents[2]

TESTS = """
import pytest

@pytest.fixture
def shared_data():
    pytest.skip("no recordings")

@pytest.fixture
def broken():
    yield
    raise ValueError

def test_fast(): ...
def test_recording(shared_data): ...
@pytest.mark.slow
def test_teardown(broken): ...
@pytest.mark.slow
@pytest.mark.train
def test_training(): ...
"""


def counts(**changes):
    """Counts of one passed test per tier, with some replaced."""
    return {
        tier: dict.fromkeys(OUTCOMES, 0) | {"passed": 1, "reasons": {}} | changes.get(tier, {})
        for tier in TIERS
    }


def table(tmp_path, content, *options):
    """The exit status of the table of these counts."""
    file = tmp_path / "tiers.json"
    file.write_text(json.dumps(content))
    return main([str(file), *options])


@pytest.mark.slow
def test_run_with_workers(tmp_path):
    (tmp_path / "test_four.py").write_text(TESTS)
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "tests.tiers",
        "-p",
        "no:cacheprovider",
        "--numprocesses",
        "1",
    ]
    environment = os.environ | {"PYTHONPATH": str(PROJECT)}
    done = subprocess.run(
        [*command, "--tiers-file=t.json"],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 1, done.stderr
    counted = json.loads((tmp_path / "t.json").read_text())
    zero = dict.fromkeys(OUTCOMES, 0) | {"reasons": {}}
    assert counted == {
        "fast": zero | {"passed": 1},
        "real": zero | {"skipped": 1, "reasons": {"no recordings": 1}},
        "slow": zero | {"failed": 1},
        "train": zero | {"passed": 1},
    }
    assert all(line in done.stdout.splitlines() for line in table_lines(counted))


def test_complete_table_succeeds(tmp_path, capsys):
    assert table(tmp_path, counts()) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "5 passed, 0 failed, 0 skipped"


@pytest.mark.parametrize(
    "change",
    [
        {"browser": {"passed": 0, "skipped": 3, "reasons": {"no Chromium": 3}}},
        {"browser": {"passed": 0}},
        {"slow": {"failed": 1}},
    ],
)
def test_tier_of_skips_and_failures(tmp_path, change):
    assert table(tmp_path, counts(**change)) == 1


def test_tier_that_may_be_empty(tmp_path, capsys):
    content = counts(real={"passed": 0, "skipped": 2, "reasons": {"no recordings": 2}})
    assert table(tmp_path, content, "--may-be-empty", "real") == 0
    assert "2 x no recordings" in capsys.readouterr().out


def test_missing_tier(tmp_path, capsys):
    content = counts()
    del content["train"]
    assert table(tmp_path, content) == 1
    assert "Tier train" in capsys.readouterr().out

"""A bounded number of cases of `python -m tests.torture` with a fixed seed: none fails."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

PROJECT = Path(__file__).resolve().parents[2]

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        sys.platform != "linux", reason="the cases run in forked processes with limits of Linux"
    ),
]


@pytest.mark.parametrize(
    ("parts", "n_cases"),
    [
        (["mutants"], 74),
        (["kills", "full-disk", "failing-writes", "locks", "determinism", "server"], 2),
    ],
    ids=["mutants", "runs"],
)
def test_torture(tmp_path: Path, parts: list[str], n_cases: int) -> None:
    figures = tmp_path / "figures.json"
    command = [
        sys.executable,
        "-m",
        "tests.torture",
        "--only",
        *parts,
        "--cases",
        str(n_cases),
        "--seed",
        "18",
    ]
    done = subprocess.run(
        [*command, "--folder", tmp_path / "cases", "--json", figures],
        cwd=PROJECT,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    counts = json.loads(figures.read_text())
    assert set(counts) == set(parts)
    # 0 = not possible on this machine
    assert all(count["cases"] in (0, n_cases) for count in counts.values())

"""Files for the results of `track-range evaluate`."""

from __future__ import annotations

import pytest

from tests.command_line import run_command


@pytest.mark.parametrize(
    "inputs",
    [
        ("tracks", "--results", "--truth"),
        ("events", "--events", "--truth"),
    ],
)
def test_inputs_are_not_replaced(inputs, tmp_path):
    command, *flags = inputs
    path = tmp_path / "input.txt"
    path.write_text("0 0 Car 0 0 0 10 10 60 60 1.5 1.6 4 0 1.6 20 0\n")
    arguments = [argument for flag in flags for argument in (flag, path)]
    done = run_command("evaluate", command, *arguments, "--json", path)
    assert done.status == 1
    assert "that of --" in done.stderr
    assert path.read_text().startswith("0 0 Car")

"""Configuration of pre-commit and of the code host: valid YAML that refers to files which exist."""

import os
import shlex
import sys
from pathlib import Path

import pytest
import yaml

PROJECT = Path(__file__).resolve().parents[2]
WORKFLOW = PROJECT / ".github/workflows/checks.yml"
FORMS = ("bug", "feature")


def document(path):
    return yaml.safe_load(path.read_text(encoding="utf-8"))


def test_pre_commit_hooks():
    repositories = document(PROJECT / ".pre-commit-config.yaml")["repos"]
    assert [one["repo"] for one in repositories] == ["local"]
    hooks = {hook["id"]: hook for hook in repositories[0]["hooks"]}
    assert set(hooks) == {"ruff-check", "ruff-format", "mypy", "word-list"}
    for hook in hooks.values():
        python, *arguments = shlex.split(hook["entry"])
        assert (python, hook["language"]) == (".venv/bin/python", "system")
        assert arguments[0] == "-m" or (PROJECT / arguments[0]).is_file()


def test_workflow_jobs():
    jobs = document(WORKFLOW)["jobs"]
    assert {job["runs-on"].split("-")[0] for job in jobs.values()} == {"ubuntu", "macos", "windows"}
    commands = {
        name: [step["run"] for step in job["steps"] if "run" in step] for name, job in jobs.items()
    }
    assert commands["linux"][-1].startswith(".ci/run")
    assert "make test" in commands["macos"]
    assert any("core.symlinks true" in command for command in commands["windows"])
    if sys.platform != "win32":
        assert os.access(PROJECT / ".ci/run", os.X_OK)


def test_windows_runs_the_fast_tier():
    tests = document(WORKFLOW)["jobs"]["windows"]["steps"][-1]["run"]
    slow_tiers = next(
        line
        for line in (PROJECT / "Makefile").read_text().splitlines()
        if line.startswith("SLOW_TIERS")
    )
    assert f'-m "not ({slow_tiers.partition(":=")[2].strip()})"' in tests


@pytest.mark.parametrize("name", FORMS)
def test_issue_form(name):
    form = document(PROJECT / f".github/ISSUE_TEMPLATE/{name}.yml")
    assert {"name", "description", "body"} <= set(form)
    ids = [field["id"] for field in form["body"]]
    assert len(set(ids)) == len(ids)
    assert all(
        field["type"] == "textarea" and field["attributes"]["label"] for field in form["body"]
    )


def test_bug_form_asks_for_the_doctor():
    fields = {
        field["id"]: field for field in document(PROJECT / ".github/ISSUE_TEMPLATE/bug.yml")["body"]
    }
    assert "track-range doctor" in fields["doctor"]["attributes"]["description"]
    assert fields["doctor"]["validations"]["required"]

"""The pages of docs/start and docs/how-to that lead from files to results: their commands and
Python code, in order."""

import json
import re
import shlex
import shutil
from pathlib import Path

import pytest

from docs.notebooks import executed
from tests.documentation.documented_commands import PAGES, PROJECT, is_command, without_comment
from tests.documentation.documented_inputs import copy_inputs, write_inputs
from tests.support.command_line import run_command

pytestmark = pytest.mark.slow

BLOCK = re.compile(
    r"^```python\n(.*?)^```|^```.*?^```|((?:^ {4}[^\n]*\n)+)", re.MULTILINE | re.DOTALL
)
CHEAP = ("--align", "off", "--no-sgbm", "--no-overlay", "--duration", "0.6")
"""Options that are added to runs."""

FILES = {
    "docs/start/dashcam.md": ("drive/report.html", "calibrated/report.html"),
    "docs/start/stereo.md": ("rig.png", "drive/report.html"),
    "docs/how-to/robot.md": (),
    "docs/how-to/camera-files.md": ("copy.yaml", "opencv.yml"),
    "docs/how-to/cvat.md": ("drive-1.xml", "drive-2/summary.json", "data/data.yaml"),
    "docs/how-to/train.md": ("runs/first/road.onnx", "drive/report.html"),
}
"""By page: files that its commands write."""

PRINTED = {
    "docs/start/dashcam.md": ("closest_m", "sigma_m"),
    "docs/start/stereo.md": ("7 of 7", "30 m", "closest_m"),
    "docs/how-to/robot.md": ("0.1 s: ", " +- "),
    "docs/how-to/camera-files.md": ("baseline 0.5", "Disparity and range resolution"),
    "docs/how-to/cvat.md": ("HOTA", "100.0"),
    "docs/how-to/train.md": ("mAP50", "epoch 1/1"),
}
"""By page: words that they print."""


@pytest.fixture(scope="session")
def store(tmp_path_factory, small_drive):
    """Files of all names that the pages use."""
    folder = write_inputs(tmp_path_factory.mktemp("cookbook"), small_drive)
    shutil.copy(small_drive.left, folder / "drive.mp4")
    return folder


def steps(text):
    """Python code and command lines of a page in their order, as (kind, text)."""
    for code, indented in BLOCK.findall(text):
        if code:
            yield "python", code
        for line in map(str.strip, indented.splitlines()):
            if is_command(line):
                yield "command", without_comment(line)


@pytest.mark.parametrize(
    "page",
    [pytest.param(page, marks=pytest.mark.train if "train" in page else ()) for page in FILES],
)
def test_page_runs(page, store, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    copy_inputs(
        store,
        [
            "left.mp4",
            "right.mp4",
            "rig.yaml",
            "dashcam.mp4",
            "drive.mp4",
            "left*.jpg",
            "right*.jpg",
        ],
        tmp_path,
    )
    if "stereo" in page:
        (tmp_path / "rig.yaml").unlink()
    printed = []
    for kind, text in steps(PAGES[page]):
        if kind == "python":
            exec(compile(text, page, "exec"), {})  # noqa: S102 - our own text
            continue
        words = shlex.split(text)
        if words[0] != "track-range":
            continue
        done = run_command(
            *words[1:], *(CHEAP if words[1].startswith("--") else ()), folder=tmp_path
        )
        assert (done.status, done.stderr) == (0, ""), text
        printed.append(done.stdout)
        if "calibrate" in words:  # the boards are of another pair
            shutil.copy(store / "rig.yaml", tmp_path)
        if "cvat" in words:
            shutil.copy("drive-1.xml", "corrected.xml")
    output = "\n".join((*printed, capsys.readouterr().out))
    assert [word for word in PRINTED[page] if word not in output] == []
    assert [name for name in FILES[page] if not Path(name).is_file()] == []


def test_notebook_has_the_outputs_of_its_cells(store, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    copy_inputs(store, ["left.mp4", "right.mp4", "rig.yaml"], tmp_path)
    notebook = json.loads((PROJECT / "docs/how-to/notebook.ipynb").read_text(encoding="utf-8"))
    shown = executed(notebook)
    kinds = [[sorted(o.get("data", o)) for o in cell.get("outputs", ())] for cell in shown["cells"]]
    assert kinds == [
        [sorted(o.get("data", o)) for o in cell.get("outputs", ())] for cell in notebook["cells"]
    ]
    assert shown["cells"][1]["outputs"][0]["text"] == ["12 frames\n"]
    assert "closest_m" in shown["cells"][3]["outputs"][0]["data"]["text/plain"]
    assert shown["cells"][5]["outputs"][0]["data"]["image/png"].startswith("iVBOR")

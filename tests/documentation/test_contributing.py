"""The examples of CONTRIBUTING.md run as they stand and are short."""

import ast
import re
from pathlib import Path

import numpy as np
import pytest

import track_range as tr
from track_range.ranging.registry import METHODS
from track_range.results.writers import WRITERS, create_writer
from track_range.stereo.rig_formats.reading import RIG_FORMATS
from track_range.tracking.registry import TRACKERS

PROJECT = Path(__file__).resolve().parents[2]
TEXT = (PROJECT / "CONTRIBUTING.md").read_text(encoding="utf-8")
EXAMPLES = dict(re.findall(r"^## (A [\w ]+)\n.*?```python\n(.*?)```", TEXT, flags=re.M | re.S))


@pytest.fixture
def unregistered():
    """Registries that are restored after the test."""
    with METHODS.restored(), TRACKERS.restored(), WRITERS.restored():
        yield


def test_examples_are_short():
    assert set(EXAMPLES) == {"A ranging method", "A tracker", "A result writer", "A rig format"}
    for title, code in EXAMPLES.items():
        statements = [node for node in ast.walk(ast.parse(code)) if isinstance(node, ast.stmt)]
        assert len(statements) <= 20, title


@pytest.mark.usefixtures("unregistered")
def test_ranging_method_example():
    names = {}
    exec(EXAMPLES["A ranging method"], names)  # noqa: S102 - our own text
    method = next(method for method in tr.ranging_methods() if method.name == "sign")
    ranger = method.create(
        type("Context", (), {"camera": tr.PinholeCamera(700.0, 700.0, 320.0, 180.0, 640, 360)})()
    )
    ids = np.array([1, 2])
    boxes = np.array([[10.0, 10.0, 45.0, 45.0], [10.0, 10.0, 45.0, 45.0]])
    tracks = tr.Tracks(ids, boxes, np.array([7, 2]), np.ones(2), np.ones(2, np.bool_))
    ranges = ranger.measure(tracks, tr.Frame(0, 0.0, np.zeros((360, 640, 3), np.uint8), None))
    assert ranges.distance_m[0] == pytest.approx(700.0 * 0.7 / 35.0)
    assert np.isnan(ranges.distance_m[1])


@pytest.mark.usefixtures("unregistered")
def test_tracker_example():
    exec(EXAMPLES["A tracker"], {})  # noqa: S102 - our own text
    tracker = tr.Tracker("nothing")
    for _ in range(2):
        tracks = tracker.update(tr.Detections.of([[0, 0, 9, 9]], [0.9], [2]), time_s=0.0)
    assert tracks.track_id.tolist() == [2]


@pytest.mark.usefixtures("unregistered")
def test_result_writer_example(tmp_path):
    exec(EXAMPLES["A result writer"], {})  # noqa: S102 - our own text
    writer = create_writer("lines")
    writer.open(None, tmp_path)
    writer.close(None)
    assert (tmp_path / "lines.txt").exists()


def test_rig_format_example(tmp_path):
    names = {}
    exec(EXAMPLES["A rig format"], names)  # noqa: S102 - our own text
    (tmp_path / "flat.txt").write_text("flat 700 320 180 640 360 0.5\n")
    with RIG_FORMATS.restored():
        RIG_FORMATS.registered["flat"] = names["FLAT"]
        rig = tr.load_rig(tmp_path / "flat.txt")
    assert (rig.left.fx_px, rig.left.width_px, rig.baseline_m) == (700.0, 640, 0.5)


def test_documentation_has_the_same_examples():
    pages = (PROJECT / "docs/project/extending.md").read_text(encoding="utf-8")
    assert [
        name
        for name in re.findall(r"^class (\w+)", TEXT, flags=re.M)
        if f"class {name}" not in pages
    ] == []

"""Results can be traced to the content of what the run read."""

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import track_range as tr
from track_range.foundation.files.structured_text import read_yaml
from track_range.run.reports import input_hashes


def summary_of(run: tr.Run, folder: Path) -> dict[str, Any]:
    for _ in run:
        pass
    summary: dict[str, Any] = json.loads((folder / "summary.json").read_text())
    settings = read_yaml(folder / "settings.yaml", ValueError, "settings")
    assert isinstance(settings, dict)
    assert settings["settings_hash"] == summary["settings_hash"]
    return summary


@pytest.mark.slow
def test_hash_of_settings_covers_a_file_that_changes_in_place(
    tmp_path: Path, run_on_noise: Callable[..., tr.Run]
) -> None:
    boxes = tmp_path / "boxes.txt"
    given = run_on_noise(None).settings.detections
    assert given is not None
    hashes = []
    for text in (given.read_text(), given.read_text(), given.read_text().replace("0.9", "0.8")):
        boxes.write_text(text)
        run = run_on_noise(tmp_path / "out", detections=boxes, overlay=False)
        summary = summary_of(run, tmp_path / "out")
        files = {entry["role"]: entry for entry in summary["provenance"]["files"]}
        video = run.settings.mono
        assert isinstance(video, Path)
        for role, file in (("mono", video), ("detections", boxes)):
            assert files[role]["name"] == file.name
            assert files[role]["bytes"] == file.stat().st_size
            assert files[role]["sha256"] == hashlib.sha256(file.read_bytes()).hexdigest()
        hashes.append(summary["settings_hash"])
    assert hashes[0] == hashes[1] != hashes[2]


@pytest.mark.slow
def test_large_recordings_are_hashed_whole_beside_the_run(
    tmp_path: Path, run_on_noise: Callable[..., tr.Run], monkeypatch: pytest.MonkeyPatch
) -> None:
    video = run_on_noise(None).settings.mono
    assert isinstance(video, Path)
    large = tmp_path / "large.mp4"  # bytes after the last box of an MP4 file are ignored
    large.write_bytes(video.read_bytes() + bytes(17 << 20))
    out = tmp_path / "out"

    def of_video() -> dict[str, Any]:
        settings = run_on_noise(out, overlay=False).settings
        run = tr.Run(settings.model_copy(update={"mono": large}))
        (entry,) = [
            entry
            for entry in summary_of(run, out)["provenance"]["files"]
            if entry["role"] == "mono"
        ]
        assert isinstance(entry, dict)
        return entry

    assert of_video()["sha256"] == hashlib.sha256(large.read_bytes()).hexdigest()
    monkeypatch.setattr(input_hashes, "_WHOLE_BYTES", 1 << 20)
    entry = of_video()
    assert "sha256" not in entry
    assert len(entry["sha256_of_samples"]) == 64

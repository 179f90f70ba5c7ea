"""The origin of the results of a run: its inputs, settings and versions."""

import platform
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from track_range.foundation.errors import Note
from track_range.foundation.installed import conflicts, installed_versions
from track_range.foundation.schemas.schema_version import SCHEMA_VERSION
from track_range.ranging.registry import origins
from track_range.results.formats.provenance import Provenance, settings_hash
from track_range.results.formats.run_info import RunInfo
from track_range.run.opening import OpenedRun
from track_range.run.options.anonymity import ANONYMIZED, without_folders, without_paths
from track_range.run.options.paths import files_by_setting, input_files
from track_range.run.options.settings_file import absolute_settings
from track_range.run.reports.input_hashes import InputHashes
from track_range.run.reports.report import Reports
from track_range.stereo.geometry.mounting import Mounting

_LIBRARIES = ("track-range", "numpy", "opencv-python-headless", "onnxruntime", "av", "scipy")
_INPUTS = ("left", "right", "mono", "rig", "focal_px", "detector", "detections", "curves", "truth")


@dataclass(frozen=True, slots=True)
class Origin(Reports):
    """Inputs, settings and versions of a run."""

    opened: OpenedRun
    inputs_read: InputHashes

    def notes(self) -> Sequence[str]:
        """Notes on anonymized results, on the boxes, the installation and the ground truth."""
        opened = self.opened
        return (
            *([ANONYMIZED] if opened.settings.anonymize else []),
            *opened.box_source.notes(),
            *conflicts(),
            *(() if opened.truth is None else opened.truth.notes),
        )

    def summary(self) -> Mapping[str, Any]:
        """Versions, the hash of the settings, and the hashes of the files that were read."""
        return {
            **self.inputs_read.summary(),
            "versions": _versions(),
            "schema_version": SCHEMA_VERSION,
            "settings_hash": self.provenance.settings_hash,
        }

    @property
    def provenance(self) -> Provenance:
        """What determined the results."""
        settings = absolute_settings(self.opened.settings)
        hashed = settings_hash(settings, origins(), self.inputs_read.hashes)
        return Provenance.of_inputs(self.detected(), hashed)

    @property
    def mounting(self) -> Mounting | None:
        """Where the view is in the vehicle, and where it looks; None = unknown."""
        opened = self.opened
        return opened.recording.calibration.view_mounting(opened.settings.mounting)

    @property
    def inputs(self) -> dict[str, Any]:
        """Names of the inputs, for summary.json."""
        settings = self.opened.settings
        shown = settings.model_dump(mode="json", exclude_none=True)
        if settings.stereo is not None:
            shown["left"], shown["right"] = shown["stereo"]
        inputs = {key: shown[key] for key in _INPUTS if key in shown}
        return without_folders(inputs) if settings.anonymize else inputs

    def detected(self) -> dict[str, Any]:
        """Section `found` of settings.yaml: properties of the opened inputs."""
        recording, camera = self.opened.recording, self.opened.recording.camera
        rig = recording.calibration.path
        is_anonymized = self.opened.settings.anonymize
        return {
            **self.opened.box_source.description,
            "rig": None if rig is None else rig.name if is_anonymized else str(rig),
            "calibration": recording.calibration.kind,
            "focal_px": camera.fx_px,
            "focal_y_px": camera.fy_px,
            "principal_point_px": [camera.cx_px, camera.cy_px],
            "baseline_m": recording.calibrated_rig.baseline_m if recording.calibrated_rig else None,
            "image_size_px": list(recording.size_px),
            "mount": [] if (mounting := self.mounting) is None else list(mounting.parts),
            "fps": recording.fps,
            "utc": None if recording.utc is None else recording.utc.summary(),
            "versions": _versions(),
        }

    def info(self, overlay: Path | None, notes: Sequence[str]) -> RunInfo:
        """Properties of the run for result writers."""
        recording = self.opened.recording
        return RunInfo(
            camera=recording.camera,
            rig=recording.calibrated_rig,
            fps=recording.fps,
            methods=tuple(self.opened.pipeline.ranging.rangers),
            settings=absolute_settings(self.opened.settings),
            start_utc_s=None if recording.utc is None else recording.utc.start_s,
            provenance=self.provenance,
            notes=tuple(notes),
            mounting=self.mounting,
            overlay=overlay,
            recorded_boxes=recording.calibration.rectifier.recorded_boxes,
        )

    def published(self, notes: Sequence[str]) -> list[str]:
        """Notes as results have them: of an anonymized run without folders."""
        opened = self.opened
        if not opened.settings.anonymize:
            return list(notes)
        rig = opened.recording.calibration.path
        rigs = [] if rig is None else [rig]
        paths = [*input_files(opened.settings), *rigs, *opened.speed.files]
        texts = [(note, without_paths(note, paths)) for note in notes]
        return [note.said(text) if isinstance(note, Note) else text for note, text in texts]


def input_hashes(opened: OpenedRun) -> InputHashes:
    """Hashes of the files of the settings, and of the calibration and telemetry that were found
    beside the recording.
    """
    files = files_by_setting(opened.settings)
    rig, speed = opened.recording.calibration.path, opened.speed.files
    files |= {} if rig is None else {"rig": [rig]}
    files |= {"ego_speed": list(speed)} if speed else {}
    files.pop("detector", None)
    return InputHashes(files, opened.box_source.description.get("detector", {}))


@cache
def _versions() -> dict[str, str]:
    libraries = [item for name in _LIBRARIES for item in installed_versions(name).items()]
    return {"python": platform.python_version(), **dict(libraries)}

"""What the recording of a run and its frames show: notes on reading, calibration and time."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.pipeline.ego import EgoStage
from track_range.ranging.size_models.region import Region
from track_range.recording.recording import Recording
from track_range.results.summary import frame_spans
from track_range.results.table import RunRows
from track_range.run.options.settings import RunSettings
from track_range.run.reports.report import Reports


@dataclass(frozen=True, slots=True)
class ProcessedFrames(Reports):
    """The processed frames, and their times."""

    rows: RunRows
    recording: Recording
    every: int  # of the recorded frames, one in so many was processed

    def summary(self) -> Mapping[str, Any]:
        """Numbers, start, and UTC."""
        utc = self.recording.utc
        return {
            "frames": len(self.rows),
            **frame_spans(np.array(self.rows.frame_index, np.int64), self.every),
            "starts_s": round(self.rows.starts_s, 6),
            "utc": None if utc is None else utc.summary(),
        }


@dataclass(frozen=True, slots=True)
class RecordedCameras(Reports):
    """The cameras of the recording."""

    recording: Recording
    settings: RunSettings
    region: Region

    def notes(self) -> Sequence[str]:
        """Notes on the reading and the calibration."""
        return self.recording.notes

    def summary(self) -> Mapping[str, Any]:
        """The camera models with which the run measured."""
        calibration, rig = self.recording.calibration, self.recording.calibrated_rig
        estimate = calibration.estimate
        return {
            "calibration": calibration.kind,
            "focal_px": self.recording.camera.fx_px,
            "focal_sigma": round(calibration.focal_sigma, 4),
            "camera_estimate": None if estimate is None else estimate.summary(),
            "mounting": calibration.mounting_summary(self.settings.mounting),
            "region": self.region,
            "baseline_m": rig.baseline_m if rig else None,
        }


@dataclass(frozen=True, slots=True)
class PairReport(Reports):
    """The alignment and the synchronization of the cameras of a pair."""

    recording: Recording
    ego: EgoStage

    def summary(self) -> Mapping[str, Any]:
        """Sections of a pair; no entries for one camera."""
        alignment, sync = self.recording.calibration.alignment, self.recording.sync
        odometry = self.ego.pair_odometry
        later = None if odometry is None else odometry.move
        of_alignment = {} if alignment is None else {"alignment": alignment.summary(later)}
        return {**of_alignment, **({} if sync is None else sync.summary())}

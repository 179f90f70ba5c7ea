"""Options of a run that are not possible with its recording, or have no effect."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.pipeline.ranging import RangingStage
from track_range.recording.recording import Recording
from track_range.recording.sources.names import source_of
from track_range.results.rows.rows import Rows
from track_range.run.options.detection import DetectionOptions
from track_range.run.options.settings import RunSettings
from track_range.run.reports.report import Reports

_OF_NETWORK = [  # options of a detector network, which recorded detections do not need
    name
    for name, field in DetectionOptions.model_fields.items()
    if field.default is None and name not in ("detector", "detections", "ignore", "names")
]


# files by writer whose objects have positions in the frame `map`
_PLACED = {"openscenario": "run.xosc", "osi-gt": "run_gt.osi"}


@dataclass(frozen=True, slots=True)
class OptionsWithoutEffect(Reports):
    """Options that were given but do nothing."""

    settings: RunSettings
    recording: Recording
    has_positions: bool  # whether the recording has telemetry with positions

    def notes(self) -> Sequence[str]:
        """A note on each such option."""
        return (*self._missing_outputs(), *self._unused())

    def _missing_outputs(self) -> Sequence[str]:
        """Notes on requested files that are not possible with the recording."""
        settings, recording = self.settings, self.recording
        notes = []
        if settings.keep_gps and not self.has_positions:
            notes.append(
                "--keep-gps: the recording has no telemetry with positions that can be used."
            )
        if settings.overlay_recorded and not recording.calibration.has_wide_lens:
            notes.append(
                "--overlay-recorded: the calibration has no wide lens, so the overlay shows "
                "the rectified images."
            )
        has_maps = recording.calibrated_rig is not None or bool(settings.depth_model)
        if settings.disparity and not has_maps:
            notes.append("There is no disparity.mp4: dense stereo requires a calibrated pair.")
        if settings.overlay_disparity and not has_maps:
            notes.append(
                "There are no disparities below the overlay: dense stereo requires a calibrated "
                "pair."
            )
        return notes

    def _unused(self) -> Sequence[str]:
        """Notes on options of the input and the detector that are not used."""
        settings, recording = self.settings, self.recording
        notes = []
        if settings.mono is not None and settings.align not in ("auto", "off"):
            notes.append("--align is not used with one camera.")
        is_assumed = recording.rig is not None and recording.rig.is_assumed
        if settings.known_distance and recording.calibration.estimate is None and not is_assumed:
            notes.append(
                "--known-distance is not used: "
                + (
                    "a live source has no pass before the run."
                    if recording.live is not None
                    else "the recording has a calibration."
                )
            )
        if settings.realtime and any(source_of(video).is_live for video in settings.videos):
            notes.append(
                "--realtime has no effect on cameras and streams, which are read in real time "
                "already."
            )
        given = [
            RunSettings.flag(name) for name in _OF_NETWORK if getattr(settings, name) is not None
        ]
        if settings.detections is not None and given:
            verb = "is" if len(given) == 1 else "are"
            notes.append(f"{', '.join(given)} {verb} not used with --detections.")
        return notes


@dataclass(frozen=True, slots=True)
class MissingDepths(Reports):
    """A file of depths without any, at the end of a run."""

    settings: RunSettings
    ranging: RangingStage

    def notes(self) -> Sequence[str]:
        """What would measure the depths of all pixels."""
        if "depth" not in self.settings.write or self.ranging.has_depths:
            return ()
        return (
            "depth.tar has no depths: no method of this run measures all pixels; use a calibrated "
            "pair with sgbm, --stereo-model, --depth-model with a metric network, or a recording "
            "with depth images.",
        )


@dataclass(frozen=True, slots=True)
class MissingPlaces(Reports):
    """Files in the frame `map` of a run without any position in it, at its end."""

    settings: RunSettings
    recorded: Rows

    def notes(self) -> Sequence[str]:
        """What would show where the camera is."""
        files = [file for name, file in _PLACED.items() if name in self.settings.write]
        if not files or np.isfinite(self.recorded["world_x_m"]).any():
            return ()
        return (
            f"{' and '.join(files)}: no road users, since the speed of the camera is not known, or "
            "none was ranged; give --ego-speed, or --static-camera if the camera stands still.",
        )

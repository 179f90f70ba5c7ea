"""RunSession: the state of a run, and the order in which its parts report."""

from collections.abc import Generator, Mapping
from contextlib import AbstractContextManager
from typing import Any

from track_range.pipeline.frame_result import FrameResult
from track_range.pipeline.health import health_of
from track_range.pipeline.throughput import FrameMeter
from track_range.results.counts.counter import LineCounter, anchors_of
from track_range.results.counts.places import parsed_places
from track_range.results.events.finder import EventFinder
from track_range.results.rows.rows import Rows
from track_range.results.table import RunRows, RunTable
from track_range.run.opening import OpenedRun
from track_range.run.origin import Origin, input_hashes
from track_range.run.processing import paced_frames, processed_results
from track_range.run.reports import (
    course,
    findings,
    fixed_camera,
    labels,
    networks,
    options,
    recording,
    report,
    row_figures,
    speed,
    still_boxes,
    visibility,
)


class RunSession:
    """The opened inputs of a run, the rows and events of its finished frames, and its parts that
    report (`run.reports.report`).
    """

    def __init__(self, opened: OpenedRun) -> None:
        settings, reader, stages = opened.settings, opened.recording, opened.pipeline
        self.opened, self.settings, self.recording = opened, settings, reader
        road, is_static = stages.world.road, settings.static_camera
        plane = None if road is None else road.plane
        recorded = reader.calibration.rectifier.recorded_points
        self.rows = RunRows(
            fps=reader.fps,
            table=RunTable(methods=stages.ranging.rangers),
            finder=EventFinder(settings.event_settings, is_off=is_static),
            counter=LineCounter(
                parsed_places(settings.count_line, settings.zone), anchors_of(plane, recorded)
            ),
        )
        self._fixed = fixed_camera.FixedCamera(self.rows, plane, is_static)
        self._paced = paced_frames(settings, reader)
        self.meter = FrameMeter(reader.live or self._paced, every=settings.every)
        self.origin = Origin(opened, input_hashes(opened))
        self.course = course.Course(
            self.rows,
            reader,
            stages.clock,
            wall_s=opened.opening_s,
            names_causes=not settings.anonymize,
        )
        boxes = opened.box_source
        self.findings = findings.Findings(
            None if boxes.prepare is None else boxes.detect, reader.calibrated_rig
        )
        self.visibility = visibility.Visibility()
        self._frames = recording.ProcessedFrames(self.rows, reader, settings.every or 1)
        self._cameras = recording.RecordedCameras(reader, settings, opened.region)
        self._pair = recording.PairReport(reader, stages.ego)
        self._speed = speed.SpeedOrigin(opened.speed, stages.ego, self.rows)
        self._coverage = speed.SpeedCoverage(
            opened.speed, stages.ego, self.rows, reader, settings.start_s
        )
        self._options = options.OptionsWithoutEffect(
            settings, reader, has_positions=opened.speed.track is not None
        )
        self._notes: list[str] | None = None  # of the finished run

    def results(self) -> AbstractContextManager[Generator[FrameResult, None, None]]:
        """Context with the results of all frames, anonymized if requested; its end stops the
        threads.
        """
        return processed_results(self.opened, self._paced)

    @property
    def notes(self) -> list[str]:
        """Messages for the user so far; more may follow during the run."""
        return self._notes_with() if self._notes is None else list(self._notes)

    def _notes_with(self, *of_rows: report.Reports) -> list[str]:
        """Messages of the parts, and of those that need the rows of the finished run."""
        stages = self.opened.pipeline
        parts: list[report.Reports] = [
            self.origin,
            self._cameras,
            self._speed,
            self._options,
            self.course,
            *of_rows,
            *([self._fixed] if of_rows else []),
        ]
        if len(self.rows):  # the methods report what they measured
            parts += [stages.ranging, stages.doubting]
        parts += [stages, report.Packages(), stages.detection, self._coverage, self.meter]
        return self.origin.published(report.notes_of(parts))

    def finish(self, videos: Mapping[str, str]) -> tuple[dict[str, Any], Rows]:
        """Content of summary.json, and the rows with the ground truth; `videos`: file names by
        video ("overlay").
        """
        rows, stages, truth = self.rows, self.opened.pipeline, self.opened.truth
        rows.finish()
        recorded = rows.table.to_rows()
        self._fixed.recorded = recorded
        figures = row_figures.RowFigures.of(rows, recorded, truth)
        is_whole = self.course.stopped_by is None and self.settings.duration_s is None
        seen = report.notes_of([self.visibility])  # the first that is to be known
        others = self._notes_with(
            labels.FrameNumbers(rows, recorded, self.opened.box_source.frames, truth, is_whole),
            self.findings,
            figures,
            options.MissingDepths(self.settings, stages.ranging),
            options.MissingPlaces(self.settings, recorded),
            *(
                ()
                if self.settings.static_camera
                else (still_boxes.StillBoxes(recorded, self.recording.calibration),)
            ),
        )
        self._notes = [*seen, *others]
        facts = {
            "notes": self.notes,
            "health": health_of(self.notes).to_list(),
            "inputs": self.origin.inputs,
            "files": dict(videos),
        }
        parts: tuple[report.Reports, ...] = (
            self._frames,
            self._speed,
            self.course,
            self.meter,
            figures,
            self._cameras,
            self._fixed,
            stages.doubting,
            self._pair,
            stages,
            stages.ranging,
            networks.Networks(stages.ranging, stages.clock, self.rows),
            self.visibility,
            report.Facts(facts),
            self.origin,
        )
        return report.summary_of(parts), figures.with_truth

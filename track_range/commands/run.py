"""The main job: a video in; tracks.csv, mot.txt, overlay, summary and report out."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy.typing as npt
from rich.console import Console

from track_range.commands.ready_model import ready_model
from track_range.foundation.errors import RunStoppedError
from track_range.live_view.view import LiveView
from track_range.overlay.outputs import overlay_picture, pictures, video_format
from track_range.overlay.result_video import ResultVideo
from track_range.ranging.evaluation.truth import read_truth
from track_range.ranging.size_models.curve import load_curves
from track_range.report.page import write_report
from track_range.report.tables import markdown
from track_range.report.truth import with_truth
from track_range.results.csv_file import ResultRows, read_tracks_csv
from track_range.results.output_files import RESULT_NAMES, check_outputs, clear_results, make_folder, write_text
from track_range.results.summary import matched_truth, write_summary
from track_range.run.box_source import open_box_source
from track_range.run.build import open_input, open_pipeline
from track_range.run.interrupts import deaf_to_interrupts, first_interrupt_only, interrupts_put_off
from track_range.run.prefetch import short_switch_interval
from track_range.run.progress import frame_progress, step_progress
from track_range.run.session import RunRecord, found_by, summary_of
from track_range.run.settings import RunSettings, absolute_settings, save_settings
from track_range.run.throughput import FrameMeter
from track_range.terminal_tables import tell_summary


def run(settings: RunSettings, console: Console, view: LiveView | None = None) -> Path:
    """Do the whole job, print the tables, and return the folder of the results; `view` shows it as it goes on.

    A run that is interrupted, or that an input fails in the middle of, finishes its files first.

    Raises:
        RunStoppedError: the user stopped it.
        Exception: the error of an input that cannot be used, a `UserError`.
    """
    with first_interrupt_only():
        try:
            return _run(settings, console, view)
        except KeyboardInterrupt:
            raise RunStoppedError("stopped by the user before any frame was finished.") from None


def _run(settings: RunSettings, console: Console, view: LiveView | None) -> Path:
    results = [settings.out_dir / name for name in RESULT_NAMES]
    check_outputs([settings.table] if settings.table is not None else [], [*_input_files(settings), *results])
    curves = load_curves(settings.curves)
    began_s = time.perf_counter()
    source = open_input(settings, partial(step_progress, console))
    opened_s = time.perf_counter() - began_s  # the first pair is decoded by now
    opened_s -= source.calibration.alignment.look_s if source.calibration.alignment else 0.0
    with closing(source):
        boxes = open_box_source(settings, source.calibration.rectified_boxes, lambda word: ready_model(word, console))
        truth = (
            read_truth(settings.truth, source.camera, source.calibration.left_from_reference_m)
            if settings.truth
            else None
        )
        pipeline = open_pipeline(settings, source, boxes, curves)
        meter = FrameMeter(source.inputs.live)
        this = RunRecord(settings=settings, boxes=boxes, source=source, truth=truth, pipeline=pipeline, meter=meter)
        folder = settings.out_dir
        make_folder(folder)
        clear_results(folder, keep=_input_files(settings))
        told = this.notes
        _tell_notes(console, told)
        save_settings(settings, folder / "settings.yaml", found=found_by(this))
        _work(this, folder, console, view)
        this.wall_s += opened_s
    with deaf_to_interrupts():
        columns = read_tracks_csv(folder / "tracks.csv")
        matched = None if truth is None else matched_truth(columns, truth)
        summary = summary_of(this, columns, matched)
        charted = columns if matched is None else with_truth(columns, matched)
        _tell_notes(console, [note for note in this.notes if note not in told])
        _tell_tables(console, summary)  # before they are written: a full disk may be why the run ended
        _keep(this, summary, charted, folder)
    _tell_files(console, this, folder)
    if isinstance(this.stopped_by, KeyboardInterrupt):
        raise RunStoppedError("stopped by the user; what was finished is kept.")
    if this.stopped_by is not None:
        raise this.stopped_by
    return folder


def _tell_tables(console: Console, summary: dict[str, Any]) -> None:
    with _nobody_may_listen():
        tell_summary(console, summary)


def _tell_files(console: Console, this: RunRecord, folder: Path) -> None:
    videos = "".join(f"{name}.mp4, " for name in pictures(this.settings, this.source))
    names = f"{videos}report.html, tracks.csv, mot.txt, summary.json, settings.yaml"
    with _nobody_may_listen():
        console.print(f"Results in {folder}: {names}", highlight=False, markup=False, soft_wrap=True)


@contextmanager
def _nobody_may_listen() -> Iterator[None]:
    """A closed pipe, a full disk or a terminal without sigma ends the telling, not the run."""
    with suppress(OSError, UnicodeError, SystemExit):  # SystemExit is what Rich makes of a closed pipe
        yield


def _input_files(settings: RunSettings) -> list[Path]:
    """Every file that the run reads."""
    named = (
        *(video for video in (*(settings.stereo or ()), settings.mono) if isinstance(video, Path)),
        settings.rig,
        settings.detections,
        settings.truth,
        settings.curves,
        settings.reid,
    )
    words = (settings.detector, settings.names, settings.align, settings.lanes, settings.ego_speed)
    return [*(path for path in named if path is not None), *(Path(word) for word in words if word is not None)]


def _work(this: RunRecord, folder: Path, console: Console, view: LiveView | None) -> None:
    """Run every frame through the pipeline and write it."""
    began_s = time.perf_counter()
    clock = this.pipeline.clock
    try:
        with ExitStack() as stack:
            stack.enter_context(short_switch_interval())
            rows = stack.enter_context(ResultRows(folder))
            videos = [
                stack.enter_context(
                    ResultVideo(
                        folder / f"{name}.mp4", draw, form=video_format(name, this.settings, this.source), clock=clock
                    )
                )
                for name, draw in pictures(this.settings, this.source, this.meter.words).items()
            ]
            if view is not None:
                _tell_notes(console, [view.begin(overlay_picture(this.settings, this.source, this.meter.words))])
            results = this.pipeline.run(this.source.frames)
            stack.callback(results.close)
            advance = stack.enter_context(frame_progress(console, this.source.n_frames))
            for result in this.meter.watched(results):
                if view is not None:
                    view.offer(result)
                with interrupts_put_off():
                    with clock.stage("write"):
                        rows.write(result)
                    for video in videos:
                        video.write(result)
                    this.count(result)
                advance()
    except (KeyboardInterrupt, Exception) as error:
        if not this.frame_index:
            raise
        this.stopped_by = error
    this.wall_s = time.perf_counter() - began_s
    clock.busy_s["read"] = this.source.inputs.busy_s


def _keep(this: RunRecord, summary: dict[str, Any], columns: dict[str, npt.NDArray[Any]], folder: Path) -> None:
    """Write summary.json and report.html."""
    write_summary(folder / "summary.json", summary)
    if this.settings.table is not None:
        write_text(this.settings.table, markdown(summary))
    settings = {key: value for key, value in absolute_settings(this.settings).items() if value not in ([], {})}
    write_report(folder / "report.html", {**summary, "settings": settings}, columns)


def _tell_notes(console: Console, notes: Sequence[str]) -> None:
    with _nobody_may_listen():
        for note in notes:
            console.print(f"- {note}", style="dim", highlight=False, markup=False)

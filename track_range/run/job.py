"""The main job: a video in; tracks.csv, mot.txt, overlay, summary and report out."""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import Any

from rich.console import Console

from track_range.cli.console import print_summary
from track_range.foundation.errors import RunStoppedError
from track_range.live_view.view import LiveView
from track_range.overlay.outputs import overlay_picture, pictures, video_format
from track_range.overlay.result_video import ResultVideo
from track_range.ranging.evaluation.truth import read_truth
from track_range.ranging.size_models.curve import load_curves
from track_range.report.page import write_report
from track_range.report.tables import markdown
from track_range.results.columns import Columns
from track_range.results.output_files import check_outputs, clear_results, make_folder, write_text
from track_range.results.summary import write_summary
from track_range.results.truth import matched_truth, with_truth
from track_range.results.writers import OpenWriters, result_names
from track_range.run.box_source import open_box_source
from track_range.run.build import open_input, open_pipeline
from track_range.run.interrupts import defer_interrupts, ignore_interrupts, stop_on_interrupt
from track_range.run.prefetch import short_switch_interval
from track_range.run.progress import frame_progress, step_progress
from track_range.run.ready_model import ready_model
from track_range.run.session import RunSession
from track_range.run.settings import RunSettings, absolute_settings, save_settings
from track_range.run.throughput import FrameMeter


def run(settings: RunSettings, console: Console, view: LiveView | None = None) -> Path:
    """Do the whole job, print the tables, and return the folder of the results; `view` shows it as it goes on.

    A run that is interrupted, or that an input fails in the middle of, finishes its files first.

    Raises:
        RunStoppedError: the user stopped it.
        Exception: the error of an input that cannot be used, a `UserError`.
    """
    with stop_on_interrupt():
        try:
            return _run(settings, console, view)
        except KeyboardInterrupt:
            raise RunStoppedError("stopped by the user before any frame was finished.") from None


def _run(settings: RunSettings, console: Console, view: LiveView | None) -> Path:
    results = [settings.out_dir / name for name in result_names()]
    check_outputs([settings.table] if settings.table is not None else [], [*_input_files(settings), *results])
    curves = load_curves(settings.curves)
    began_s = time.perf_counter()
    source = open_input(settings, partial(step_progress, console))
    opened_s = time.perf_counter() - began_s  # the first pair is decoded by now
    calibration = source.calibration
    opened_s -= calibration.alignment.look_s if calibration.alignment else 0.0
    with ExitStack() as outputs:
        with closing(source):
            boxes = open_box_source(settings, calibration.rectified_boxes, lambda word: ready_model(word, console))
            truth = (
                read_truth(settings.truth, source.camera, calibration.left_from_reference_m) if settings.truth else None
            )
            pipeline = open_pipeline(settings, source, boxes, curves)
            meter = FrameMeter(source.inputs.live)
            session = RunSession(
                settings=settings, boxes=boxes, source=source, truth=truth, pipeline=pipeline, meter=meter
            )
            outputs.enter_context(session.table)
            folder = settings.out_dir
            make_folder(folder)
            clear_results(folder, result_names(), keep=_input_files(settings))
            printed_notes = session.notes
            _print_notes(console, printed_notes)
            save_settings(settings, folder / "settings.yaml", found=session.found())
            writers = outputs.enter_context(OpenWriters(settings.write, session.info, folder))
            _process_frames(session, writers, folder, console, view)
            session.wall_s += opened_s
        with ignore_interrupts():
            columns = session.table.to_columns()
            matched = None if truth is None else matched_truth(columns, truth)
            summary = session.summary(columns, matched)
            _print_notes(console, [note for note in session.notes if note not in printed_notes])
            _print_tables(console, summary)  # before they are written: a full disk may be why the run ended
            try:
                _write_outputs(session, summary, columns if matched is None else with_truth(columns, matched), folder)
            finally:
                writers.close(summary)
    _print_files(console, session, writers.files, folder)
    if isinstance(session.stopped_by, KeyboardInterrupt):
        raise RunStoppedError("stopped by the user; what was finished is kept.")
    if session.stopped_by is not None:
        raise session.stopped_by
    return folder


def _print_tables(console: Console, summary: dict[str, Any]) -> None:
    with _ignore_broken_pipe():
        print_summary(console, summary)


def _print_files(console: Console, session: RunSession, files: Sequence[str], folder: Path) -> None:
    videos = [f"{name}.mp4" for name in pictures(session.settings, session.source)]
    names = ", ".join([*videos, "report.html", *files, "summary.json", "settings.yaml"])
    with _ignore_broken_pipe():
        console.print(f"Results in {folder}: {names}", highlight=False, markup=False, soft_wrap=True)


@contextmanager
def _ignore_broken_pipe() -> Iterator[None]:
    """A closed pipe, a full disk or a terminal without the character sigma ends the printing, not the run."""
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


def _process_frames(
    session: RunSession, writers: OpenWriters, folder: Path, console: Console, view: LiveView | None
) -> None:
    """Run every frame through the pipeline and write it."""
    began_s = time.perf_counter()
    settings, source, clock = session.settings, session.source, session.pipeline.clock
    captions = session.meter.captions
    try:
        with ExitStack() as stack:
            stack.enter_context(short_switch_interval())
            videos = [
                stack.enter_context(
                    ResultVideo(folder / f"{name}.mp4", draw, form=video_format(name, settings, source), clock=clock)
                )
                for name, draw in pictures(settings, source, captions).items()
            ]
            if view is not None:
                _print_notes(console, [view.begin(overlay_picture(settings, source, captions))])
            results = session.pipeline.run(source.frames)
            stack.callback(results.close)
            advance = stack.enter_context(frame_progress(console, source.n_frames))
            for result in results:
                session.meter.add(result)
                if view is not None:
                    view.offer(result)
                with defer_interrupts():
                    with clock.stage("write"):
                        writers.write(result)
                    for video in videos:
                        video.write(result)
                    session.add(result)
                advance()
    except (KeyboardInterrupt, Exception) as error:
        if not session.frame_index:
            raise
        session.stopped_by = error
    session.wall_s = time.perf_counter() - began_s
    clock.busy_s["read"] = source.inputs.busy_s


def _write_outputs(session: RunSession, summary: dict[str, Any], columns: Columns, folder: Path) -> None:
    """Write summary.json, report.html and the tables in Markdown."""
    write_summary(folder / "summary.json", summary)
    if session.settings.table is not None:
        write_text(session.settings.table, markdown(summary))
    settings = {key: value for key, value in absolute_settings(session.settings).items() if value not in ([], {})}
    write_report(folder / "report.html", {**summary, "settings": settings}, columns)


def _print_notes(console: Console, notes: Sequence[str]) -> None:
    with _ignore_broken_pipe():
        for note in notes:
            console.print(f"- {note}", style="dim", highlight=False, markup=False)

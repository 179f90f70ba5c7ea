"""`track-range fit`: size curves from KITTI tracking labels."""

from __future__ import annotations

from pathlib import Path

from rich.console import Console
from rich.table import Table

from detection.kitti_format import LabelFileError, read_kitti
from ranging.size_curve import SizeCurves
from ranging.size_curve_fit import SizeSamples, fit_curves, samples_of_kitti
from stereo.rig_files import left_from_reference_m, load_camera


def fit_curves_of_kitti(
    labels: Path, calib: Path, out: Path, *, console: Console, leave_out: str = "", source: str = ""
) -> None:
    """Fit on every sequence in `labels` but those left out, write `out`, and print the curves.

    Raises:
        LabelFileError, RigError, CurveError: labels, calibration, or too few of them.
    """
    excluded = {name.strip() for name in leave_out.split(",") if name.strip()}
    all_files = sorted(labels.glob("*.txt"))
    unknown = excluded - {file.stem for file in all_files}
    if unknown:  # a slip here would fit on what is kept for testing
        raise LabelFileError(f"{labels}: no sequence {', '.join(sorted(unknown))} to leave out.")
    files = [file for file in all_files if file.stem not in excluded]
    if not files:
        raise LabelFileError(f"{labels}: no label files such as 0000.txt.")
    samples = SizeSamples.joined([_samples(file, calib / file.name, number) for number, file in enumerate(files)])
    names = ", ".join(file.stem for file in files)
    curves = fit_curves(samples, source=f"{source or labels.name}, sequences {names}")
    curves.save(out)
    console.print(_table(curves))
    console.print(f"Written to {out}", highlight=False)


def _samples(labels: Path, calib: Path, sequence: int) -> SizeSamples:
    camera, _ = load_camera(calib, size_px=None)
    shift_m = left_from_reference_m(calib, is_grey=False)
    return samples_of_kitti(read_kitti(labels), camera, shift_m, sequence=sequence)


def _table(curves: SizeCurves) -> Table:
    table = Table("class", "intercept", "log height", "log width", "bearing", "sigma", "boxes", title="Size curves")
    for name, curve in curves.whole.items():
        table.add_row(
            name, *(f"{value:.3f}" for value in curve.coefficients), f"{100 * curve.sigma_relative:.1f} %", str(curve.n)
        )
    return table

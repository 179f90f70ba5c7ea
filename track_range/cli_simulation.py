"""The command `simulate` as the command line shows it: drives for two eyes, or labelled images to train with."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from rich.console import Console

from track_range.simulation.world.scenario_names import SCENARIO_NAMES

_console = Console()
_WHAT, _WRITTEN, _FAULTS = "What is driven", "What is written", "What is wrong with the cameras (default: nothing)"


def simulate(
    out: Annotated[Path, typer.Option(metavar="DIR", help="Where the files go.")],
    scenario: Annotated[
        str | None,
        typer.Option(metavar="NAME", help=f"{', '.join(SCENARIO_NAMES)} (default: city).", rich_help_panel=_WHAT),
    ] = None,
    seconds: Annotated[
        float | None, typer.Option(metavar="S", help="Length of the drive (default: 10).", rich_help_panel=_WHAT)
    ] = None,
    fps: Annotated[
        float | None,
        typer.Option(min=1, max=120, help="Frames per second (default: 10).", rich_help_panel=_WHAT),
    ] = None,
    seed: Annotated[
        int | None,
        typer.Option(
            min=0,
            max=2**31,
            help="Another seed is another drive (default: 0; of images: the first scene, 1000).",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    rig: Annotated[
        Path | None,
        typer.Option(
            help="A rectified pair to draw for: rig.yaml or calib.txt (default: KITTI's angle of view, 1240 x 376).",
            rich_help_panel=_WHAT,
        ),
    ] = None,
    is_lossless: Annotated[
        bool,
        typer.Option("--lossless", help="Folders of PNGs, left/ and right/, not H.264.", rich_help_panel=_WRITTEN),
    ] = False,
    has_disparity: Annotated[
        bool,
        typer.Option(
            "--disparity",
            help="True disparities too, as KITTI 2015 has them: image_2/, image_3/, disp_occ_0/ and obj_map/.",
            rich_help_panel=_WRITTEN,
        ),
    ] = False,
    images: Annotated[
        int | None,
        typer.Option(
            min=1,
            max=1_000_000,
            metavar="N",
            help="In place of a drive, N labelled images to train with: images/, labels/, data.yaml.",
            rich_help_panel=_WRITTEN,
        ),
    ] = None,
    frames: Annotated[
        int, typer.Option(min=1, max=1000, help="Of --images: how many of each scene.", rich_help_panel=_WRITTEN)
    ] = 6,
    noise: Annotated[
        float | None,
        typer.Option(min=0, max=40, metavar="GREY", help="Sensor noise (default: 2).", rich_help_panel=_FAULTS),
    ] = None,
    gain: Annotated[
        float | None,
        typer.Option(min=0.1, max=4, help="Brightness of the right eye to the left one's.", rich_help_panel=_FAULTS),
    ] = None,
    blur: Annotated[
        float | None, typer.Option(min=0, max=20, metavar="PX", help="Blur of both eyes.", rich_help_panel=_FAULTS)
    ] = None,
    rain: Annotated[
        float | None, typer.Option(min=0, max=1, metavar="0..1", help="Streaks of rain.", rich_help_panel=_FAULTS)
    ] = None,
    row_offset: Annotated[
        float | None,
        typer.Option(min=-20, max=20, metavar="PX", help="The right image lies lower.", rich_help_panel=_FAULTS),
    ] = None,
    disparity_offset: Annotated[
        float | None,
        typer.Option(
            min=-20, max=20, metavar="PX", help="Disparities are larger than they should be.", rich_help_panel=_FAULTS
        ),
    ] = None,
    drop_frames: Annotated[
        float | None,
        typer.Option(min=0, max=0.9, metavar="SHARE", help="Frames lost by each eye.", rich_help_panel=_FAULTS),
    ] = None,
    late: Annotated[
        float | None,
        typer.Option(
            min=-1,
            max=1,
            metavar="S",
            help="The right eye opens later than its times tell, or its recording began later.",
            rich_help_panel=_FAULTS,
        ),
    ] = None,
    wrong_rig: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="rig.yaml with an error: baseline (5 % too long), focal (4 % too long), principal (15 px off).",
            rich_help_panel=_FAULTS,
        ),
    ] = None,
) -> None:
    """Simulate a drive for two eyes with exact truth, or labelled images to train a detector with."""
    from track_range.commands.simulate import SimulateOptions
    from track_range.commands.simulate import simulate as run

    faults = {
        "gain": gain,
        "blur_px": blur,
        "rain": rain,
        "row_offset_px": row_offset,
        "disparity_offset_px": disparity_offset,
        "drop_share": drop_frames,
        "late_s": late,
        "wrong_rig": wrong_rig,
    }
    run(
        SimulateOptions(
            out=out,
            scenario=scenario,
            seconds=seconds,
            fps=fps,
            seed=seed,
            rig=rig,
            is_lossless=is_lossless,
            has_disparity=has_disparity,
            n_images=images,
            n_frames=frames,
            noise_grey=noise,
            faults={name: value for name, value in faults.items() if value is not None},
        ),
        _console,
    )

"""`track-range simulate`: a stereo drive with exact ground truth, or labelled images to train
detectors.
"""

from contextlib import nullcontext
from functools import partial

from track_range.cli.shared.console import console, print_line
from track_range.cli.shared.parameters import command
from track_range.foundation.files.input_files import counted
from track_range.foundation.processes import one_opencv_thread
from track_range.run.progress import step_progress
from track_range.simulation.settings import SimulationSettings
from track_range.simulation.simulate import DEFAULT_FPS, simulate


def _simulate(settings: SimulationSettings) -> None:
    # the frames of a drive are rendered in several threads, with which OpenCV's would compete
    with one_opencv_thread() if settings.images is None else nullcontext():
        simulated = simulate(settings, partial(step_progress, console))
    print_line(console, *simulated.notes)
    drive = simulated.drive
    if drive is None:
        print_line(
            console, f"Written: {counted(simulated.n_images, 'image')}, and {simulated.data_yaml}"
        )
        return
    fps = settings.fps or DEFAULT_FPS
    rate = f" --fps {fps:g}" if drive.left.suffix != ".mp4" and fps != DEFAULT_FPS else ""
    pair = f"{drive.left} {drive.right}"
    if settings.stereo_layout is not None:
        pair = f"{drive.left} --stereo-layout {settings.stereo_layout}"
    command = f"track-range --stereo {pair} --rig {drive.rig} --truth {drive.table}{rate}"
    print_line(console, f"Written: {settings.out}. To process the drive:", f"  {command}")


app = command(SimulationSettings, _simulate)

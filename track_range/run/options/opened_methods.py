"""The ranging methods of a run as its options choose them."""

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from track_range.detection.models.onnx_session import ModelError, Runtime
from track_range.foundation.errors import UserError
from track_range.pipeline.ranging import RangingStage
from track_range.ranging.methods.method import (
    MethodContext,
    MethodError,
    RangingMethod,
    Requirement,
)
from track_range.ranging.networks.network import open_depth_network, open_stereo_network
from track_range.ranging.registry import NETWORK_METHODS, create_rangers, methods, methods_of_run
from track_range.run.options.methods import RunMethodOptions
from track_range.run.options.opened import DetectorOptions, open_detector

# what a run lacks, and the options that give it
_LACKS: Mapping[Requirement, str] = {
    "image": "images, found boxes alone",
    "rig": "a pair with a calibration (--stereo LEFT RIGHT with --rig FILE), found none",
    "right_image": "two cameras (--stereo LEFT RIGHT), found one",
    "dense_disparity": "dense stereo, found --no-sgbm",
    "lane_lines": "lane lines, found --lanes off, or a view that does not look along the drive",
    "camera_height": "the height of the camera (--camera-height-m), found none",
    "recorded_depth": "a bag with depth of the images (RealSense, OAK, ZED), found none",
}


def open_methods(options: RunMethodOptions, context: MethodContext) -> RangingStage:
    """The methods of a run that the options choose and the context allows.

    Raises MethodError: a method that is asked for cannot measure here, or none is left to fuse; the
    errors of opening networks.
    """
    networks = [name for kind in options.networks.values() for name in kind]
    listed = methods_of_run(options.methods, networks, options.show_only)
    asked_for = options.asked_for
    for method in listed:
        if method.name in asked_for:
            _check_measurable(method, context, networks)
    with _named_detectors(options):
        rangers = create_rangers(context, listed)
    shown_only = {method.name for method in listed if not method.fuses}
    if options.show_only and shown_only >= rangers.keys():
        raise MethodError(
            "--show-only: expected a method that is left for the fused distance, found none; name "
            f"fewer than all methods of this run ({', '.join(rangers)})."
        )
    return RangingStage(rangers, shown_only=frozenset(shown_only & rangers.keys()))


def check_networks(options: RunMethodOptions) -> None:
    """Open the networks of a run; raises the error of one that cannot be used."""
    runtime = Runtime(device="cpu")
    with _named_detectors(options):
        for path in options.depth_model:
            open_depth_network(path, runtime)
        for path in options.stereo_model:
            open_stereo_network(path, runtime)


@contextmanager
def _named_detectors(options: RunMethodOptions) -> Iterator[None]:
    """The error of a network that is a detector, with the option for it."""
    try:
        yield
    except ModelError as error:
        given = {"--depth-model": options.depth_model, "--stereo-model": options.stereo_model}
        for flag, path in ((flag, path) for flag, paths in given.items() for path in paths):
            if _is_detector(path):
                raise ModelError(
                    f"{path}: expected a network that measures for {flag}, found a "
                    "detector; give it "
                    "by --detector."
                ) from error
        raise


def _is_detector(path: Path) -> bool:
    try:
        open_detector(path, DetectorOptions(device="cpu"))
    except UserError:
        return False
    return True


def _check_measurable(
    method: RangingMethod, context: MethodContext, networks: Collection[str]
) -> None:
    if method.name in NETWORK_METHODS and method.name not in networks:
        raise MethodError(
            f"ranging method {method.name}: expected its network (--depth-model or "
            "--stereo-model), "
            f"found {', '.join(networks) or 'none'}; give the file, or leave the method out."
        )
    for need in sorted(method.needs - context.available):
        raise MethodError(
            f"ranging method {method.name}: expected {_LACKS.get(need, need)}; give it, "
            "or leave the "
            "method out of this run."
        )


def fused_methods(ranging: RangingStage) -> list[RangingMethod]:
    """The methods of the error model of fusion: optional ones only if they are fused in this run.

    Those that all runs know stay in it, also where they are not measured: correlations depend on
    the methods of the model, and the distances of the others would change.
    """
    fused = ranging.rangers.keys() - ranging.shown_only
    return [*methods(fused)]


def left_out(options: RunMethodOptions, ranging: RangingStage) -> Iterator[str]:
    """A sentence for each method that is asked for and does not measure in this run."""
    for name in sorted(options.asked_for - ranging.rangers.keys()):
        yield f"The ranging method {name} does not measure in this run: its input is missing."

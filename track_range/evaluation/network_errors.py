"""Measurement of the errors of a depth network on labelled sequences with images."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.models.onnx_session import Runtime
from track_range.evaluation.range_evaluation import SequenceImages
from track_range.foundation.files.output_files import write_text
from track_range.foundation.files.structured_text import read_yaml, yaml_text
from track_range.foundation.progress import StepProgress, no_progress
from track_range.ranging.evaluation.image_methods import MethodInputs, image_columns
from track_range.ranging.fitting.network_fit import FittedNetwork, fit_network
from track_range.ranging.methods.method import MethodContext, Ranger
from track_range.ranging.methods.network_depth import DEPTH, OwnDistances
from track_range.ranging.networks.network import DepthNetwork, open_depth_network
from track_range.ranging.networks.network_format import NetworkError
from track_range.ranging.networks.recognition import settings_file
from track_range.ranging.truth.labelled_boxes import box_set


def fit_depth_model(
    model: Path,
    labels: Path,
    calib: Path,
    images: Path,
    *,
    leave_out: tuple[str, ...] = (),
    runtime: Runtime | None = None,
    progress: StepProgress = no_progress,
) -> tuple[DepthNetwork, FittedNetwork]:
    """The network and its errors on KITTI tracking labels, without the sequences to leave out.

    Raises NetworkError or ModelError: the network cannot be used; LabelFileError, RigError,
    LabelledImageError: labels, calibration or images cannot be used, or show too little.
    """
    network = open_depth_network(model, runtime)
    boxes = box_set(labels, calib)
    known = np.array([name not in leave_out for name in boxes.sequence_names])
    if unknown := sorted(set(leave_out) - {"", *boxes.sequence_names}):
        raise LabelFileError(f"{labels}: --leave-out names unknown sequences: {unknown[0]}.")
    boxes = boxes.select(known[boxes.sequence])

    def create(context: MethodContext) -> Ranger:
        return OwnDistances(DEPTH.name, network, context.camera)

    is_one = labels.is_file()
    of_sequences = SequenceImages(images, None, calib=calib, align="off", is_one=is_one)
    context = MethodContext(camera=boxes.camera_at(0), runtime=runtime)
    columns = image_columns(
        boxes,
        [replace(DEPTH, create=create, reads=(), fallback_for=None)],
        MethodInputs(images=of_sequences, depth_models={DEPTH.name: model}, progress=progress),
        context,
        chosen=(DEPTH.name,),
    )
    used = ", ".join(boxes.sequence_names[k] for k in np.unique(boxes.sequence))
    fitted = fit_network(boxes, columns[DEPTH.name], source=f"{labels.name}, sequences {used}")
    if fitted is None:
        raise LabelFileError(
            f"{labels}: expected a sequence of which {model.name} measures 20 boxes of at least 3 "
            f"objects, found none in {len(boxes)} boxes."
        )
    return network, fitted


def write_errors(network: DepthNetwork, fitted: FittedNetwork, out: Path | None = None) -> Path:
    """Write the errors to the MODEL.yaml of a network, or another file of its format; returns
    it.
    """
    own, errors = settings_file(network.path), fitted.errors.model_dump(exclude_none=True)
    content: Any = network.format.model_dump(mode="json", exclude_defaults=True)
    if own.is_file():
        content = read_yaml(own, NetworkError, f"the format of {network.path.name}")
    out = out or own
    write_text(out, yaml_text({**content, "errors": errors}, default_flow_style=None))
    return out

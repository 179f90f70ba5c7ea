"""The formats of networks that are known by name: one row for each, and `MODEL.yaml` names one.

The source of each row is in docs/how-to/networks.md. A further format is one more row here.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from track_range.detection.yolo.input_format import IMAGENET_MEAN, IMAGENET_STD
from track_range.ranging.networks.network_format import NetworkFormat


@dataclass(frozen=True, slots=True)
class KnownFormat:
    """A format by name, and the files that have it.

    Attributes:
        title: the project, for display and documentation.
        names: names of inputs and of outputs in its exports, "INPUTS -> OUTPUTS", which other
            formats may have as well; a file is recognised by those of one format alone. Inputs are
            in the file's order, with [HEIGHTxWIDTH] where only these sizes are known.
        format: what it takes and gives; None = `refusal` says why it cannot be used.
    """

    title: str
    names: tuple[str, ...]
    format: NetworkFormat | None
    refusal: str = ""


def _row(title: str, *names: str, **values: Any) -> KnownFormat:
    return KnownFormat(title, names, NetworkFormat(**values))


_IMAGENET: Mapping[str, Any] = {"mean": IMAGENET_MEAN, "std": IMAGENET_STD}
_HALVES: Mapping[str, Any] = {"mean": (0.5, 0.5, 0.5), "std": (0.5, 0.5, 0.5)}
_RAW: Mapping[str, Any] = {"divisor": 1.0}  # the network normalises pixels of 0 to 255 itself
# DINOv2: patches of 14 px; trained with about this number of pixels
_VIT: Mapping[str, Any] = {"task": "depth", "multiple": 14, "area": 518**2, **_IMAGENET}
_UNIDEPTH: Mapping[str, Any] = {**_VIT, "area": 462 * 630}
_METRIC3D: Mapping[str, Any] = {
    "task": "depth",
    "gives": "depth",
    "focal_px": 1000.0,
    "fit": "letterbox",
    "multiple": 14,
    "area": 616 * 1064,
    **_RAW,
}
_MOGE: Mapping[str, Any] = {
    "task": "depth",
    "gives": "points",
    "affine_points": True,
    "area": 400_000,
    "output": "points",
    "factor": "metric_scale",
    "mask": "mask",
}
_DPT: Mapping[str, Any] = {"task": "depth", "multiple": 32, "area": 384**2}
_RELATIVE: Mapping[str, Any] = {"gives": "inverse_depth", "metric": False}
_STEREO: Mapping[str, Any] = {"task": "stereo", "gives": "disparity", "fit": "pad", "multiple": 32}
_TRANSFORMERS = "pixel_values -> predicted_depth"
# names that exports of several projects have
_PAIR = ("left right -> disp", "left right -> disparity", "left right -> output")
_PLAIN = ("image -> depth", "input -> output", "input -> depth", _TRANSFORMERS)

FORMATS: Mapping[str, KnownFormat] = {
    "depth-anything": _row("Depth Anything 1, 2, relative", *_PLAIN, **_VIT, **_RELATIVE),
    "depth-anything-2-metric": _row("Depth Anything 2, metric", *_PLAIN, **_VIT, gives="depth"),
    "depth-anything-3": _row(
        "Depth Anything 3, relative", *_PLAIN, **_VIT, gives="depth", metric=False
    ),
    "depth-anything-3-metric": _row(
        *("Depth Anything 3, metric", "image -> depth sky", "input -> depth sky"),
        **{**_VIT, "gives": "depth", "focal_px": 300.0, "fit": "letterbox", "output": "depth"},
    ),
    "unidepth-2": _row(
        *("UniDepth 2", "rgbs -> pts_3d confidence intrinsics"),
        **{**_UNIDEPTH, "gives": "points", "output": "pts_3d"},
    ),
    "unidepth-2-rays": _row(
        *("UniDepth 2, --with-camera", "rgbs rays -> pts_3d confidence intrinsics"),
        **{**_UNIDEPTH, "gives": "points", "output": "pts_3d", "inputs": ("image", "rays")},
    ),
    "unidepth-2-first": _row(
        *("UniDepth 2, first export", "image -> out_K depth depth_ssi confidence"),
        **{**_UNIDEPTH, "gives": "depth", "output": "depth"},
    ),
    "unidepth-2-first-camera": _row(
        "UniDepth 2, first export, --with-camera",
        "image K -> out_K depth depth_ssi confidence",
        **{**_UNIDEPTH, "gives": "depth", "output": "depth", "inputs": ("image", "intrinsics")},
    ),
    "metric3d": _row(
        "Metric3D 1, 2",
        "image[616x1064] -> pred_depth",
        "image[544x1216] -> pred_depth",
        **_METRIC3D,
    ),
    "metric3d-transformers": _row(
        "Metric3D 2 of onnx-community",
        "pixel_values -> predicted_depth predicted_normal normal_confidence",
        **{**_METRIC3D, "output": "predicted_depth"},
    ),
    "depth-pro": _row(
        *("Depth Pro of transformers", "pixel_values -> predicted_depth field_of_view"),
        **{"task": "depth", "gives": "inverse_depth", "output": "predicted_depth", **_HALVES},
        size=(1536, 1536),
        focal_px=1536.0,
    ),
    "depth-pro-metres": _row(
        *("Depth Pro of onnx-community", "pixel_values -> predicted_depth focallength_px"),
        **{"task": "depth", "gives": "depth", "output": "predicted_depth", **_HALVES},
        size=(1536, 1536),
    ),
    "moge-2": _row(
        *("MoGe 2", "image num_tokens -> points normal mask metric_scale"),
        "image num_tokens -> points mask metric_scale",
        **{**_MOGE, "inputs": ("image", 1800)},
    ),
    "moge-2-fixed": _row(
        *("MoGe 2, fixed number of tokens", "image -> points normal mask metric_scale"),
        "image -> points mask metric_scale",
        **_MOGE,
    ),
    "zoedepth": _row("ZoeDepth", *_PLAIN, **{**_DPT, **_HALVES, "area": 384 * 512}, gives="depth"),
    "dpt": _row("DPT, MiDaS 3", *_PLAIN, **_DPT, **_HALVES, **_RELATIVE),
    "midas": _row("MiDaS 2", "0 -> 797", **_DPT, **_IMAGENET, **_RELATIVE),
    "foundation-stereo": _row("FoundationStereo, Fast-FoundationStereo", *_PAIR, **_STEREO, **_RAW),
    "fast-foundation-stereo-parts": KnownFormat(
        "Fast-FoundationStereo in two files",
        (
            "left right -> features_left_04 features_left_08 features_left_16 features_left_32 "
            "features_right_04 stem_2x",
            "features_left_04 features_left_08 features_left_16 features_left_32 features_right_04 "
            "stem_2x gwc_volume -> disp",
        ),
        None,
        "half of a network; export it as one file (option single_onnx of make_onnx.py)",
    ),
    "s2m2": _row(
        *("S2M2", "input_left input_right -> output_disp output_occ output_conf"),
        **{**_STEREO, **_RAW, "output": "output_disp", "confidence": "output_conf"},
    ),
    "igev": _row("IGEV, IGEV++", *_PAIR, **_STEREO, **_RAW),
    "raft-stereo": _row(
        *("RAFT-Stereo", "left right -> disparity upscaled_disparity"),
        **{**_STEREO, **_RAW, "output": "upscaled_disparity", "scale": -1.0},
    ),
    "crestereo": _row("CREStereo, one pass", *_PAIR, **_STEREO, **_RAW),
    "crestereo-combined": _row(
        *("CREStereo, two passes", "init_left init_right next_left next_right -> next_output"),
        **{**_STEREO, **_RAW, "inputs": ("left/2", "right/2", "left", "right")},
    ),
    "crestereo-second-pass": KnownFormat(
        "CREStereo with a first flow",
        ("left right flow_init -> output", "left right flow_init -> disp"),
        None,
        "the second pass of a network, which needs the flow of the first; export both passes as "
        "one file or without flow_init",
    ),
    "hitnet": _row(
        *("HITNet", "input -> reference_output_disparity"),
        "input -> reference_output_disparity secondary_output_disparity",
        **{**_STEREO, "output": "reference_output_disparity"},
    ),
    "psmnet": _row("PSMNet", *_PAIR, **_STEREO, **_IMAGENET),
    "stereo-matching": _row(
        "exports of the package stereo-matching",
        "left_values right_values -> disparity",
        **{**_STEREO, **_IMAGENET},
    ),
}

"""The output layouts, and the readings of a network's outputs: decoder, input format and
class names.

`dense_layouts` has the layouts of networks without suppression; `end_to_end` has the layouts of
networks that return one box per object. Shapes, metadata and the number of class names determine
which readings are possible; `first_images` chooses between them by the values. The family's other
defaults can be overridden (`detection.yolo.metadata`).
"""

from dataclasses import replace
from pathlib import Path

from track_range.detection.box_errors import COCO_BOX_ERRORS
from track_range.detection.classes import COCO_CATEGORIES, COCO_CLASSES, VOC_CLASSES
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.input_format import placement_and_grey
from track_range.detection.yolo.metadata import Attribute, ModelMetadata
from track_range.detection.yolo.network_outputs import DetectorLayout, NetworkOutputs, YoloModel
from track_range.foundation.files.input_files import quoted, shortened
from track_range.foundation.registry import Registry

_DEFAULT_NAMES = {
    80: ("COCO", COCO_CLASSES),
    20: ("VOC", VOC_CLASSES),
    91: ("COCO", COCO_CATEGORIES),
}
"""Class list by number of classes, for networks without class names."""
_EXPORT_HINT = "export with batch size 1 and without postprocessing (docs/how-to/detectors.md)"


DETECTOR_LAYOUTS = Registry(
    "track_range.detector_layouts",
    {
        "queries": "track_range.detection.yolo.end_to_end:LOGITS_AND_BOXES",
        "d-fine": "track_range.detection.yolo.end_to_end:LABELS_BOXES_SCORES",
        "pairs": "track_range.detection.yolo.dense_layouts:PAIRS",
        "grids": "track_range.detection.yolo.dense_layouts:GRIDS",
        "levels": "track_range.detection.yolo.dense_layouts:LEVELS",
        "labelled-queries": "track_range.detection.yolo.end_to_end:LABELLED_QUERIES",
        "labelled-rows": "track_range.detection.yolo.end_to_end:LABELLED_ROWS",
        "query-rows": "track_range.detection.yolo.end_to_end:QUERY_ROWS",
        "fastest": "track_range.detection.yolo.dense_layouts:FASTEST_HEADS",
        "anchors": "track_range.detection.yolo.dense_layouts:ANCHOR_HEADS",
    },
    DetectorLayout,
    error=ModelError,
)


def readings_of(network: NetworkOutputs) -> tuple[YoloModel, ...]:
    """The possible meanings of a network's outputs in the first layout that fits, the usual meaning
    first.

    ModelError: no layout fits, or the model's attributes do not fit.
    """
    requested = network.metadata.get("layout", None, "").value
    known = [name for layout in DETECTOR_LAYOUTS.usable.values() for name in layout.names]
    if requested is not None and requested not in known:
        raise ModelError(
            f"{network.path}: unknown layout {quoted(requested)} (--layout); the layouts are "
            f"{', '.join(known)}."
        )
    refused: ModelError | None = None
    answers = DETECTOR_LAYOUTS.answers(
        lambda layout: (
            _readings_in(layout, network, requested)
            if requested is None or requested in layout.names
            else ([], None)
        )
    )
    for _, (readings, error) in answers:
        refused = refused or error
        if readings:
            return tuple(readings)
    raise refused or _unknown(network, requested)


def _readings_in(
    layout: DetectorLayout, network: NetworkOutputs, requested: str | None
) -> tuple[list[YoloModel], ModelError | None]:
    """The readings in one layout, and why the first of those that are refused does not fit the
    model's attributes.
    """
    readings = []
    refused: ModelError | None = None
    for model in layout.readings(network):
        if requested not in (None, model.name):
            continue
        try:
            readings.append(_with_attributes(network, model))
        except ModelError as error:
            refused = refused or error
    return readings, refused


def _unknown(network: NetworkOutputs, requested: str | None) -> ModelError:
    """The error for outputs that fit no layout, or not the requested one."""
    outputs = zip(network.names, network.shapes, strict=True)
    listed = shortened(", ".join(f"{name} {list(shape)}" for name, shape in outputs), 80)
    if requested is not None:
        return ModelError(
            f"{network.path}: expected outputs of the layout {requested} (--layout), found {listed}."
        )
    families = ", ".join(dict.fromkeys(layout.title for layout in DETECTOR_LAYOUTS.usable.values()))
    return ModelError(
        f"{network.path}: expected the outputs of {families}, found {listed}; {_EXPORT_HINT}."
    )


def _with_attributes(network: NetworkOutputs, model: YoloModel) -> YoloModel:
    """A reading with the explicit attributes of the model; ModelError if the class names do not
    fit.
    """
    metadata = network.metadata
    family = metadata.get("family", model.family, "from its outputs")
    used = {"family": family, "names": _names(network.path, model.n_classes, metadata)}
    usual_input = model.input_format
    if network.has_integer_input:  # pixels as they are; the network scales them
        usual_input = replace(usual_input, divisor=1.0, mean=(0.0,) * 3, std=(1.0,) * 3)
    for key in ("letterbox", "colours", "divisor", "mean", "std"):
        used[key] = metadata.get(key, getattr(usual_input, key), f"default of {model.family}")
    usual, source = None, "default for an unknown detector"
    if used["names"].value == COCO_CLASSES and model.family in COCO_BOX_ERRORS:
        usual = COCO_BOX_ERRORS[model.family]
        source = f"usual for {model.family} trained with COCO"
    used["box_errors"] = metadata.get("box_errors", usual, source)
    placement, pad_grey = placement_and_grey(used["letterbox"].value)
    scale = {key: used[key].value for key in ("colours", "divisor", "mean", "std")}
    return replace(
        model,
        family=str(family.value),
        names=used["names"].value,
        input_format=replace(usual_input, placement=placement, pad_grey=pad_grey, **scale),
        attributes={**used, **model.attributes},
    )


def _names(path: Path, n_classes: int | None, metadata: ModelMetadata) -> Attribute:
    """The network's class names: explicit, or the names of COCO or VOC if the number of classes
    matches.
    """
    explicit = metadata.get("names", None, "")
    if n_classes is None:
        return metadata.get("names", COCO_CLASSES, "not in the model; COCO's names are assumed")
    if explicit.value is None:
        if n_classes not in _DEFAULT_NAMES:
            raise ModelError(
                f"{path}: the {n_classes} classes have no names; specify them with --names a,b,c "
                "or --names FILE."
            )
        list_name, names = _DEFAULT_NAMES[n_classes]
        return Attribute(names, f"not in the model; {list_name} has the same number, {n_classes}")
    if len(explicit.value) != n_classes:
        raise ModelError(
            f"{path}: expected {n_classes} class names, got {len(explicit.value)} "
            f"({explicit.source}); specify all names in the network's order."
        )
    return explicit

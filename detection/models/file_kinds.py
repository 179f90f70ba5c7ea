"""Files that are given as a detector and are no ONNX network: their kind, and what to do."""

from pathlib import Path

_HEAD_BYTES = 512
_ULTRALYTICS = (
    "`yolo export model={name} format=onnx` (Ultralytics), or the ONNX exporter of its project"
)
_KINDS: tuple[tuple[str, tuple[str, ...], str], ...] = (  # kind, suffixes, how to get an ONNX file
    ("PyTorch weights", (".pt", ".pth", ".ckpt", ".safetensors"), _ULTRALYTICS),
    (
        "a TensorRT engine",
        (".engine", ".trt", ".plan"),
        "the ONNX file that it was built from, with --device tensorrt",
    ),
    (
        "a TensorFlow Lite network",
        (".tflite", ".lite"),
        "`python -m tf2onnx.convert --tflite {name} --output MODEL.onnx`",
    ),
    (
        "a TensorFlow network",
        (".pb", ".h5", ".keras"),
        "`python -m tf2onnx.convert` (for .pb with --graphdef)",
    ),
    ("an OpenVINO network", (".xml", ".bin"), "the ONNX file that it was converted from"),
    ("a Core ML network", (".mlmodel", ".mlpackage"), _ULTRALYTICS.format(name="MODEL.pt")),
    (
        "a PaddlePaddle network",
        (".pdmodel", ".pdiparams"),
        "`paddle2onnx --model_dir DIR --save_file MODEL.onnx`",
    ),
    (
        "an ncnn, MNN or RKNN network",
        (".param", ".mnn", ".rknn"),
        "the ONNX file that it was converted from",
    ),
    (
        "a Darknet network",
        (".cfg", ".weights"),
        "`track-range models import NET.cfg NET.weights --out MODEL.onnx`",
    ),
)


def other_kind(path: Path) -> str | None:
    """The kind of a file, by its first bytes or else its suffix, and how to get an ONNX network;
    None = unknown.
    """
    with path.open("rb") as file:
        head = file.read(_HEAD_BYTES)
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n").lower()
    if text.startswith(b"version https://git-lfs"):
        return "a pointer of Git LFS; fetch the file with `git lfs pull`"
    if text.startswith((b"<!doctype html", b"<html", b"<head")):
        return "a web page (HTML); download the file itself, on GitHub with `Raw` or `Download`"
    suffix = path.suffix.lower()
    if head[4:8] == b"TFL3":
        suffix = ".tflite"
    elif head.startswith((b"PK\x03\x04", b"\x80\x02")) and suffix not in (".mlpackage", ".keras"):
        suffix = ".pt"  # a ZIP archive or a pickle: torch.save
    elif head.startswith(b"ftrt"):
        suffix = ".engine"
    elif text.startswith(b"<?xml"):
        suffix = ".xml"
    kinds = (
        f"{kind}; use {advice.format(name=path.name)}"
        for kind, suffixes, advice in _KINDS
        if suffix in suffixes
    )
    return next(kinds, None)

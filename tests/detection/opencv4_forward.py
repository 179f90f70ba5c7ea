"""Outputs of Darknet networks by OpenCV 4, whose dnn module can still read them, as .npz files.

    python opencv4_forward.py FOLDER        FOLDER/*.cfg with .weights and .blob.npy -> *.opencv.npz

It runs in a separate environment with OpenCV 4. Each file has the inputs (`raw_0`, `raw_1`, ...)
and the outputs (`decoded_0`, ...) of the [yolo] layers.
"""

import sys
from pathlib import Path

import cv2
import numpy as np


def forward(cfg):
    net = cv2.dnn.readNetFromDarknet(str(cfg), str(cfg.with_suffix(".weights")))
    net.setPreferableBackend(cv2.dnn.DNN_BACKEND_OPENCV)
    net.setPreferableTarget(cv2.dnn.DNN_TARGET_CPU)
    net.enableWinograd(False)  # plain float32 sums
    yolos = net.getUnconnectedOutLayersNames()
    convolutions = [f"conv_{int(name.split('_')[1]) - 1}" for name in yolos]
    net.setInput(np.load(cfg.with_suffix(".blob.npy")))
    outputs = net.forward([*convolutions, *yolos])
    named = [*(f"raw_{i}" for i in range(len(yolos))), *(f"decoded_{i}" for i in range(len(yolos)))]
    np.savez(cfg.with_suffix(".opencv.npz"), **dict(zip(named, outputs, strict=True)))


if __name__ == "__main__":
    for path in sorted(Path(sys.argv[1]).glob("*.cfg")):
        forward(path)

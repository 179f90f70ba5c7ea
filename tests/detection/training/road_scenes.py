"""Drawn road scenes with exact labels: small data sets on which training can be tested in
seconds."""

import cv2
import numpy as np
import yaml

NAMES = ("car", "person")


def draw_scene(rng, *, width_px=160, height_px=120):
    """A BGR image with one to three dark wide cars or bright tall persons, and its rows `class x1
    y1 x2 y2`."""
    image = np.full((height_px, width_px, 3), 120, np.uint8)
    image[height_px // 2 :] = 90
    image = np.clip(image + rng.normal(0, 4, image.shape), 0, 255).astype(np.uint8)
    rows = []
    for column in rng.permutation(3)[: rng.integers(1, 4)]:
        class_index = int(rng.integers(2))
        w, h = ((44, 26), (14, 36))[class_index] * rng.uniform(0.8, 1.2, 2)
        x1, y1 = int(column * width_px / 3 + 2), int(rng.uniform(30, height_px - h - 4))
        x2, y2 = int(x1 + w), int(y1 + h)
        colour = ((120, 30, 20), (200, 210, 235))[class_index]
        cv2.rectangle(image, (x1, y1), (x2 - 1, y2 - 1), colour, -1)
        cv2.rectangle(image, (x1 + 3, y1 + 3), (x2 - 4, y1 + int(0.4 * h)), (230, 220, 200), -1)
        rows.append((class_index, x1, y1, x2, y2))
    return image, rows


def write_data_set(folder, *, n_train=8, n_val=None, seed=0, **extra):
    """Write a YOLO data set to `folder`; the validation images are the training images unless
    `n_val` is given.

    Returns:
        Path of its data.yaml.
    """
    rng = np.random.default_rng(seed)
    for split, n in (("train", n_train), ("val", n_val or 0)):
        for kind in ("images", "labels"):
            (folder / kind / split).mkdir(parents=True, exist_ok=True)
        for i in range(n):
            image, rows = draw_scene(rng)
            height, width = image.shape[:2]
            cv2.imwrite(str(folder / "images" / split / f"{i:03}.png"), image)
            lines = [
                f"{c} {(x1 + x2) / 2 / width:.6f} {(y1 + y2) / 2 / height:.6f} "
                f"{(x2 - x1) / width:.6f} {(y2 - y1) / height:.6f}"
                for c, x1, y1, x2, y2 in rows
            ]
            (folder / "labels" / split / f"{i:03}.txt").write_text("\n".join(lines) + "\n")
    val = "images/val" if n_val else "images/train"
    document = {"train": "images/train", "val": val, "names": list(NAMES), **extra}
    path = folder / "data.yaml"
    path.write_text(yaml.safe_dump(document))
    return path

"""The pictures of the documentation, drawn again from the program: `python docs/pictures.py [NAME
...]`.

Frames come from the simulation, curves are computed by the package, diagrams are drawn here; there
are no photographs. `report` takes a screenshot with Chromium, where it is installed. Without names
all pictures are drawn, which takes some ten minutes, most of them for a short run of each scenario.
"""

from __future__ import annotations

import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import matplotlib as mpl
import numpy as np
import pyarrow.csv
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon, Rectangle
from PIL import Image
from playwright.sync_api import sync_playwright

import track_range as tr
from track_range.detection.boxes import iou
from track_range.evaluation.sequences.labelled_images import LabelledSource
from track_range.ranging.registry import methods
from track_range.simulation.settings import SCENARIO_NAMES
from track_range.views.overlay import birds_eye

FIGURES, FRAMES = (Path(__file__).parent / "images" / name for name in ("figures", "frames"))

FOCAL_PX, BASELINE_M, CAMERA_HEIGHT_M = 721.5, 0.54, 1.65
"""KITTI's left colour camera, as in the simulation."""

COLOUR = {method.name: method.colour for method in methods()} | {"fused": "#1f5fbf"}
INK, FAINT, ROAD = "#303030", "#909090", "#d8d8d4"

mpl.rcParams.update(
    {
        "font.size": 9,
        "axes.spines.top": False,
        "axes.spines.right": False,
        "axes.edgecolor": FAINT,
        "svg.hashsalt": "track-range",
        "legend.frameon": False,
    }
)

DEMO_FRAME = 30
"""The frame of the demo that is shown."""


# -- diagrams and curves
# ----------------------------------------------------------------------------------------------


def mono() -> None:
    """The pinhole law in side view, and the distances that the packaged size model gives to heights
    of boxes.
    """
    figure = Figure((7.4, 2.7))
    scene, plot = figure.subplots(1, 2, width_ratios=(1.15, 1))
    _side_view(scene)
    _car(scene, 7.0, 0.0)
    scene.plot([0, 7.0], [1.2, 1.5], color=COLOUR["mono"], lw=1)
    scene.plot([0, 7.0], [1.2, 0.0], color=COLOUR["mono"], lw=1)
    scene.plot([1.3, 1.3], [1.2 - 1.3 * 1.2 / 7, 1.2 + 1.3 * 0.3 / 7], color=INK, lw=2.5)
    scene.annotate("h px", (1.45, 1.08), va="center", color=INK)
    _arrow(scene, (7.35, 0.0), (7.35, 1.5), "H m", (7.85, 0.7))
    _arrow(scene, (0, -0.28), (7.0, -0.28), "d = f H / h", (3.5, -0.62))

    height_px = np.geomspace(12, 160, 60)
    for name, class_id, aspect in (("car", 2, 1.25), ("person", 0, 0.4), ("truck", 5, 0.95)):
        distance_m, sigma_m = _by_size(height_px, class_id, aspect)
        (line,) = plot.plot(height_px, distance_m, lw=1.5, label=name)
        plot.fill_between(
            height_px, distance_m - sigma_m, distance_m + sigma_m, alpha=0.2, color=line.get_color()
        )
    plot.set(
        xscale="log",
        yscale="log",
        xlabel="height of the box, px (f = 721 px)",
        ylabel="distance, m",
    )
    plot.set_xticks([12, 25, 50, 100], ["12", "25", "50", "100"])
    plot.set_yticks([5, 10, 20, 50, 100], ["5", "10", "20", "50", "100"])
    plot.minorticks_off()
    plot.legend(title="mono with 1 sigma")
    _save(figure, "mono.svg")


def ground() -> None:
    """The ground plane in side view, and what a pitch of a tenth of a degree does."""
    figure = Figure((7.4, 2.7))
    scene, plot = figure.subplots(1, 2, width_ratios=(1.15, 1))
    _side_view(scene)
    _car(scene, 7.0, 0.0)
    scene.plot([0, 6.9], [1.2, 1.2], color=FAINT, lw=1, ls="--")
    scene.text(6.8, 1.28, "horizon", ha="right", color=FAINT)
    scene.plot([0, 7.0], [1.2, 0.0], color=COLOUR["ground"], lw=1)
    scene.plot([2.2, 2.2], [1.2 - 2.2 * 1.2 / 7, 1.2], color=INK, lw=2.5)
    scene.text(2.9, 1.32, "y_bottom - y_horizon", ha="center", color=INK, fontsize=8)
    _arrow(scene, (-0.25, 0.0), (-0.25, 1.2), "H", (-0.55, 0.55))
    scene.plot([7.0], [0.0], "o", color=COLOUR["ground"], ms=5)
    scene.text(6.95, -0.34, "contact point", ha="right", fontsize=8, color=COLOUR["ground"])
    scene.text(0.1, -0.62, "d = f H / (y_bottom - y_horizon)", color=INK)

    distance_m = np.linspace(5, 100, 100)
    for error_px, label in (
        (1.0, "1 px"),
        (FOCAL_PX * np.radians(0.2), "0.2 degrees of pitch (2.5 px)"),
    ):
        fraction = error_px * distance_m / (FOCAL_PX * CAMERA_HEIGHT_M)
        plot.plot(
            distance_m,
            100 * fraction,
            label=label,
            color=COLOUR["ground"],
            ls="-" if error_px == 1 else "--",
        )
    plot.set(xlabel="distance, m", ylabel="error, %", ylim=(0, 25))
    plot.legend(title="error of the row, camera at 1.65 m")
    _save(figure, "ground.svg")


def lane() -> None:
    """The ego lane in the image, the box in it, and the width in the row of its bottom edge."""
    figure = Figure((7.4, 2.5))
    scene = figure.subplots()
    scene.set(xlim=(0, 1240), ylim=(376, 120), aspect="equal")
    scene.axis("off")
    scene.add_patch(Rectangle((0, 120), 1240, 256, color="#eef1f3", lw=0))
    scene.add_patch(Polygon([(610, 173), (-400, 376), (1620, 376)], color=ROAD, lw=0))
    for offset_m in (-1.75, 1.75, -5.25, 5.25):
        end = 610 + offset_m * (376 - 173) / CAMERA_HEIGHT_M
        is_own = abs(offset_m) < 2
        scene.plot(
            [610, end],
            [173, 376],
            color=COLOUR["lane"] if is_own else "white",
            lw=2.5 if is_own else 2,
        )
    y_px = 270.0
    half_px = 1.75 * (y_px - 173) / CAMERA_HEIGHT_M
    scene.add_patch(Rectangle((555, 196), 110, y_px - 196, fill=False, color=INK, lw=2))
    arrow = {"arrowstyle": "<->", "color": INK, "lw": 1.2, "shrinkA": 0, "shrinkB": 0}
    scene.annotate("", (610 - half_px, y_px), (610 + half_px, y_px), arrowprops=arrow)
    scene.text(610, y_px + 22, "w px", ha="center", color=INK)
    scene.text(610, 350, "W m between the lines", ha="center", color=COLOUR["lane"])
    scene.text(1225, 230, "d = f W / w", ha="right", color=INK, fontsize=11)
    scene.text(1225, 256, "in the row of the bottom edge", ha="right", color=INK)
    scene.text(15, 165, "horizon", color=FAINT)
    scene.plot([0, 1240], [173, 173], color=FAINT, lw=0.8, ls="--")
    _save(figure, "lane.svg")


def stereo() -> None:
    """Two cameras from above, and the distance error of a disparity error."""
    figure = Figure((7.4, 2.7))
    scene, plot = figure.subplots(1, 2, width_ratios=(1.05, 1))
    scene.set(xlim=(-2.2, 2.2), ylim=(-0.7, 4.4))
    scene.axis("off")
    for x, name in ((-0.9, "left"), (0.9, "right")):
        scene.plot([x], [0], "s", color=INK, ms=8)
        scene.text(x, -0.5, name, ha="center")
        scene.plot([x - 0.5, x + 0.5], [0.6, 0.6], color=INK, lw=2)
        scene.plot([x, x], [0, 4.1], color=FAINT, ls="--", lw=0.8)
        scene.plot([x, 0.1], [0, 4.0], color=COLOUR["stereo"], lw=1.2)
    scene.plot([0.1], [4.0], "o", color=COLOUR["stereo"])
    _arrow(scene, (-0.9, -0.12), (0.9, -0.12), "B", (0, -0.45))
    _arrow(scene, (1.9, 0), (1.9, 4.0), "Z", (2.05, 2))
    scene.text(-2.1, 2.7, "d = x_left - x_right\nZ = f B / d", color=INK)
    distance_m = np.linspace(5, 80, 100)
    for sigma_px, style in ((0.05, ":"), (0.1, "-"), (0.5, "--")):
        fraction = sigma_px * distance_m / (FOCAL_PX * BASELINE_M)
        plot.plot(distance_m, 100 * fraction, style, color=COLOUR["stereo"], label=f"{sigma_px} px")
    plot.set(xlabel="distance, m", ylabel="error, %", ylim=(0, 8))
    plot.legend(title="disparity error\nf = 721 px, B = 0.54 m", loc="upper left")
    _save(figure, "stereo.svg")


def alignment() -> None:
    """Distances that a disparity error of half a pixel makes of true ones."""
    figure = Figure((6.0, 2.6))
    plot = figure.subplots()
    true_m = np.linspace(5, 60, 100)
    for error_px, style in ((-0.5, "-"), (-0.2, "--"), (0.5, ":")):
        disparity_px = FOCAL_PX * BASELINE_M / true_m + error_px
        measured_m = FOCAL_PX * BASELINE_M / disparity_px
        plot.plot(
            true_m,
            100 * (measured_m / true_m - 1),
            style,
            color=COLOUR["stereo"],
            label=f"{error_px:+.1f} px",
        )
    plot.axhline(0, color=FAINT, lw=0.8)
    plot.set(xlabel="true distance, m", ylabel="distance error, %")
    plot.legend(title="disparities read\nf = 721 px, B = 0.54 m", loc="upper left")
    _save(figure, "alignment.svg")


def fused() -> None:
    """One track of a simulated drive: the error of each method over time, with fused and its
    sigma.
    """
    rows, truth = _longest_track()
    figure = Figure((7.4, 2.9))
    plot = figure.subplots()
    for name in ("mono", "ground", "lane", "stereo"):
        plot.plot(
            rows["time_s"],
            100 * (rows[f"{name}_m"] / truth - 1),
            color=COLOUR[name],
            lw=1.1,
            label=name,
        )
    error = 100 * (rows["fused_m"] / truth - 1)
    sigma = 100 * rows["fused_sigma_m"] / truth
    plot.fill_between(
        rows["time_s"], error - sigma, error + sigma, color=COLOUR["fused"], alpha=0.2, lw=0
    )
    plot.plot(rows["time_s"], error, color=COLOUR["fused"], lw=2.2, label="fused, 1 sigma")
    plot.axhline(0, color=FAINT, lw=0.8)
    plot.set(
        xlabel="time, s",
        ylabel="distance error, %",
        title="A car of the simulated drive",
        ylim=(-16, 16),
    )
    plot.legend(ncols=5, fontsize=8, loc="lower left")
    _save(figure, "fused.svg")


def filtered() -> None:
    """The same track: distance by size before and after the filter, and the closing speed."""
    rows, truth = _longest_track()
    figure = Figure((7.4, 2.9))
    plot, speed = figure.subplots(1, 2)
    plot.plot(rows["time_s"], truth, color=INK, lw=1, label="truth")
    plot.plot(rows["time_s"], rows["mono_m"], ".", color=COLOUR["mono"], ms=4, label="mono")
    plot.plot(rows["time_s"], rows["mono_kf_m"], color=COLOUR["mono"], lw=1.5, label="mono_kf")
    plot.plot(
        rows["time_s"], rows["fused_kf_m"], color=COLOUR["fused"], lw=1.5, ls="--", label="fused_kf"
    )
    plot.set(xlabel="time, s", ylabel="distance, m")
    plot.legend(fontsize=8)
    closing, sigma = rows["closing_mps"], rows["closing_sigma_mps"]
    speed.fill_between(
        rows["time_s"], closing - sigma, closing + sigma, color=COLOUR["fused"], alpha=0.2, lw=0
    )
    speed.plot(rows["time_s"], closing, color=COLOUR["fused"], lw=1.5, label="closing_mps, 1 sigma")
    speed.plot(rows["time_s"], rows["true_closing_mps"], color=INK, lw=1, label="truth")
    speed.set(xlabel="time, s", ylabel="closing speed, m/s")
    speed.legend(fontsize=8)
    _save(figure, "filtered.svg")


def distance() -> None:
    """What the columns of distance mean: z from the camera to the surface, and the gap from the
    bumper.
    """
    figure = Figure((8.4, 2.5))
    scene = figure.subplots()
    scene.set(xlim=(-3.4, 17.2), ylim=(-1.95, 2.9), aspect="equal")
    scene.axis("off")
    scene.plot([-3.4, 17.2], [0, 0], color=FAINT, lw=2)
    for x, colour in ((-3.0, "#c9d6e8"), (12.0, ROAD)):  # a body of 4.5 m, seen from its left side
        body = [(0, 0.3), (0, 1.0), (0.5, 1.45), (2.6, 1.45), (3.4, 0.95), (4.4, 0.8), (4.5, 0.3)]
        scene.add_patch(Polygon([(x + dx, y) for dx, y in body], color=colour, lw=0))
        for wheel in (0.9, 3.6):
            scene.add_patch(Circle((x + wheel, 0.32), 0.32, color=INK, lw=0))
    scene.add_patch(Rectangle((11.95, 0.0), 4.6, 1.5, fill=False, color=COLOUR["fused"], lw=1.6))
    scene.text(14.25, 1.62, "box of the detector", ha="center", color=COLOUR["fused"])
    scene.plot([0, 12.0], [1.3, 0.72], color=COLOUR["fused"], lw=1.2)
    scene.plot([12.0], [0.72], "o", color=COLOUR["fused"], ms=5)
    scene.text(
        11.7,
        0.28,
        "first surface on the ray through the box's centre",
        ha="right",
        fontsize=8,
        color=COLOUR["fused"],
    )
    scene.plot([0], [1.3], "s", color=INK, ms=6)
    scene.text(0, 2.5, "camera", ha="center")
    scene.plot([0, 0], [2.4, 1.45], color=FAINT, lw=0.8)
    for x in (0, 1.5, 12.0):
        scene.plot([x, x], [0, -1.75], color=FAINT, lw=0.8, ls="--")
    _arrow(
        scene,
        (0, -0.62),
        (12.0, -0.62),
        "distance: z along the camera's axis (fused_m, fused_kf_m)",
        (6.9, -0.5),
    )
    _arrow(scene, (0, -1.5), (1.5, -1.5), "1.5 m", (0.75, -1.38))
    _arrow(scene, (1.5, -1.5), (12.0, -1.5), "gap: from the front bumper (gap_m)", (6.9, -1.38))
    _save(figure, "distance.svg")


# -- frames of the simulation
# -----------------------------------------------------------------------------------------


def moving() -> None:
    """The overlay of a calm highway as a moving picture of less than 1.5 MB."""
    frames, capture = [], cv2.VideoCapture(str(_highway() / "overlay.mp4"))
    while (read := capture.read())[0]:
        small = cv2.resize(read[1], None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA)
        frames.append(Image.fromarray(small[:, :, ::-1]))
    first, *rest = frames
    first.save(
        FRAMES / "moving.webp",
        save_all=True,
        append_images=rest,
        duration=100,
        loop=0,
        quality=45,
        method=6,
    )


def overlay() -> None:
    """A frame of the demo's overlay, and the road from above that is part of it."""
    image = _frame(_demo() / "overlay.mp4", DEMO_FRAME)
    _save_jpeg(image, FRAMES / "overlay.jpg", quality=88)
    places = birds_eye._places((image.shape[1], image.shape[0])).round().astype(int)
    # its background is dark
    inset = min((image[y1:y2, x1:x2] for x1, y1, x2, y2 in places), key=np.mean)
    inset = cv2.resize(inset, None, fx=2.2, fy=2.2, interpolation=cv2.INTER_CUBIC)
    cv2.imwrite(str(FRAMES / "from_above.png"), inset)


def disparity() -> None:
    """The overlay with dense stereo's disparities below it."""
    drive, out = _demo() / "drive", _demo() / "with_disparity"
    options = [
        "--overlay-disparity",
        "--align",
        "off",
        "--start",
        "2",
        "--duration",
        "1.2",
        "--out",
        str(out),
    ]
    _track_range("--stereo", str(drive / "left.mp4"), str(drive / "right.mp4"), *options)
    image = _frame(out / "overlay.mp4", 10)
    _save_jpeg(
        cv2.resize(image, None, fx=0.8, fy=0.8, interpolation=cv2.INTER_AREA),
        FRAMES / "disparity.jpg",
    )


def anonymized() -> None:
    """A frame of an overlay with `--anonymize`."""
    drive, results = _temporary() / "shared", _temporary() / "shared-results"
    _track_range(
        "simulate", "--out", str(drive), "--scenario", "city", "--seed", "101", "--seconds", "2.6"
    )
    pair = (str(drive / "left.mp4"), str(drive / "right.mp4"))
    _track_range("--stereo", *pair, "--no-sgbm", "--anonymize", "--out", str(results))
    _save_jpeg(_frame(results / "overlay.mp4", 20), FRAMES / "anonymized.jpg", quality=80)


def scenarios() -> None:
    """A frame of the overlay, 4 s after the start, of each scenario of `track-range simulate`."""
    tiles = []
    for name in SCENARIO_NAMES:
        drive = _temporary() / name
        # seed 0 follows a motorcycle that is too far to be detected
        seed = "3" if name == "following" else "0"
        options = ["--scenario", name, "--seed", seed, "--seconds", "5", "--fps", "5"]
        _track_range("simulate", "--out", str(drive), *options)
        pair = (str(drive / "left.mp4"), str(drive / "right.mp4"))
        _track_range("--stereo", *pair, "--no-sgbm", "--out", str(drive / "results"))
        # without legend, inset and image border
        middle = _frame(drive / "results" / "overlay.mp4", 20)[16:, 317:923]
        tile = cv2.resize(middle, (400, 238), interpolation=cv2.INTER_AREA)
        (width_px, _), _ = cv2.getTextSize(name, cv2.FONT_HERSHEY_SIMPLEX, 0.55, 1)
        cv2.rectangle(tile, (0, 0), (width_px + 14, 24), (40, 40, 40), -1)
        cv2.putText(
            tile, name, (7, 17), cv2.FONT_HERSHEY_SIMPLEX, 0.55, (255, 255, 255), 1, cv2.LINE_AA
        )
        tiles.append(
            cv2.copyMakeBorder(tile, 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        )
    rows = [np.hstack(tiles[i : i + 3]) for i in range(0, len(tiles), 3)]
    _save_jpeg(np.vstack(rows), FRAMES / "scenarios.jpg", quality=44)


def failures() -> None:
    """The six simulated images with the most objects that the packaged detector misses (red); its
    wrong boxes (amber).

    Objects of at least 25 px that are at least half visible, boxes with a score of at least 0.25,
    matched at an IoU of 0.5 in each class.
    """
    folder = _temporary() / "failures"
    _track_range(
        "simulate", "--images", "120", "--frames", "4", "--seed", "7000", "--out", str(folder)
    )
    detector, tiles = tr.Detector("road", min_score=0.25), []
    scored, hidden = (
        LabelledSource(images=folder / "images", labels=folder / name)
        for name in ("labels", "ignored")
    )
    for (image, truth), ignored in zip(scored.open(), hidden.labelled_files(), strict=True):
        boxes = detector.detect(image)
        boxes = boxes.select(
            ~(iou(boxes.xyxy_px, ignored.truth_in(image).xyxy_px) >= 0.5).any(axis=1)
        )
        labels, class_id = truth.xyxy_px, truth.class_id
        same = (iou(boxes.xyxy_px, labels) >= 0.5) & (boxes.class_id[:, None] == class_id)
        is_missed = ~same.any(axis=0) & (labels[:, 3] - labels[:, 1] >= 25)
        drawn = (
            (boxes.xyxy_px[same.any(axis=1)], (120, 200, 60)),
            (boxes.xyxy_px[~same.any(axis=1)], (40, 200, 250)),
            (labels[is_missed], (60, 60, 240)),
        )
        for rows, colour in drawn:
            for x1, y1, x2, y2 in rows.round().astype(int).tolist():
                cv2.rectangle(image, (x1, y1), (x2, y2), colour, 1, cv2.LINE_AA)
        tiles.append((int(is_missed.sum()), image))
    worst = [image for _, image in sorted(tiles, key=lambda tile: -tile[0])[:6]]
    framed = [
        cv2.copyMakeBorder(tile, 2, 2, 2, 2, cv2.BORDER_CONSTANT, value=(255, 255, 255))
        for tile in worst
    ]
    rows = [np.hstack(framed[i : i + 2]) for i in range(0, 6, 2)]
    _save_jpeg(np.vstack(rows), FRAMES / "detector_failures.jpg", quality=80)


def report() -> None:
    """The first screen of a report, as Chromium shows it."""
    chromium = (
        shutil.which("chromium")
        or shutil.which("chromium-browser")
        or shutil.which("google-chrome")
    )
    if chromium is None:
        print("report: Chromium is not installed; the picture stays as it is.", file=sys.stderr)  # noqa: T201
        return
    shot = _temporary() / "report.png"
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1200, "height": 860})
        page.goto((_highway() / "report.html").as_uri())
        page.evaluate("document.querySelector('video').currentTime = 3")
        page.wait_for_timeout(3000)  # ms; the video seeks
        page.screenshot(path=str(shot))
        browser.close()
    image = cv2.resize(cv2.imread(str(shot)), None, fx=0.75, fy=0.75, interpolation=cv2.INTER_AREA)
    _save_jpeg(image, FRAMES / "report.jpg", quality=80)


# -- helpers
# ----------------------------------------------------------------------------------------------------------


@cache
def _temporary() -> Path:
    return Path(tempfile.mkdtemp(prefix="track-range-pictures-"))


@cache
def _demo() -> Path:
    """The folder of the demo's results."""
    out = _temporary() / "demo"
    _track_range("demo", "--out", str(out))
    return out


@cache
def _highway() -> Path:
    """The folder of the results of a stereo drive on a highway with few road users."""
    drive = _temporary() / "highway-2"
    _track_range(
        "simulate", "--out", str(drive), "--scenario", "highway", "--seed", "2", "--seconds", "6"
    )
    pair = (str(drive / "left.mp4"), str(drive / "right.mp4"))
    _track_range("--stereo", *pair, "--no-sgbm", "--out", str(drive / "results"))
    return drive / "results"


def _track_range(*arguments: str) -> None:
    subprocess.run(
        [sys.executable, "-m", "track_range", *arguments], check=True, stdout=subprocess.DEVNULL
    )


@cache
def _longest_track() -> tuple[dict[str, Any], Any]:
    """Rows of the car with the most visible frames in a simulated drive through a town, and its
    true distances.
    """
    drive, out = _temporary() / "town", _temporary() / "town" / "results"
    _track_range(
        "simulate", "--out", str(drive), "--scenario", "town", "--seconds", "8", "--seed", "4"
    )
    options = ["--no-sgbm", "--no-overlay", "--align", "off", "--out", str(out)]
    _track_range("--stereo", str(drive / "left.mp4"), str(drive / "right.mp4"), *options)
    rows = pyarrow.csv.read_csv(out / "tracks.csv").to_pandas()
    truth = pyarrow.csv.read_csv(drive / "truth.csv").to_pandas()
    merged = rows[rows["class"] == "car"].merge(truth, on="frame", suffixes=("", "_true"))
    centre_px = (merged.x1 + merged.x2 - merged.x1_px - merged.x2_px).abs() / 2
    seen = merged[(centre_px < 8) & (merged.visible_share > 0.7) & merged.distance_m.between(5, 60)]
    track = max((group for _, group in seen.groupby(["track_id", "id"])), key=_information)
    columns = {name: track[name].to_numpy() for name in rows.columns}
    return columns | {
        "true_closing_mps": track["closing_mps_true"].to_numpy()
    }, track.distance_m.to_numpy()


def _information(track: Any) -> float:
    """Number of frames that all methods measured, and the range of the distances: more is better to
    look at.
    """
    methods_m = track[["mono_m", "ground_m", "lane_m", "stereo_m"]]
    return float(np.isfinite(methods_m).all(axis=1).sum() + np.ptp(track.distance_m))


def _by_size(height_px: Any, class_id: int, aspect: float) -> tuple[Any, Any]:
    camera = tr.PinholeCamera(FOCAL_PX, FOCAL_PX, 620.0, 173.0, width_px=1240, height_px=376)
    frame = tr.Frame(index=0, time_s=0.0, left=np.zeros((376, 1240, 3), np.uint8), right=None)
    distance_m, sigma_m = [], []
    for height in height_px:
        box = np.array(
            [
                [
                    620 - aspect * height / 2,
                    173 - height / 3,
                    620 + aspect * height / 2,
                    173 + height / 1.5,
                ]
            ]
        )
        tracks = tr.Tracks(
            np.array([1]), box, np.array([class_id]), np.ones(1), np.ones(1, np.bool_)
        )
        ranges = tr.SizeRanger(camera).measure(tracks, frame)
        distance_m.append(ranges.distance_m[0])
        sigma_m.append(ranges.sigma_m[0])
    return np.array(distance_m), np.array(sigma_m)


def _side_view(axes: Axes) -> None:
    """A camera at the left, 1.2 units above a road."""
    axes.set(xlim=(-1.0, 9.0), ylim=(-0.85, 2.0))
    axes.axis("off")
    axes.plot([-1, 9], [0, 0], color=FAINT, lw=2)
    axes.plot([0], [1.2], "s", color=INK, ms=8)
    axes.text(0, 1.42, "camera", ha="center")


def _car(axes: Axes, x: float, y: float) -> None:
    axes.add_patch(
        Polygon(
            [(x, y), (x, y + 1.5), (x + 1.6, y + 1.5), (x + 2, y + 0.8), (x + 2, y)], color=ROAD
        )
    )


def _arrow(
    axes: Axes,
    start: tuple[float, float],
    end: tuple[float, float],
    text: str,
    at: tuple[float, float],
) -> None:
    axes.annotate("", end, start, arrowprops={"arrowstyle": "<->", "color": INK, "lw": 1})
    axes.text(*at, text, ha="center", color=INK)


def _frame(video: Path, index: int) -> Any:
    capture = cv2.VideoCapture(str(video))
    for _ in range(index + 1):
        is_read, image = capture.read()
        assert is_read, f"{video}: fewer than {index + 1} frames"  # noqa: S101
    return image


def _save(figure: Figure, name: str) -> None:
    figure.tight_layout()
    figure.savefig(FIGURES / name, metadata={"Date": None}, facecolor="white")


def _save_jpeg(image: Any, path: Path, quality: int = 85) -> None:
    cv2.imwrite(str(path), image, [cv2.IMWRITE_JPEG_QUALITY, quality, cv2.IMWRITE_JPEG_OPTIMIZE, 1])


PICTURES: dict[str, Callable[[], None]] = {
    draw.__name__: draw
    for draw in (
        mono,
        ground,
        lane,
        stereo,
        alignment,
        distance,
        fused,
        filtered,
        moving,
        overlay,
        disparity,
        scenarios,
        anonymized,
        failures,
        report,
    )
}

if __name__ == "__main__":
    for chosen in sys.argv[1:] or PICTURES:
        PICTURES[chosen]()

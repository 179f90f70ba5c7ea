"""Lane networks: small files written by the tests, and the real ones if available."""

import cv2
import numpy as np
import pytest

from tests.support.images.lane_roads import HW, picture, road_x_px, width_px
from tests.support.networks.onnx_models import write_model
from track_range.detection.lanes.edges import EdgeLaneFinder
from track_range.detection.lanes.nets import CLASSICAL, ROW_ANCHORS, NetLaneFinder, open_lane_finder
from track_range.detection.models.onnx_session import ModelError, Runtime

IMAGE = np.zeros((*HW, 3), np.uint8)
ROWS = np.array([220.0, 300.0, 350.0])


def mask_of(*lines_m):
    """(1, 2, h, w) scores of a network that detects these lines, 7 px wide."""
    scores = np.zeros((1, 2, *HW))
    y = np.arange(190, 358)
    for x_m in lines_m:
        for offset in range(-3, 4):
            x = np.rint(road_x_px(x_m, y)).astype(int) + offset
            inside = (x >= 0) & (x < HW[1])
            scores[0, 1, y[inside], x[inside]] = 1.0
    return scores


def test_segmentation_network(tmp_path):
    model = write_model(tmp_path / "m.onnx", mask_of(-1.75, 1.75, 5.25), input_shape=(1, 3, *HW))
    lines = NetLaneFinder(model).find(IMAGE, 0.0)
    assert lines.left.x_px(ROWS) == pytest.approx(road_x_px(-1.75, ROWS), abs=1.5)
    assert lines.right.x_px(ROWS) == pytest.approx(road_x_px(1.75, ROWS), abs=1.5)
    beside = NetLaneFinder(model).find(IMAGE, 0.0, np.array([[330.0, 160, 639, 359]]))
    assert beside.right is None


def test_line_mask_of_two_is_mapped_back(tmp_path):
    drivable = mask_of(-3.0, 0.5)
    model = write_model(
        tmp_path / "m.onnx", drivable, mask_of(-1.75, 1.75), input_shape=(1, 3, *HW)
    )
    lines = NetLaneFinder(model).find(np.zeros((720, 1280, 3), np.uint8), 0.0)
    # Pixel centres at integers: x of the large image + 0.5 is twice that of the small one + 0.5.
    assert lines.left.x_px(2 * ROWS + 0.5) == pytest.approx(
        2 * road_x_px(-1.75, ROWS) + 0.5, abs=3.0
    )


def test_curve_network(tmp_path):
    """Lines that meet at the horizon of the training images, x = 0.5 -+ 1.1 (y - 0.35), so that one
    view suffices."""
    curves = np.zeros((1, 7, 8))
    for row, slope in enumerate((-3.3, -1.1, 1.1)):
        curves[0, row] = [0.4, 1.0, 0.0, 0.0, 0.0, 0.5, slope, slope * 0.35]
    logits = np.tile([5.0, 0.0], (1, 7, 1))
    logits[0, :3] = [0.0, 5.0]
    model = write_model(tmp_path / "m.onnx", logits, curves, input_shape=(1, 3, *HW))
    lines = NetLaneFinder(model).find(IMAGE, 0.0)
    expected = 640 * (0.5 - 1.1 * ((ROWS + 0.5) / 360 - 0.35)) - 0.5
    assert lines.left.x_px(ROWS) == pytest.approx(expected, abs=1.0)


@pytest.mark.parametrize(("n_cells", "n_rows"), [(200, 18), (100, 56)], ids=["CULane", "TuSimple"])
def test_row_anchor_network(tmp_path, n_cells, n_rows):
    anchors = ROW_ANCHORS[n_rows]
    scores = np.zeros((1, n_cells + 1, n_rows, 4))
    cell_px = 799 / (n_cells - 1)
    for line, x_m in enumerate((-5.25, -1.75, 1.75, 5.25)):
        for row, anchor in enumerate(anchors):
            y_px = anchor / 288 * HW[0]
            x = (road_x_px(x_m, y_px) + 0.5) * 800 / HW[1] - 0.5
            is_seen = y_px > 190 and 0 <= x < 800
            scores[0, int(x // cell_px) if is_seen else n_cells, row, line] = 40.0
    lines = NetLaneFinder(
        write_model(tmp_path / "m.onnx", scores, input_shape=(1, 3, 288, 800))
    ).find(IMAGE, 0.0)
    y = np.array([240.0, 300.0, 350.0])
    # a cell of 100 is 6.5 px wide here
    assert lines.left.x_px(y) == pytest.approx(road_x_px(-1.75, y), abs=5.0)
    assert lines.right.x_px(y) - lines.left.x_px(y) == pytest.approx(width_px(y), rel=0.04)


def test_network_of_variable_size(tmp_path):
    model = write_model(tmp_path / "m.onnx", mask_of(-1.75, 1.75), input_shape=(1, 3, None, None))
    assert NetLaneFinder(model).find(IMAGE, 0.0).left is not None


@pytest.mark.parametrize(
    ("output", "shown"),
    [
        (np.zeros((1, 25200, 85)), r"\[1, 25200, 85\]"),
        (np.zeros((1, 201, 17, 4)), r"\[1, 201, 17, 4\]"),
    ],
)
def test_networks_of_other_shapes(tmp_path, output, shown):
    with pytest.raises(ModelError, match=rf"m\.onnx: .*output0 {shown}"):
        NetLaneFinder(write_model(tmp_path / "m.onnx", output))


def test_inputs_that_are_not_images(tmp_path):
    with pytest.raises(ModelError, match=r"m\.onnx: .*got \[1, 1, 64, 64\]"):
        NetLaneFinder(
            write_model(tmp_path / "m.onnx", np.zeros((1, 2, 64, 64)), input_shape=(1, 1, 64, 64))
        )
    with pytest.raises(ModelError, match=r"none\.onnx: no such"):
        open_lane_finder(str(tmp_path / "none.onnx"))


def test_unreadable_image_files(tmp_path):
    model = write_model(tmp_path / "m.onnx", mask_of(0.0), input_shape=(1, 3, *HW))
    for finder in (NetLaneFinder(model), EdgeLaneFinder()):
        with pytest.raises(ValueError, match="image"):
            finder.find(np.zeros(HW, np.uint8), 0.0)


def test_network_without_detections(tmp_path):
    finder = NetLaneFinder(
        write_model(tmp_path / "m.onnx", np.zeros((1, 2, *HW)), input_shape=(1, 3, *HW))
    )
    lines = finder.find(IMAGE, 0.0)
    assert lines.left is None
    assert lines.right is None


def test_edges_instead_of_network():
    assert isinstance(open_lane_finder(CLASSICAL), EdgeLaneFinder)


# The finder without a network


def test_edges_find_painted_lines():
    lines = EdgeLaneFinder().find(picture(-1.75, 1.75, 5.25, dashed=(1.75,)), 0.0)
    assert lines.left.x_px(ROWS) == pytest.approx(road_x_px(-1.75, ROWS), abs=3.0)
    assert lines.right.x_px(ROWS) - lines.left.x_px(ROWS) == pytest.approx(width_px(ROWS), rel=0.03)


@pytest.mark.parametrize("factor", [0.5, 1.5, 2.0, 3.0])
def test_edges_are_independent_of_image_size(factor):
    image = cv2.resize(
        picture(-1.75, 1.75), None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA
    )
    lines = EdgeLaneFinder().find(image, 0.0)
    y = (ROWS + 0.5) * factor - 0.5
    assert (lines.left.x_px(y) + 0.5) / factor - 0.5 == pytest.approx(
        road_x_px(-1.75, ROWS), abs=3.0
    )
    assert (lines.right.x_px(y) - lines.left.x_px(y)) / factor == pytest.approx(
        width_px(ROWS), rel=0.03
    )


def test_edges_find_yellow_on_pale_concrete():
    image = picture(-1.75, 1.75)
    paint = image[..., 0] > 150
    image[:] = np.where(paint[..., None], (90, 190, 200), image + 75).astype(np.uint8)
    image[:150] = 200
    lines = EdgeLaneFinder().find(image, 0.0)
    assert lines.right.x_px(ROWS) - lines.left.x_px(ROWS) == pytest.approx(width_px(ROWS), rel=0.04)


TINY = [
    np.zeros((*hw, 3), np.uint8) for hw in ((8, 8), (1, 1), (3, 3), (1, 2000), (2, 2000), (720, 40))
]


@pytest.mark.parametrize("image", [IMAGE, np.full((*HW, 3), 255, np.uint8), *TINY])
def test_edges_of_empty_image(image):
    lines = EdgeLaneFinder().find(image, 0.0)
    assert lines.left is None
    assert lines.right is None


def test_edges_of_a_parked_car_are_not_a_line():
    """A line at the left and the body of a parked car at the right, which is as bright as paint."""
    image, car_px = picture(-1.75, 2.2), np.array([[330.0, 160, 639, 359]])
    lines = EdgeLaneFinder().find(image, 0.0)
    width = lines.right.x_px(ROWS) - lines.left.x_px(ROWS)
    assert width == pytest.approx(width_px(ROWS, 3.95), rel=0.03)
    lines = EdgeLaneFinder().find(image, 0.0, car_px)
    assert lines.right is None


def test_texture_is_not_a_lane():
    noise = np.random.default_rng(5).integers(0, 255, (*HW, 3), dtype=np.uint8)
    lines = EdgeLaneFinder().find(noise, 0.0)
    assert lines.left is None


# The real networks

NAMES = ("twinlitenet_360x640", "lstr_tusimple_360x640")


def real_finders(shared_data):
    return [
        NetLaneFinder(shared_data / "models" / f"{name}.onnx", Runtime(n_threads=1))
        for name in NAMES
    ]


def widths_apart(one, other):
    """Largest distance of corresponding lines in 9 common rows, in lane widths, from near to
    far."""
    four = (one.left, one.right, other.left, other.right)
    y = np.linspace(min(line.y_bottom_px for line in four), max(line.y_top_px for line in four), 9)
    width = one.right.x_px(y) - one.left.x_px(y)
    apart = [
        np.abs(getattr(one, side).x_px(y) - getattr(other, side).x_px(y)) / width
        for side in ("left", "right")
    ]
    return np.maximum(*apart)


@pytest.mark.parametrize("name", ["straight_lines1", "straight_lines2"])
def test_networks_agree_on_straight_road(shared_data, name):
    image = cv2.imread(str(shared_data / "dashcam" / "test_images" / f"{name}.jpg"))
    lines = [finder.find(image, 0.0) for finder in real_finders(shared_data)]
    lines.append(EdgeLaneFinder().find(image, 0.0))
    assert widths_apart(lines[0], lines[1]).max() < 0.05
    assert widths_apart(lines[0], lines[2]).max() < 0.05
    # of 720 rows, measured by hand
    assert lines[0].vanishing_point_px()[1] == pytest.approx(420, abs=8)


def test_networks_agree_on_country_road(shared_data):
    video = cv2.VideoCapture(str(shared_data / "kitti_stereo" / "0005" / "left.mp4"))
    finders = [*real_finders(shared_data), EdgeLaneFinder()]
    for i in range(3):
        image = video.read()[1]
        lines = [finder.find(image, i * 0.1) for finder in finders]
    assert widths_apart(lines[0], lines[1])[:8].max() < 0.05
    assert widths_apart(lines[0], lines[2])[:8].max() < 0.05


def test_no_edges_in_tree_shade(shared_data):
    image = cv2.VideoCapture(str(shared_data / "kitti_stereo" / "0003" / "left.mp4")).read()[1]
    assert EdgeLaneFinder().find(image, 0.0).left is None


def test_other_real_networks(shared_data):
    with pytest.raises(ModelError, match=r"yolox_nano_416\.onnx: .*lane network"):
        NetLaneFinder(shared_data / "models" / "yolox_nano_416.onnx")

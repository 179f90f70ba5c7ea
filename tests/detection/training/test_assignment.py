import torch

from track_range.detection.training.losses.assignment import LabelledObjects, assign
from track_range.detection.training.networks.registry import make_network


def objects(*rows):
    """Rows of class, cx, cy, w, h in the first image."""
    table = torch.tensor(rows, dtype=torch.float32).reshape(-1, 5)
    image = torch.zeros(len(table), dtype=torch.int64)
    return LabelledObjects(
        image,
        table[:, 0].long(),
        table[:, 1:],
        torch.zeros(len(table), dtype=torch.bool),
        torch.ones(len(table)),
    )


def cells(assigned):
    return sorted(
        zip(assigned.row.tolist(), assigned.column.tolist(), assigned.anchor.tolist(), strict=True)
    )


def test_centre_cell_and_two_neighbours():
    network = make_network("yolov5n", 2)
    # stride 8: the centre (27, 43) is in column 3 at 0.375 and row 5 at 0.375, so left and upper
    # neighbours are used. 16 x 30 equals the second anchor; the ratios are 1.6 and 3 to the first
    # anchor, 2.06 and 1.3 to the third.
    assigned = assign(objects((0, 27, 43, 16, 30)), network, 0, (10, 10))
    assert cells(assigned) == sorted(
        (row, column, a) for row, column in ((5, 3), (5, 2), (4, 3)) for a in (0, 1, 2)
    )
    assert assigned.object_index.tolist() == [0] * 9


def test_no_neighbour_cells_outside_the_grid():
    network = make_network("yolov5n", 2)
    assigned = assign(objects((0, 1, 79, 16, 30)), network, 0, (10, 10))
    assert {(row, column) for row, column, _ in cells(assigned)} == {(9, 0)}
    assert {
        (r, c) for r, c, _ in cells(assign(objects((0, 80, 80, 16, 30)), network, 0, (10, 10)))
    } <= {
        (9, 9),
        (9, 8),
        (8, 9),
    }


def test_anchors_of_four_times_the_size_are_excluded():
    network = make_network("yolov5n", 2)
    large = objects((1, 40, 40, 150, 150))
    assert [len(assign(large, network, head, (20, 20)).object_index) > 0 for head in range(3)] == [
        False,
        True,
        True,
    ]
    assert len(assign(objects((0, 40, 40, 2.4, 30)), network, 0, (10, 10)).object_index) == 0


def test_no_neighbours_without_centre_scaling():
    network = make_network("yolov4-tiny", 2)
    assigned = assign(objects((0, 17, 17, 30, 40)), network, 0, (8, 8))
    assert {(row, column) for row, column, _ in cells(assigned)} == {(1, 1)}


def test_assigned_targets_are_reachable():
    """Each assigned cell can predict the centre and size of its object."""
    generator = torch.Generator().manual_seed(3)
    for name in ("yolov5n", "yolov4-tiny"):
        network = make_network(name, 2)
        rows = [
            (0, *(20 + 280 * torch.rand(2, generator=generator)).tolist(), w, h)
            for w, h in ((12, 20), (60, 40))
        ]
        targets = objects(*rows)
        for head, stride in enumerate(network.strides_px):
            assigned = assign(targets, network, head, (320 // stride, 320 // stride))
            low, high = (
                network.boxes(
                    torch.tensor([[extreme] * 4]).expand(len(assigned.object_index), 4),
                    torch.stack([assigned.column, assigned.row], 1).float(),
                    network.anchors_px[head][assigned.anchor],
                    stride,
                )
                for extreme in (-12.0, 12.0)
            )
            expected = targets.cxcywh[assigned.object_index]
            assert ((expected >= low - 1e-3) & (expected <= high + 1e-3)).all()


def test_no_objects():
    assert len(assign(objects(), make_network("yolov5n", 2), 0, (4, 4)).object_index) == 0

"""Darknet networks for tests: the structures of three published networks with any width, and random
weights."""

import numpy as np

TINY_ANCHORS = "10,14, 23,27, 37,58, 81,82, 135,169, 344,319"
ANCHORS = "12, 16, 19, 36, 40, 28, 36, 75, 76, 55, 72, 146, 142, 110, 192, 243, 459, 401"


def section(kind, **options):
    return (
        "\n".join([f"[{kind}]", *(f"{key.rstrip('_')}={value}" for key, value in options.items())])
        + "\n\n"
    )


class CfgWriter:
    """Writer of a cfg; `size_px` is (width, height), `width` divides the filters of all layers
    except the outputs."""

    def __init__(self, *, size_px, n_classes, width, anchors, net=""):
        self.n_classes, self.width, self.anchors = n_classes, width, anchors
        self.text = (
            "[net]\n# "
            f"Testing\nbatch=1\nwidth={size_px[0]}\nheight={size_px[1]}\nchannels=3\n{net}\n"
        )

    def add(self, kind, **options):
        self.text += section(kind, **options)
        return self

    def conv(self, filters, size=1, stride=1, activation="leaky"):
        return self._conv(max(4, filters // self.width), size, stride, activation, 1)

    def _conv(self, filters, size, stride, activation, batch_normalize):
        norm = {"batch_normalize": 1} if batch_normalize else {}
        return self.add(
            "convolutional",
            **norm,
            filters=filters,
            size=size,
            stride=stride,
            pad=1,
            activation=activation,
        )

    def route(self, *layers, **options):
        return self.add("route", layers=", ".join(map(str, layers)), **options)

    def head(self, mask, scale_x_y=None):
        n_anchors = len(mask.split(","))
        self._conv(n_anchors * (5 + self.n_classes), 1, 1, "linear", 0)
        stretch = {} if scale_x_y is None else {"scale_x_y": scale_x_y}
        n_all = (self.anchors.count(",") + 1) // 2
        return self.add(
            "yolo",
            mask=mask,
            anchors=self.anchors,
            classes=self.n_classes,
            num=n_all,
            jitter=0.3,
            **stretch,
        )


def yolov4_tiny(*, size_px=(416, 416), n_classes=80, width=1, net=""):
    cfg = CfgWriter(
        size_px=size_px, n_classes=n_classes, width=width, anchors=TINY_ANCHORS, net=net
    )
    cfg.conv(32, 3, 2).conv(64, 3, 2)
    for filters in (64, 128, 256):
        cfg.conv(filters, 3).route(-1, groups=2, group_id=1)
        cfg.conv(filters // 2, 3).conv(filters // 2, 3).route(-1, -2).conv(filters).route(-6, -1)
        cfg.add("maxpool", size=2, stride=2)
    cfg.conv(512, 3).conv(256).conv(512, 3).head("3,4,5", 1.05)
    cfg.route(-4).conv(128).add("upsample", stride=2).route(-1, 23).conv(256, 3).head("1,2,3", 1.05)
    return cfg.text


def yolov3_tiny(*, size_px=(416, 416), n_classes=80, width=1, net=""):
    cfg = CfgWriter(
        size_px=size_px, n_classes=n_classes, width=width, anchors=TINY_ANCHORS, net=net
    )
    for filters in (16, 32, 64, 128, 256):
        cfg.conv(filters, 3).add("maxpool", size=2, stride=2)
    cfg.conv(512, 3).add("maxpool", size=2, stride=1).conv(1024, 3)
    cfg.conv(256).conv(512, 3).head("3,4,5")
    cfg.route(-4).conv(128).add("upsample", stride=2).route(-1, 8).conv(256, 3).head("0,1,2")
    return cfg.text


def yolov4(*, size_px=(608, 608), n_classes=80, width=1, net=""):
    cfg = CfgWriter(size_px=size_px, n_classes=n_classes, width=width, anchors=ANCHORS, net=net)
    cfg.conv(32, 3, activation="mish")
    for filters, n_blocks in ((64, 1), (128, 2), (256, 8), (512, 8), (1024, 4)):
        _cross_stage(cfg, filters, n_blocks)
    cfg.conv(512).conv(1024, 3).conv(512)
    cfg.add("maxpool", stride=1, size=5).route(-2).add("maxpool", stride=1, size=9).route(-4)
    cfg.add("maxpool", stride=1, size=13).route(-1, -3, -5, -6)
    cfg.conv(512).conv(1024, 3).conv(512)
    for filters, layer in ((256, 85), (128, 54)):
        cfg.conv(filters).add("upsample", stride=2).route(layer).conv(filters).route(-1, -3)
        cfg.conv(filters).conv(2 * filters, 3).conv(filters).conv(2 * filters, 3).conv(filters)
    cfg.conv(256, 3).head("0,1,2", 1.2)
    for filters, back, mask, scale in ((256, -16, "3,4,5", 1.1), (512, -37, "6,7,8", 1.05)):
        cfg.route(-4).conv(filters, 3, 2).route(-1, back)
        for _ in range(3):
            cfg.conv(filters).conv(2 * filters, 3)
        cfg.head(mask, scale)
    return cfg.text


def _cross_stage(cfg, filters, n_blocks):
    """Add a stage of CSPDarknet: half the size, two branches, one of them with residual blocks."""
    inner = filters // 2 if n_blocks > 1 else filters
    cfg.conv(filters, 3, 2, "mish").conv(inner, activation="mish").route(-2).conv(
        inner, activation="mish"
    )
    for _ in range(n_blocks):
        cfg.conv(filters // 2, activation="mish").conv(
            filters // 2 if n_blocks > 1 else filters, 3, activation="mish"
        )
        cfg.add("shortcut", from_=-3, activation="linear")
    cfg.conv(inner, activation="mish").route(-1, -(3 * n_blocks + 4)).conv(
        filters, activation="mish"
    )


def assorted(*, size_px=(144, 108), n_classes=3):
    """Options that the published networks do not use: odd strides, groups, padding=, activations,
    upsampling by 3."""
    cfg = CfgWriter(size_px=size_px, n_classes=n_classes, width=1, anchors=TINY_ANCHORS)
    cfg.conv(8, 3, 3, "swish").add("maxpool", size=3, stride=2)
    cfg.add(
        "convolutional",
        batch_normalize=1,
        filters=12,
        groups=4,
        size=3,
        padding=1,
        activation="mish",
    )
    cfg.add("dropout", probability=0.5).add("maxpool", stride=2)
    cfg.add("convolutional", filters=12, size=5, pad=1, activation="logistic")
    cfg.route(-2, groups=3, group_id=1).route(-1, -2).conv(12).add(
        "shortcut", from_=-4, activation="leaky"
    )
    cfg.head("0,1").route(-3).add("upsample", stride=3).conv(6, 3).head("4,5", 1.3)
    return cfg.text


def write_weights(path, network, *, seed, version=(0, 2, 5), gain=2.0, more_variance=0.0):
    """Write random weights of a network (`detection.catalogue.darknet.network.Network`) with batch norm near
    its usual values.

    The format is written independently of the importer, convolution by convolution as Darknet saves
    them.

    Args:
        gain: variance of the weights times fan-in; 2 = He's. Residual blocks need less, because
            their sums grow.
        more_variance: number added to every variance of batch norm.
    """
    rng = np.random.default_rng(seed)
    n_images = np.array([32_013_312], "<u8" if version[0] * 10 + version[1] >= 2 else "<u4")
    parts = [np.array(version, "<i4").tobytes(), n_images.tobytes()]
    for layer in network.layers:
        if type(layer.operation).__name__ != "Convolution":
            continue
        conv = layer.operation
        fan_in = conv.n_channels // conv.groups * conv.size**2
        bias = rng.normal(0, 0.1, conv.n_filters)
        columns = [bias]
        if conv.has_batch_norm:
            scale = rng.uniform(0.7, 1.3, conv.n_filters)
            mean = rng.normal(0, 0.3, conv.n_filters)
            variance = rng.uniform(0.6, 1.6, conv.n_filters)
            columns += [scale, mean, variance + more_variance]
        weights = rng.normal(0, np.sqrt(gain / fan_in), conv.n_filters * fan_in)
        parts += [column.astype("<f4").tobytes() for column in (*columns, weights)]
    path.write_bytes(b"".join(parts))
    return path

"""Nearest road user in front of a webcam, once per second, and collision warnings.

python docs/examples/webcam.py 0 --focal-px 720
python docs/examples/webcam.py dashcam.mp4 --focal-px 1150 --image latest.jpg
"""

import argparse
import time

import cv2

import track_range as tr


def main() -> None:
    """Read the camera until it ends or Ctrl-C is pressed."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("source", help="number of a camera, or a video file")
    parser.add_argument("--focal-px", type=float, required=True, help="focal length in pixels")
    parser.add_argument(
        "--image", help="file of the latest image with boxes and distances, such as latest.jpg"
    )
    options = parser.parse_args()

    is_camera = options.source.isdigit()
    capture, overlay = (
        cv2.VideoCapture(int(options.source) if is_camera else options.source),
        tr.Overlay(),
    )
    next_s, start_s = 0.0, time.monotonic()
    with tr.Pipeline.mono(focal_px=options.focal_px) as pipeline:
        while (image := capture.read()[1]) is not None:
            time_s = (
                time.monotonic() - start_s
                if is_camera
                else capture.get(cv2.CAP_PROP_POS_MSEC) / 1000
            )
            result = pipeline.step(image, time_s)
            for row in result.warnings.active.nonzero()[0]:
                print(f"{time_s:.1f} s: collision warning, {result.objects[row]}")
            nearest = min(
                (t for t in result.objects if t.distance_m > 0),
                key=lambda t: t.distance_m,
                default=None,
            )
            if nearest is None or time_s < next_s:
                continue
            next_s = time_s + 1.0
            print(
                f"{time_s:.1f} s: {nearest.class_name} at {nearest.distance_m:.1f} +- "
                f"{nearest.sigma_m:.1f} m"
            )
            if options.image:
                cv2.imwrite(options.image, overlay.draw(result))


if __name__ == "__main__":
    main()

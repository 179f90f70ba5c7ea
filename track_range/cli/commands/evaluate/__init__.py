"""`track-range evaluate`: errors of tracks, distances, motion, events, detectors and stereo
matchers against labels.
"""

from track_range.cli.shared.lazy import Lazy, lazy_app

app = lazy_app(
    {
        "run": Lazy(
            "track_range.cli.commands.evaluate.run",
            "Errors of the distances, closing speeds and tracks of a finished run.",
            "The rows in the folder of the run are compared with ground truth, without images. "
            "True distances do not depend on the calibration of the run.",
            (
                "track-range evaluate run drive-track-range --truth label.txt",
                "track-range evaluate run drive-track-range --truth radar.csv --store",
            ),
        ),
        "tracks": Lazy(
            "track_range.cli.commands.evaluate.tracks",
            "HOTA, MOTA, IDF1 and related metrics of tracks.",
            "The evaluation follows the rules of KITTI or MOTChallenge, depending on the format of "
            "the ground truth.",
            (
                "track-range evaluate tracks --truth MOT17/train --results tracks",
                "track-range evaluate tracks --truth label_02/ --results tracks --class person",
            ),
        ),
        "stereo": Lazy(
            "track_range.cli.commands.evaluate.stereo",
            "Distance errors of stereo matchers on pairs with true disparities.",
            examples=("track-range evaluate stereo --pairs kitti2015/ --matcher patch,sgbm",),
        ),
        "detections": Lazy(
            "track_range.cli.commands.evaluate.detections",
            "Average precision, calibration of scores, and speed of detectors.",
            "The metrics are computed on labelled images, over all objects and by their size. "
            "Exits with status 1 if a detector could not be evaluated or an image could not be "
            "read.",
            (
                "track-range evaluate detections --model road --model yolov5n.onnx \\\n"
                "      --images images/ --labels labels/",
                "track-range evaluate detections --model road --images images/ \\\n"
                "      --labels labels/ --by height --figure reliability.svg",
            ),
        ),
        "ranges": Lazy(
            "track_range.cli.commands.evaluate.ranges",
            "Distance errors of the ranging methods on labelled boxes, without a video.",
            examples=(
                "track-range evaluate ranges --labels label_02/ --calib calib/",
                "track-range evaluate ranges --labels label_02/ --calib calib/ --noise-px 2",
            ),
        ),
        "motion": Lazy(
            "track_range.cli.commands.evaluate.motion",
            "Errors of closing speed, speed over ground and time to collision, and false alarms.",
            "Motion is measured from labelled boxes of drives with poses, without a video. A speed "
            "is evaluated if its sigma is below 1.5 m/s; each alarm on a drive without a contact "
            "is a false alarm.",
            (
                "track-range evaluate motion --labels label_02/ --calib calib/ --poses poses/",
                "track-range evaluate motion --labels label_02/ --calib calib/ --poses poses/ \\\n"
                "      --boxes rrc:detections --json motion.json",
            ),
        ),
        "cuboids": Lazy(
            "track_range.cli.commands.evaluate.cuboids",
            "Errors of sizes, headings, centres and sides of measured 3-D boxes.",
            "Cuboids are measured from labelled boxes of drives with poses, without a video. "
            "Headings are compared modulo 360 degrees where the object moves, and modulo 180 where "
            "it does not.",
            (
                "track-range evaluate cuboids --labels label_02/ --calib calib/ --poses poses/",
                "track-range evaluate cuboids --labels label_02/ --calib calib/ \\\n"
                "      --poses poses/ --noise-px 2 --json cuboids.json",
            ),
        ),
        "events": Lazy(
            "track_range.cli.commands.evaluate.events",
            "Hits, misses, false alarms and lead times of collision warnings.",
            "The ground truth is contacts, what happens in the recording, or labelled events. A "
            "contact is a hit if its object caused a warning at least 0.8 s before the contact; an "
            "occurrence, if it caused one from its first sight to the conflict.",
            (
                "track-range evaluate events --events drive-1/events.csv \\\n      --truth "
                "drive/contacts.csv",
                "track-range evaluate events --events drive-1 --truth labels.csv",
                "track-range evaluate events --events drive-1 --truth 1_events.csv \\\n"
                "      --events drive-2 --truth 2_events.csv",
                "track-range evaluate events --events drive-1 --events drive-2 --truth none",
            ),
        ),
    }
)

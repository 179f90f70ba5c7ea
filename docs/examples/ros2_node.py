"""A ROS 2 node: rectified images of a stereo camera -> road users with distances, velocities and covariances.

    python3 docs/examples/ros2_node.py --ros-args -r left/image:=/stereo/left/image_rect_color \
        -r right/image:=/stereo/right/image_rect_color -r left/camera_info:=/stereo/left/camera_info \
        -r right/camera_info:=/stereo/right/camera_info -r odometry:=/odom

    detections   vision_msgs/Detection3DArray: class, score, position with covariance, typical size
    tracks       nav_msgs/Odometry of each road user: position and relative velocity with covariances
    ranges       diagnostic_msgs/DiagnosticArray: distances, time to collision, age; WARN = collision warning
    /diagnostics the health of the pipeline by sensor

Positions are the filtered ones, in the frame of the left camera (x right, y down, z forward), which is the frame_id
of the messages. vision_msgs has no velocities; an Odometry has both with covariances, and every ROS installation
has it. Its orientation is that of the frame (unknown: large variances), so that its twist has the same axes; it is
relative to the camera. The ego speed from nav_msgs/Odometry is optional: it makes the collision warnings more
certain.

What drivers and bags do is logged in a sentence, at most every 5 s, and the node goes on: repeated and older stamps,
a loop of a bag (another drive starts), other encodings and sizes, cameras without a calibration.
"""

from typing import Any

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from message_filters import ApproximateTimeSynchronizer, Subscriber
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose

import track_range as tr

UNKNOWN_VARIANCE = 1e6  # of rotations, which the images do not show: filters then do not use them
LOOP_NS = 1_000_000_000  # from which a step back in time is another drive, and not a late message
LOG_S = 5.0  # between two log messages of a kind
HEALTH_S = 1.0  # between two messages on the health
LEVELS = {"ok": b"\x00", "warning": b"\x01", "error": b"\x02"}  # of DiagnosticStatus


def image_of(message: Any) -> np.ndarray:
    """(H, W, 3) uint8 BGR image of a sensor_msgs/Image; FrameError for unknown encodings."""
    return tr.decoded_image(
        message.data,
        message.encoding,
        message.width,
        message.height,
        step=message.step,
        is_bigendian=bool(message.is_bigendian),
    )


def camera_of(info: Any, width_px: int, height_px: int, name: str) -> tr.PinholeCamera:
    """Camera of rectified images of this size, which may be another one than in the
    sensor_msgs/CameraInfo.
    """
    fx, fy, cx, cy = (float(info.p[place]) for place in (0, 5, 2, 6))
    if not (fx > 0 and fy > 0):
        raise ValueError(
            f"{name}/camera_info: expected P with a focal length, found {fx:g}; calibrate the "
            "camera, and publish the camera_info of the rectified images."
        )
    width, height = info.width or width_px, info.height or height_px
    scale = width_px / width
    if abs(height_px / height / scale - 1.0) > 0.01:
        raise ValueError(
            f"{name}/image: expected {width}x{height} px as in camera_info, or smaller ones of the "
            f"same shape, found {width_px}x{height_px} px."
        )
    centre = (cx + 0.5) * scale - 0.5, (cy + 0.5) * scale - 0.5  # pixel centres at integers
    return tr.PinholeCamera(fx * scale, fy * scale, *centre, width_px=width_px, height_px=height_px)


def rig_of(left: Any, right: Any, left_px: Any, right_px: Any) -> tr.StereoRig:
    """Rig of two sensor_msgs/CameraInfo for images of (width, height) pixels; P[0, 3] of the right
    camera is -fx * baseline.
    """
    cameras = camera_of(left, *left_px, "left"), camera_of(right, *right_px, "right")
    right_from_left = np.eye(4)
    right_from_left[0, 3] = right.p[3] / right.p[0]
    if not right_from_left[0, 3] < 0:
        raise ValueError(
            f"right/camera_info: expected P[0, 3] = -fx * baseline below 0, found {right.p[3]:g}; "
            "check the calibration of the pair, and that left and right are not exchanged."
        )
    return tr.StereoRig(*cameras, right_from_left)


def stamp_ns(stamp: Any) -> int:
    """Nanoseconds of a builtin_interfaces/Time."""
    return int(stamp.sec) * 1_000_000_000 + int(stamp.nanosec)


def covariance_of(covariance: Any) -> list[float]:
    """(6, 6) covariance, row by row, of a (3, 3) one and of unknown rotations."""
    whole = np.diag(np.full(6, UNKNOWN_VARIANCE))
    whole[:3, :3] = covariance
    return [float(value) for value in whole.ravel()]


def detection_of(t: tr.TrackedObject, header: Any) -> Any:
    """vision_msgs/Detection3D of an object with a known distance."""
    detection, hypothesis = Detection3D(header=header, id=str(t.id)), ObjectHypothesisWithPose()
    hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = t.class_name, t.score
    position = hypothesis.pose.pose.position
    position.x, position.y, position.z = t.in_camera.position_m
    hypothesis.pose.covariance = covariance_of(t.in_camera.covariance_m2)
    length_m, width_m, height_m = t.size_m
    size, centre = detection.bbox.size, detection.bbox.center.position
    size.x, size.y, size.z = width_m, height_m, length_m  # seen from behind: right, down, forward
    # the position is on the near side
    centre.x, centre.y, centre.z = position.x, position.y, position.z + length_m / 2
    detection.results = [hypothesis]
    return detection


def track_of(t: tr.TrackedObject, header: Any) -> Any:
    """nav_msgs/Odometry of an object with a known velocity."""
    track = Odometry(header=header, child_frame_id=f"track_{t.id}")
    position, velocity = track.pose.pose.position, track.twist.twist.linear
    position.x, position.y, position.z = t.in_camera.position_m
    velocity.x, velocity.y, velocity.z = t.in_camera.velocity_mps
    track.pose.covariance = covariance_of(t.in_camera.covariance_m2)
    track.twist.covariance = covariance_of(t.in_camera.velocity_covariance_m2ps2)
    return track


def status_of(t: tr.TrackedObject, *, is_warning: bool) -> Any:
    """diagnostic_msgs/DiagnosticStatus with the figures of an object; unknown ones are left out."""
    figures = {
        "distance_m": t.filtered_m,
        "sigma_m": t.filtered_sigma_m,
        "gap_m": t.gap_m,
        "closing_mps": t.closing_mps,
        "closing_sigma_mps": t.closing_sigma_mps,
        "ttc_s": t.ttc_s,
        "ttc_sigma_s": t.ttc_sigma_s,
        "speed_mps": t.speed_mps,
        "age_s": t.age_s,
        "unobserved_s": t.unobserved_s,
    }
    known = {name: value for name, value in figures.items() if np.isfinite(value)}
    return DiagnosticStatus(
        level=LEVELS["warning" if is_warning else "ok"],
        name=f"track {t.id}",
        message=" ".join([t.class_name, t.state]).strip(),
        values=[KeyValue(key=name, value=f"{value:.4g}") for name, value in known.items()],
    )


class RangeNode(Node):
    """Publishes the road users of each pair of images."""

    def __init__(self) -> None:
        super().__init__("track_range")
        self.pipeline: Any = None
        self.opened_for: Any = None  # sizes of the images and calibrations of the pipeline
        self.last_ns: int | None = None
        self.last_health_s = -HEALTH_S
        self.logged_codes: frozenset[str] = frozenset()
        self.ego_speed_mps: float | None = None
        self.detections = self.create_publisher(Detection3DArray, "detections", 10)
        self.tracks = self.create_publisher(Odometry, "tracks", 100)
        self.ranges = self.create_publisher(DiagnosticArray, "ranges", 10)
        self.diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_subscription(Odometry, "odometry", self.on_odometry, qos_profile_sensor_data)
        topics = {"image": Image, "camera_info": CameraInfo}
        subscribers = [
            Subscriber(self, kind, f"{side}/{name}", qos_profile=qos_profile_sensor_data)
            for name, kind in topics.items()
            for side in ("left", "right")
        ]
        self.synchronizer = ApproximateTimeSynchronizer(subscribers, queue_size=4, slop=0.01)
        self.synchronizer.registerCallback(self.on_pair)

    def on_odometry(self, message: Any) -> None:
        """Store the speed along the camera's axis."""
        self.ego_speed_mps = message.twist.twist.linear.x

    def on_pair(self, left: Any, right: Any, left_info: Any, right_info: Any) -> None:
        """Process a pair of images and publish its road users; a pair that cannot be used is left
        out, with a log message.
        """
        try:
            time_ns = stamp_ns(left.header.stamp)
            if not self.is_new(time_ns):
                return
            images = image_of(left), image_of(right)
            self.open(images, (left_info, right_info))
            result = self.pipeline.step(*images, time_ns=time_ns, ego_speed_mps=self.speed())
            self.last_ns = time_ns
        except tr.errors.RigError as error:  # such as exchanged cameras: known after some frames
            self.get_logger().error(str(error), throttle_duration_sec=LOG_S)
            self.start_again()
        except (tr.errors.UserError, ValueError) as error:
            self.get_logger().warning(str(error), throttle_duration_sec=LOG_S)
        else:
            self.publish(result, left.header)

    def speed(self) -> float | None:
        """The ego speed, if it is that of a vehicle."""
        speed_mps = self.ego_speed_mps
        is_usable = speed_mps is not None and -20.0 <= speed_mps <= 100.0
        return speed_mps if is_usable else None

    def is_new(self, time_ns: int) -> bool:
        """Whether a stamp is after the last one; a step far back starts another drive."""
        last_ns = self.last_ns
        if last_ns is None or time_ns > last_ns:
            return True
        back_s = (last_ns - time_ns) / 1e9
        if last_ns - time_ns < LOOP_NS:
            self.get_logger().warning(
                f"left/image: expected a later stamp than the last one, found one {back_s:.3f} s "
                "earlier; this pair is left out.",
                throttle_duration_sec=LOG_S,
            )
            return False
        self.get_logger().warning(
            f"The stamps went back by {back_s:.1f} s, as in a loop of a bag: another drive starts."
        )
        self.start_again()
        return True

    def start_again(self) -> None:
        """Forget the tracks and the estimates."""
        self.last_ns, self.last_health_s = None, -HEALTH_S
        if self.pipeline is not None:
            self.pipeline.reset()

    def open(self, images: Any, infos: Any) -> None:
        """Make the pipeline for these images and calibrations, if it is not for them already."""
        sizes = [(image.shape[1], image.shape[0]) for image in images]
        wanted = sizes, [(tuple(info.p), info.width, info.height) for info in infos]
        if wanted == self.opened_for:
            return
        rig = rig_of(*infos, *sizes)
        if self.pipeline is not None:
            self.get_logger().warning(
                f"The images or their calibration changed, to {sizes[0][0]}x{sizes[0][1]} px: "
                "another drive starts."
            )
            self.pipeline.close()
        self.pipeline, self.opened_for = tr.Pipeline.stereo(rig), wanted
        self.start_again()

    def publish(self, result: tr.FrameResult, header: Any) -> None:
        """Publish the road users of a frame, and once per second the health."""
        objects = result.objects
        placed = [t for t in objects if np.isfinite(t.in_camera.covariance_m2).all()]
        detections = [detection_of(t, header) for t in placed]
        self.detections.publish(Detection3DArray(header=header, detections=detections))
        for t in placed:
            if np.isfinite(t.in_camera.velocity_covariance_m2ps2).all():
                self.tracks.publish(track_of(t, header))
        active = result.warnings.active.tolist()
        statuses = [status_of(t, is_warning=a) for t, a in zip(objects, active, strict=True)]
        self.ranges.publish(DiagnosticArray(header=header, status=statuses))
        for t, is_active in zip(objects, active, strict=True):
            if is_active:
                self.get_logger().warning(f"collision warning: {t}", throttle_duration_sec=LOG_S)
        if result.time_s >= self.last_health_s + HEALTH_S:
            self.last_health_s = result.time_s
            self.publish_health(header)

    def publish_health(self, header: Any) -> None:
        """Publish the state of each sensor, and log problems that are new."""
        health = self.pipeline.health
        statuses = []
        for sensor, severity in health.sensors.items():
            items = [item for item in health.items if item.sensor == sensor]
            worst = next(item for item in items if item.severity == severity)
            values = [KeyValue(key=item.code, value=item.sentence) for item in items]
            status = DiagnosticStatus(level=LEVELS[severity], name=f"track_range: {sensor}")
            status.message, status.values = worst.code, values
            statuses.append(status)
        self.diagnostics.publish(DiagnosticArray(header=header, status=statuses))
        for item in health.items:
            if item.severity != "ok" and item.code not in self.logged_codes:
                self.get_logger().warning(item.sentence)
        self.logged_codes = health.codes


def main() -> None:
    """Run the node until Ctrl-C is pressed."""
    rclpy.init()
    rclpy.spin(RangeNode())


if __name__ == "__main__":
    main()

"""A ROS 2 node: rectified images of a stereo camera -> vision_msgs/Detection3DArray with distances and sigmas.

    python3 docs/examples/ros2_node.py --ros-args -r left/image:=/stereo/left/image_rect_color \
        -r right/image:=/stereo/right/image_rect_color -r left/camera_info:=/stereo/left/camera_info \
        -r right/camera_info:=/stereo/right/camera_info -r odometry:=/odom

Positions are in the frame of the left camera (x right, y down, z forward), which is the frame_id of the messages. The
ego speed from nav_msgs/Odometry is optional: it makes the collision warnings, which the node logs, more certain.
"""

import math
from typing import Any

import numpy as np
import rclpy
from message_filters import ApproximateTimeSynchronizer, Subscriber
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import qos_profile_sensor_data
from sensor_msgs.msg import CameraInfo, Image
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose

import track_range as tr

CHANNELS = {"bgr8": 3, "rgb8": 3, "mono8": 1}


def bgr_image(message: Any) -> np.ndarray:
    """(H, W, 3) uint8 BGR image of a sensor_msgs/Image."""
    if message.encoding not in CHANNELS:
        raise ValueError(f"encoding: expected {', '.join(CHANNELS)}, got {message.encoding}")
    channels = CHANNELS[message.encoding]
    rows = np.frombuffer(message.data, np.uint8).reshape(
        message.height, message.step
    )  # rows may end with padding
    image = rows[:, : message.width * channels].reshape(message.height, message.width, channels)
    image = {"bgr8": image, "rgb8": image[:, :, ::-1], "mono8": image.repeat(3, axis=2)}[
        message.encoding
    ]
    return np.ascontiguousarray(image)


def camera_of(info: Any) -> tr.PinholeCamera:
    """Camera of the rectified images that a sensor_msgs/CameraInfo describes."""
    return tr.PinholeCamera(
        info.p[0], info.p[5], info.p[2], info.p[6], width_px=info.width, height_px=info.height
    )


def rig_of(left: Any, right: Any) -> tr.StereoRig:
    """Rig of two sensor_msgs/CameraInfo; P[0, 3] of the right camera is -fx * baseline."""
    right_from_left = np.eye(4)
    right_from_left[0, 3] = right.p[3] / right.p[0]
    return tr.StereoRig(camera_of(left), camera_of(right), right_from_left)


def seconds(stamp: Any) -> float:
    """Time of a builtin_interfaces/Time."""
    return float(stamp.sec + 1e-9 * stamp.nanosec)


def detection_of(t: tr.TrackedObject, score: float, header: Any) -> Any:
    """vision_msgs/Detection3D of an object with a known distance."""
    detection, hypothesis = Detection3D(header=header, id=str(t.id)), ObjectHypothesisWithPose()
    hypothesis.hypothesis.class_id, hypothesis.hypothesis.score = t.class_name, score
    position = hypothesis.pose.pose.position
    position.x, position.y, position.z = t.position_m
    hypothesis.pose.covariance[14] = t.sigma_m**2  # of z, in row 2 and column 2 of (6, 6)
    detection.results.append(hypothesis)
    detection.bbox.center = hypothesis.pose.pose
    return detection


class RangeNode(Node):
    """Publishes the road users of each pair of images on `detections`."""

    def __init__(self) -> None:
        super().__init__("track_range")
        self.pipeline: Any = None
        self.start_s, self.ego_speed_mps = 0.0, None
        self.publisher = self.create_publisher(Detection3DArray, "detections", 10)
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
        """Process a pair of images and publish its road users."""
        if self.pipeline is None:
            self.pipeline = tr.Pipeline.stereo(rig_of(left_info, right_info))
            self.start_s = seconds(left.header.stamp)
        time_s = seconds(left.header.stamp) - self.start_s
        result = self.pipeline.step(
            bgr_image(left), bgr_image(right), time_s, ego_speed_mps=self.ego_speed_mps
        )
        scored = zip(result.objects, result.tracks.score.tolist(), strict=True)
        detections = [
            detection_of(t, score, left.header)
            for t, score in scored
            if math.isfinite(t.distance_m)
        ]
        self.publisher.publish(Detection3DArray(header=left.header, detections=detections))
        for row in np.flatnonzero(result.warnings.active):
            self.get_logger().warning(f"collision warning: {result.objects[row]}")


def main() -> None:
    """Run the node until Ctrl-C is pressed."""
    rclpy.init()
    rclpy.spin(RangeNode())


if __name__ == "__main__":
    main()

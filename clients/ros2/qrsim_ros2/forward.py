"""Fly a vehicle of 'qrsim ros2' forward: ros2 run qrsim_ros2 forward --ros-args -p vehicle:=pelicans_0."""

import rclpy
from geometry_msgs.msg import PoseStamped, Twist
from rclpy.node import Node


class Forward(Node):
    """Repeats a velocity, and prints where the vehicle is."""

    def __init__(self):
        super().__init__("forward")
        vehicle = self.declare_parameter("vehicle", "pelicans_0").value
        self._motion = Twist()
        self._motion.linear.x = self.declare_parameter("speed", 2.0).value
        self._publisher = self.create_publisher(Twist, f"/{vehicle}/cmd_vel", 1)
        self.create_subscription(PoseStamped, f"/{vehicle}/pose", self._look, 10)
        # More often than 'qrsim ros2 --hold' asks for.
        self.create_timer(0.1, lambda: self._publisher.publish(self._motion))

    def _look(self, pose):
        place = pose.pose.position
        text = f"east {place.x:.1f} m, north {place.y:.1f} m, up {place.z:.1f} m"
        self.get_logger().info(text, throttle_duration_sec=1.0)


def main():
    """Fly."""
    rclpy.init()
    rclpy.spin(Forward())

"""Moves the grasper along a line of 1 cm in front of the heart: 4 s at 125 Hz."""

import math
import time

import rclpy
from geometry_msgs.msg import PoseStamped

rclpy.init()
node = rclpy.create_node("my_tool")
publisher = node.create_publisher(PoseStamped, "tools/grasper/servo_cp", 1)
for step in range(500):  # 4 s at 125 Hz along a line of 1 cm in front of the heart
    pose = PoseStamped()
    pose.header.frame_id, pose.header.stamp = "organ", node.get_clock().now().to_msg()
    pose.pose.position.x, pose.pose.position.z = 0.035, -0.007
    pose.pose.position.y = 0.012 + 0.01 * math.sin(math.pi * step / 500)
    publisher.publish(pose)
    time.sleep(1 / 125)

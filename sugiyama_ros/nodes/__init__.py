"""ROS 2 nodes: the only folder that imports rclpy. Each node only carries messages to and from the code below it."""

from sugiyama_ros.nodes.base import environment

environment.find_packages()

"""ROS 2 nodes: the only folder that imports rclpy. A node only carries messages to and from the code below it."""

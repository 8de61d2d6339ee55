"""Bridges from messages of other packages to vehicles on a road; one entry per message type. Needs no ROS."""

"""Bridges from messages of other packages to vehicles on a road: one file per message type. Needs no ROS."""

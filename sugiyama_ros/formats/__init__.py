"""Readers of other people's files; MCAP files in and out. Works without ROS."""

from sugiyama_ros.formats.trajectory_files import read_trajectories

__all__ = ["read_trajectories"]

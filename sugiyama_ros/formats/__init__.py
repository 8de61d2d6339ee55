"""Readers of trajectory files; MCAP files in and out. Works without ROS."""

from sugiyama_ros.formats.format import Format
from sugiyama_ros.formats.registry import read_tracks

__all__ = ["Format", "read_tracks"]

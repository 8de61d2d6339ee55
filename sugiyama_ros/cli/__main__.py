"""``python -m sugiyama_ros.cli``."""

from sugiyama_ros.cli import main

main()

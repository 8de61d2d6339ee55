"""Controllers of vehicles, one file each. ``sugiyama_ros.controllers`` is a mapping of names to controllers."""

import sys

from sugiyama_ros.plugins import ExtensionModule

sys.modules[__name__].__class__ = ExtensionModule

"""Physical effects, one file each. In Python ``sugiyama_ros.effects`` is a mapping of names to effects."""

import sys

from sugiyama_ros.plugins import ExtensionModule

sys.modules[__name__].__class__ = ExtensionModule

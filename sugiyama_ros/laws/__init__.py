"""Car-following laws, one file each. In Python ``sugiyama_ros.laws`` is a mapping of names to laws."""

import sys

from sugiyama_ros.plugins import ExtensionModule

sys.modules[__name__].__class__ = ExtensionModule

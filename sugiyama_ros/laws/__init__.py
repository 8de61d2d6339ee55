"""Car-following laws, one file each. In Python ``sugiyama_ros.laws`` is a mapping of names to laws."""

import sys

from sugiyama_ros.plugins import ExtensionModule

#: Name of the paper's driver model. The other laws are compared with it.
PAPERS = "adaptive_seek"

sys.modules[__name__].__class__ = ExtensionModule

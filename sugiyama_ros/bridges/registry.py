"""All bridges, by the type of their message."""

from importlib import import_module

from sugiyama_ros.bridges.fields import Bridge

_MODULES = ("odometry", "detections", "tracked_objects", "derived_objects")
BRIDGES: dict[str, Bridge] = {
    bridge.type: bridge for bridge in (import_module(f"sugiyama_ros.bridges.{name}").BRIDGE for name in _MODULES)
}

"""Live, honest estimation of how people drive.

The Python interface in one line each, with ``import sugiyama_ros as sg``:

- ``sg.read(source)``: tracks from files or a data frame;
- ``sg.simulate()``: drivers on a ring or an open road, with hidden effects if wanted;
- ``sg.simulate_lane_changes()``, ``sg.lane_changes(tracks)``: drivers who change lanes, and how they choose;
- ``sg.calibrate(tracks)``: every driver's parameters, and how well the data hold them;
- ``sg.compare(tracks)``: held-out errors beside other car-following laws;
- ``sg.diagnose(tracks)``: which physical effect the model lacks;
- ``sg.read_road(path)``: a road as a graph: lanes, places where they meet, and signals;
- ``sg.filter_plane(x_m, y_m, line, period_s)``: a car in the plane, with heading and steering angle;
- ``sg.read_recording(path)``: what the estimators published in a recorded run;
- ``sg.report(run, page)``: a page about a recorded run, with a diagnosis if there is one;
- ``sg.laws``, ``sg.effects``, ``sg.controllers``: what can be simulated, fitted and added, by name.

Importing the package loads nothing else: what a name needs is loaded when the name is first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from sugiyama_ros import controllers, effects, laws
    from sugiyama_ros.api import (
        calibrate,
        compare,
        diagnose,
        filter_plane,
        lane_changes,
        read,
        read_recording,
        read_road,
        report,
        simulate,
        simulate_lane_changes,
    )

    __version__: str

__all__ = [
    "__version__",
    "calibrate",
    "compare",
    "controllers",
    "diagnose",
    "effects",
    "filter_plane",
    "lane_changes",
    "laws",
    "read",
    "read_recording",
    "read_road",
    "report",
    "simulate",
    "simulate_lane_changes",
]


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        return version("sugiyama_ros")
    if name in ("controllers", "effects", "laws"):
        return import_module(f"sugiyama_ros.{name}")
    if name in __all__:
        return getattr(import_module("sugiyama_ros.api"), name)
    raise AttributeError(f"module 'sugiyama_ros' has no attribute {name!r}")


def __dir__() -> list[str]:
    return __all__

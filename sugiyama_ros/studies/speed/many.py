"""The causal calibration of many drivers on all cores."""

import os

import numpy as np

from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, simulate
from sugiyama_ros.studies.rings import LENGTH_M, alike
from sugiyama_ros.studies.speed.figure import SpeedFigure
from sugiyama_ros.workers import workers

_DRIVERS, _DURATION_S, _CARS_IN_A_GROUP = 10_000, 60.0, 22
#: Wanted share of the process that hands out the work [%].
SERIAL_AT_MOST = 1.0
# Gaps [m] within a group of cars and behind it. So each group makes its own wave.
_GAP_M, _GAP_BEHIND_M = 6.0, 120.0


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the CPU time for many drivers; it includes the start of the processes that share the work."""
    length = np.full(_DRIVERS, LENGTH_M)
    is_last = np.arange(_DRIVERS) % _CARS_IN_A_GROUP == _CARS_IN_A_GROUP - 1
    gap = np.where(is_last, _GAP_BEHIND_M, _GAP_M)
    end = np.cumsum(length + gap)
    road, rng = Road(float(end[-1])), np.random.default_rng(1)
    simulator = Simulator(alike(_DRIVERS), length, end - length - gap, road, rng)
    measured = simulate(simulator, _DURATION_S, stop_at_collision=False).measured
    before = os.times()
    with workers(_DRIVERS) as work:
        each_driver(measured, Settings(), work=work)
    after = os.times()
    here = after.user + after.system - before.user - before.system
    everywhere = here + after.children_user + after.children_system - before.children_user - before.children_system
    text = f"calibration of {_DRIVERS:,} drivers of {_DURATION_S:.0f} s, causal form, in processes on all cores"
    share = "share of the process that hands out the work"
    return (
        SpeedFigure("many_drivers_s", text, everywhere, "s of CPU time"),
        SpeedFigure("many_drivers_serial", share, 100.0 * here / everywhere, "%", SERIAL_AT_MOST),
    )

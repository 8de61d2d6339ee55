"""Calibration of all drivers in both formulations, compared with what it consists of."""

from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.filters import causal, paper
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.studies.speed.figure import SpeedFigure, cpu_of_functions
from sugiyama_ros.studies.speed.floors import exponentials
from sugiyama_ros.studies.speed.passes import counted
from sugiyama_ros.studies.speed.recording import jam

#: Wanted CPU time [s] of a causal calibration of 22 drivers.
AT_MOST_S = 3.0


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the calibration of 22 drivers one by one, on one thread."""
    t, p = jam(), defaults()
    drivers = range(len(t.vehicle))
    chains, floors = [chain_behind(t, i) for i in drivers], [exponentials(paper.perceive(t, i)) for i in drivers]
    spent = cpu_of_functions(
        {
            "floor": lambda: [floor() for floor in floors],
            "pass": lambda: [causal.log_likelihood(chain, p) for chain in chains],
            "paper": lambda: each_driver(t, Settings("paper")),
        },
        rounds=10,
    )
    passes, causal_s = counted(lambda: each_driver(t, Settings("causal")))
    cars = len(chains)
    return (
        SpeedFigure(
            "paper_calibrate_s", f"calibration of {cars} drivers in the paper's form", spent["paper"], "s of CPU time"
        ),
        SpeedFigure(
            "paper_calibrate_over_floor",
            "the same over the exponentials of one likelihood of each driver",
            spent["paper"] / spent["floor"],
        ),
        SpeedFigure(
            "causal_calibrate_s", f"calibration of {cars} drivers, causal form", causal_s, "s of CPU time", AT_MOST_S
        ),
        SpeedFigure(
            "causal_calibrate_passes", "passes of the filter over one driver in this calibration", passes, "passes"
        ),
        SpeedFigure(
            "causal_calibrate_over_pass",
            "the same calibration over one pass over each driver",
            causal_s / spent["pass"],
        ),
    )

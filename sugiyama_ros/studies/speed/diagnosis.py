"""The diagnosis of 22 drivers: its CPU time, and how often it filters a driver.

Nothing is missing in this recording, so the search ends after one round. Each effect that is found adds a round.
"""

import os

from sugiyama_ros.diagnosis.diagnose import diagnose
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.filters import causal
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.studies.speed.figure import SpeedFigure, cpu_of_functions
from sugiyama_ros.studies.speed.passes import counted
from sugiyama_ros.studies.speed.recording import jam

#: Wanted CPU time [s] of the diagnosis.
AT_MOST_S = 15.0


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the diagnosis on all cores, with the options of ``sugiyama diagnose``."""
    t = jam()
    chains = [chain_behind(t, i) for i in range(len(t.vehicle))]
    one_pass = cpu_of_functions(
        {"pass": lambda: [causal.log_likelihood(chain, defaults()) for chain in chains]}, rounds=10
    )["pass"]
    passes, cpu_s = counted(lambda: diagnose(t, workers=os.cpu_count() or 1))
    return (
        SpeedFigure("diagnosis_s", f"diagnosis of {len(chains)} drivers", cpu_s, "s of CPU time", AT_MOST_S),
        SpeedFigure("diagnosis_passes", "passes of the filter over one driver in this diagnosis", passes, "passes"),
        SpeedFigure("diagnosis_over_pass", "the same diagnosis over one pass over each driver", cpu_s / one_pass),
    )

"""Compile the code of the package now, so that no later command has to wait for it.

    python -m sugiyama_ros.compile

The Makefile calls this after an installation. Compiled code is kept (see `sugiyama_ros.jit`), so a second call takes
seconds. The code is compiled by doing every kind of work once, on a small simulated recording. One function has a
version for each number of periods that drivers look ahead (the paper's mean action, whose loop is unrolled). So the
paper's calibration compiles a little more for recordings whose period is not about 1/3 s. Python's own bytecode is
written too, because Python itself does not write it where PYTHONDONTWRITEBYTECODE is set, as in many containers.
"""

import compileall
import sys
import time
from collections.abc import Callable
from pathlib import Path

from sugiyama_ros.api import simulate
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.diagnosis.compare import compare
from sugiyama_ros.diagnosis.diagnosis import diagnose
from sugiyama_ros.diagnosis.use import Goal
from sugiyama_ros.driver.parameters import NAMES, defaults
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.filters.online import OnlineFilter, warm_up
from sugiyama_ros.filters.shown import shown_of
from sugiyama_ros.trajectories.trajectories import Trajectories

_VEHICLES, _RING_M, _DURATION_S = 3, 35.0, 30.0
# An effect on what is measured: the filters then call functions that the base model does without.
_EFFECT, _VALUES = "outlier_noise", {"share": 0.03, "factor": 3.0}


def compile_all(tell: Callable[[str], None] = print) -> None:
    """Do every kind of work that needs compiled code.

    Parameters
    ----------
    tell : callable
        Called with one line of text before and after each kind of work.
    """
    compileall.compile_dir(Path(__file__).parent, quiet=2)  # says nothing where the package cannot be written
    recording = simulate(_VEHICLES, ring_m=_RING_M, duration_s=_DURATION_S, effects={_EFFECT: _VALUES}).measured
    work: dict[str, Callable[[], object]] = {
        "the paper's calibration": lambda: each_driver(recording, Settings("paper")),
        "the causal calibration": lambda: each_driver(recording, Settings("causal")),
        "the online filter": lambda: _follow(recording),
        "the comparison with other laws": lambda: compare(recording, [_EFFECT]),
        "the diagnosis": lambda: diagnose(recording, quick=True, goal=Goal(most=1)),
    }
    for number, (what, carry_out) in enumerate(work.items()):
        began = time.monotonic()
        carry_out()
        tell(f"    {number + 1} of {len(work)}: {what}, {time.monotonic() - began:.0f} s")


def _follow(recording: Trajectories) -> None:
    """Filter a few samples of one driver online, without and with effects, and show the parameters."""
    warm_up()
    row = switch_on(ROW.with_effects(defaults()), _EFFECT, _VALUES)
    online = OnlineFilter(recording.period_s, recording.road, row)
    length, vehicles = recording.length_m.tolist(), recording.vehicle.tolist()
    for time_s, position in zip(recording.time_s[:10].tolist(), recording.position_m.tolist(), strict=False):
        online.step(position, vehicles, length, time_s, (position[-1], vehicles[-1], length[-1]))
    shown_of(online, range(len(NAMES)))


if __name__ == "__main__":
    compile_all(lambda line: print(line, file=sys.stderr, flush=True))

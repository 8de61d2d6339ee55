"""Compile the code of the package now, so that no later command has to wait for it.

    python -m sugiyama_ros.compile

The Makefile calls this after an installation. Compiled code is kept (see `sugiyama_ros.jit`), so a second call takes
seconds. The code is compiled by doing every kind of work once, on a small simulated recording. The online filter, which
is a third of the code, is compiled in a process of its own at the same time. One function has a version for each number
of periods that drivers look ahead (the paper's mean action, whose loop is unrolled). So the paper's calibration
compiles a little more for recordings whose period is not about 1/3 s. Python's own bytecode is written too, because
Python itself does not write it where PYTHONDONTWRITEBYTECODE is set, as in many containers.
"""

import compileall
import sys
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from functools import cache
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from sugiyama_ros.api import filter_plane, lane_changes, simulate, simulate_lane_changes
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.diagnosis.diagnose import diagnose
from sugiyama_ros.driver.parameters import REFERENCE_PERIOD_S, defaults
from sugiyama_ros.effects.control import compile_functions
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.filters.online import OnlineFilter, warm_up
from sugiyama_ros.road import Road
from sugiyama_ros.verdict.compare import compare

_VEHICLES, _RING_M, _DURATION_S = 3, 35.0, 30.0
# An effect on what is measured: the filters then call functions that the base model does without.
_EFFECT, _VALUES = "outlier_noise", {"share": 0.03, "factor": 3.0}
_ONLINE, _PARTS = "the online filter", 8


def compile_all(tell: Callable[[str], None] = print) -> None:
    """Do every kind of work that needs compiled code."""
    compileall.compile_dir(Path(__file__).parent, quiet=2)  # says nothing where the package cannot be written
    for part, (what, carry_out) in enumerate(_work().items(), 1):
        _compile(part, what, carry_out, tell)


def _work() -> dict[str, Callable[[], object]]:
    """Return all kinds of work, by their names."""
    simulated: dict[str, Any] = {"ring_m": _RING_M, "duration_s": _DURATION_S, "effects": {_EFFECT: _VALUES}}
    recording = cache(lambda: simulate(_VEHICLES, **simulated).measured)
    return {
        _ONLINE: _follow,
        "the effects and the laws": compile_functions,
        "the paper's calibration": lambda: each_driver(recording().dense(), Settings("paper")),
        "the causal calibration": lambda: each_driver(recording().dense(), Settings("causal")),
        "the comparison with other laws": lambda: compare(recording(), [_EFFECT]),
        "the filter in the plane": lambda: filter_plane([0.0] * 3, [0.0] * 3, [(0.0, 0.0), (9.0, 0.0)], 0.1),
        "changes of lane": lambda: lane_changes(simulate_lane_changes(30, 3, 60.0)),
        "the diagnosis": lambda: diagnose(recording(), simulations=1, most=1),
    }


def _compile(part: int, what: str, carry_out: Callable[[], object], tell: Callable[[str], None]) -> None:
    """Do one kind of work, and tell its number and its time."""
    began = time.monotonic()
    carry_out()
    tell(f"    {part} of {_PARTS}: {what}, {time.monotonic() - began:.0f} s")


def _compile_half(online: bool) -> None:
    """Do the work with the online filter, or all other work, in a process of its own."""
    for part, (what, carry_out) in enumerate(_work().items(), 1):
        if (what == _ONLINE) == online:
            _compile(part, what, carry_out, _print)


def _print(line: str) -> None:
    print(line, file=sys.stderr, flush=True)


def _follow() -> None:
    """Filter a few samples of one driver online, without and with effects."""
    warm_up()
    row = switch_on(ROW.with_effects(defaults()), _EFFECT, _VALUES)
    online = OnlineFilter(REFERENCE_PERIOD_S, Road(_RING_M), row)
    vehicles, length = list(range(_VEHICLES)), [4.0] * _VEHICLES
    for sample in range(10):
        time_s = sample * REFERENCE_PERIOD_S
        position = [(m * _RING_M / _VEHICLES + 5.0 * time_s) % _RING_M for m in vehicles]
        online.step(position, vehicles, length, time_s, (position[-1], vehicles[-1], length[-1]))


def main() -> None:
    """Compile everything, in two processes."""
    compileall.compile_dir(Path(__file__).parent, quiet=2)
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as processes:
        list(processes.map(_compile_half, (True, False)))


if __name__ == "__main__":
    main()

"""How speed is measured: figures, CPU time, passes of the filter, and the recording on which all parts measure."""

import math
import os
import subprocess
import threading
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple
from unittest import mock

from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.filters import causal
from sugiyama_ros.filters.causal import Observed
from sugiyama_ros.filters.causal import run as run_filter
from sugiyama_ros.studies.rings import CARS, RING_M, Ring, run
from sugiyama_ros.trajectories.dense import DenseTracks

# Duration of the recording [s], as in the experiment.
_DURATION_S = 250.0
_SEED = 4
# A function is called so often that the clock runs for at least this time [s].
_SPAN_S = 0.005
# Time [s] after which it is looked again whether a command has ended.
_LOOK_S = 0.02


@cache
def jam(cars: int = CARS, duration_s: float = _DURATION_S) -> DenseTracks:
    """Simulate a jam on a ring of as many metres for each car as in the experiment.

    duration_s: duration [s].
    """
    ring_m = RING_M * cars / CARS
    ring = Ring(defaults(cars), _SEED, jammed=True, duration_s=duration_s, ring_m=ring_m)
    return run(ring).dense


@dataclass(frozen=True)
class SpeedFigure:
    """A figure of the speed.

    name: name in the JSON document; text: what is measured, in words; value: the figure; unit: its unit; ``times`` for
    a ratio; at_most: the aim: the largest value that is wanted.
    """

    name: str
    text: str
    value: float
    unit: str = "times"
    at_most: float | None = None


def cpu_of_functions(functions: Mapping[str, Callable[[], object]], rounds: int) -> dict[str, float]:
    """Measure the CPU time of functions, which are called in turn.

    Returns least CPU time [s] of one call, over all threads of this process.
    """
    calls = {}
    for name, function in functions.items():
        function()
        calls[name] = max(1, math.ceil(_SPAN_S / max(_cpu_of(function, 1), 1e-7)))
    least = dict.fromkeys(functions, math.inf)
    for _ in range(rounds):
        for name, function in functions.items():
            least[name] = min(least[name], _cpu_of(function, calls[name]))
    return least


def _cpu_of(function: Callable[[], object], calls: int) -> float:
    """CPU time [s] of one call, on average."""
    began = time.process_time()
    for _ in range(calls):
        function()
    return (time.process_time() - began) / calls


def cpu_of_commands(commands: Mapping[str, Sequence[str]], rounds: int, folder: Path) -> dict[str, float]:
    """Measure the CPU time of commands, which are started in turn.

    Returns least CPU time [s] of the process and of the processes that it waits for.
    """
    least = dict.fromkeys(commands, math.inf)
    for _ in range(rounds):
        for name, command in commands.items():
            least[name] = min(least[name], cpu_of_command(command, folder))
    return least


def cpu_of_command(command: Sequence[str], folder: Path) -> float:
    """Measure the CPU time [s] of a command. Raises RuntimeError."""
    return used_by_command(command, folder).cpu_s


class Used(NamedTuple):
    """CPU time [s] of a command and of the processes that it waits for, and the memory [MB] of all of them at most."""

    cpu_s: float
    memory_mb: float


def used_by_command(command: Sequence[str], folder: Path) -> Used:
    """Measure what a command needs, as `cpu_of_command`; memory that processes share counts for each of them."""
    said = folder / "said.txt"
    with said.open("wb") as stream:
        process = subprocess.Popen(command, cwd=folder, stdout=stream, stderr=subprocess.STDOUT)
    memory_mb, ended, status, used = 0.0, 0, 0, None
    while not ended:
        time.sleep(_LOOK_S)
        memory_mb = max(memory_mb, _memory_mb(process.pid))
        ended, status, used = os.wait4(process.pid, os.WNOHANG)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        raise RuntimeError(f"{' '.join(command)}: {said.read_text()}")
    assert used is not None
    return Used(used.ru_utime + used.ru_stime, memory_mb)


def _memory_mb(pid: int) -> float:
    """Memory [MB] of a process and of those that it has started; 0 of a process that has ended."""
    try:
        pages = int(Path(f"/proc/{pid}/statm").read_text().split()[1])
        started = {
            one for task in Path(f"/proc/{pid}/task").iterdir() for one in (task / "children").read_text().split()
        }
    except OSError:
        return 0.0
    return pages * os.sysconf("SC_PAGESIZE") / 2**20 + sum(_memory_mb(int(one)) for one in started)


def counted(work: Callable[[], object]) -> tuple[int, float]:
    """Do some work and count the passes of the causal filter over the recording of one driver.

    Returns passes: number of passes; cpu_s: CPU time [s] of the work, over all threads.
    """
    lock, passes = threading.Lock(), 0

    def passes_of(observed: Observed, *others: Any) -> None:
        nonlocal passes
        with lock:
            passes += len(observed.position)
        run_filter(observed, *others)

    with mock.patch.object(causal, "run", passes_of):
        began = time.process_time()
        work()
        return passes, time.process_time() - began

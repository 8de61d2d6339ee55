"""What `sugiyama run` costs, compared with the least that its parts cost on the same machine.

A recording is replayed, once with topics for each vehicle and once with all drivers in one message. The floors are what
cannot be saved: the same messages between nodes that do nothing with them, the compiled steps of all filters, and the
same bytes written to a file. All figures are times of the processor [s]: the least of several rounds, in which the
measurements take turns.
"""

import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.speed.timing import SpeedFigure, jam
from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.filters.chain import NOTHING_AROUND
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.filters.online import OnlineFilter
from sugiyama_ros.filters.online_step import online_arrays, step
from sugiyama_ros.formats.convert import write_bag
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.mcap_writer import BagWriter
from sugiyama_ros.jit import kernel
from sugiyama_ros.trajectories.dense import DenseTracks

_ROUNDS = 3
_FIRST_VERSION, _FASTER = 8.3, 6.0
_ROOT = Path(__file__).parents[2]
#: Kinds of a run, and the options that make them.
KINDS = {"topics_of_each_vehicle": (), "one_message": ("--array",)}


@kernel(cached=False)
def _steps(memory: Array, position: Array, identity: Ints, length: Array) -> None:
    """Take in the samples (T, M) of one driver's chain."""
    sample = online_arrays(memory).sample
    for t in range(len(position)):
        sample.position[:], sample.identity[:], sample.length[:] = position[t], identity[t], length[t]
        step(memory)


def filters_s(t: DenseTracks) -> float:
    """Measure the time of the processor [s] that the compiled filters of all drivers take."""
    work = []
    for driver in range(len(t.vehicle)):
        chain, kalman = chain_behind(t, driver), OnlineFilter(t.period_s, t.road).kalman
        kalman.arrays.sample.around[:] = NOTHING_AROUND
        work.append((kalman.memory, chain.position_m, chain.identity, chain.length_m))
    first = work[0]
    _steps(first[0].copy(), *first[1:])  # compiles
    began_s = time.process_time()
    for one in work:
        _steps(*one)
    return time.process_time() - began_s


def writing_s(bag: Path, copy: Path) -> float:
    """Measure the time of the processor [s] that it takes to write the messages of a bag into another one."""
    with Bag(bag) as opened:
        topics = opened.info().topics
        messages = list(opened.raw_messages())
    with BagWriter(copy) as writer:
        channels = {topic.name: writer.topic(topic.name, topic.type) for topic in topics}
        began_s = time.process_time()
        for topic, _, log_time_ns, raw in messages:
            writer.write(channels[topic], raw, log_time_ns, log_time_ns)
        writer.flush()
        ended_s = time.process_time()
    copy.unlink()
    return ended_s - began_s


def _of_graph(*arguments: str | Path) -> tuple[float, float]:
    """Start a measurement of the graph; returns what it measured and the time of its whole process [s]."""

    def spent_s() -> float:
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        return used.ru_utime + used.ru_stime

    before_s = spent_s()
    command = [sys.executable, "-m", "benchmarks.speed.graph", *map(str, arguments)]
    printed = subprocess.run(command, cwd=_ROOT, stdout=subprocess.PIPE, text=True, check=True).stdout
    return float(printed), spent_s() - before_s


def measure(t: DenseTracks, rounds: int = _ROUNDS) -> dict[str, dict[str, float]]:
    """Measure runs of a recording and their floors.

    Returns for each kind of run the least times of the processor [s]: ``loop_s`` and ``process_s``, the floors
    ``graph_s``, ``filters_s`` and ``writing_s``, and their sum ``floors_s``; and ``loop_over_floors`` [1].
    """
    found: dict[str, dict[str, float]] = {kind: {} for kind in KINDS}
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        source = folder / "source.mcap"
        write_bag(t, source)
        for _ in range(rounds):
            for kind, options in KINDS.items():
                bag = folder / f"{kind}.mcap"
                bag.unlink(missing_ok=True)
                loop_s, process_s = _of_graph("loop", source, bag, *options)
                times = {"loop_s": loop_s, "process_s": process_s, "graph_s": _of_graph("empty", bag)[0]}
                times |= {"filters_s": filters_s(t), "writing_s": writing_s(bag, folder / "copy.mcap")}
                found[kind] = {name: min(time_s, found[kind].get(name, time_s)) for name, time_s in times.items()}
    for times in found.values():
        times["floors_s"] = sum(times[name] for name in ("graph_s", "filters_s", "writing_s"))
        times["loop_over_floors"] = times["loop_s"] / times["floors_s"]
    return found


def run() -> tuple[SpeedFigure, ...]:
    """The loop of ``sugiyama run``, over its floors: an empty graph of nodes, the filters, and writing the file.

    With all drivers in one message, the floors are lower, too. The first version of the loop took 8.3 times the floors
    with the topics of each vehicle; one message is to take a sixth of this.
    """
    found = measure(jam())
    each, one = found["topics_of_each_vehicle"], found["one_message"]
    return (
        SpeedFigure(
            "topics_of_each_vehicle_run",
            "loop of a run with the topics of each vehicle, over its floors",
            each["loop_over_floors"],
            at_most=2.5,
        ),
        SpeedFigure(
            "one_message_run",
            "loop of a run with all drivers in one message, over its own floors",
            one["loop_over_floors"],
        ),
        SpeedFigure(
            "one_message_over_topics",
            "the same over the floors with the topics of each vehicle",
            one["loop_s"] / each["floors_s"],
            at_most=round(_FIRST_VERSION / _FASTER, 2),
        ),
    )

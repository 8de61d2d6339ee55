"""What is measured in this process: the likelihoods, and the work that is made of them."""

import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.speed.timing import SpeedFigure, counted, cpu_of_functions, jam
from sugiyama_ros.calibration.calibrate import each_driver
from sugiyama_ros.calibration.on_tracks import calibrate_tracks
from sugiyama_ros.calibration.result import Settings
from sugiyama_ros.diagnosis.diagnose import diagnose
from sugiyama_ros.driver.parameters import NAMES, defaults
from sugiyama_ros.driver.utility import ACTIONS, FORWARD
from sugiyama_ros.filters import causal, paper
from sugiyama_ros.filters.extract import chain_behind
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.formats.mcap_writer import BagWriter
from sugiyama_ros.formats.tracks_parquet import write_tracks
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate
from sugiyama_ros.studies.lanes import two_lanes
from sugiyama_ros.studies.rings import CARS, JAM_GAP_M, LENGTH_M, RING_M
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.dense import DenseTracks, tracks_of
from sugiyama_ros.trajectories.exchange import of_columns
from sugiyama_ros.trajectories.labels import labels_of
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.workers import workers

#: Column of the driver whose likelihoods are measured.
DRIVER = 3
_ROUNDS = 40
# Drivers whose causal likelihoods are computed together, as fits do; the time is the mean.
_TOGETHER = 4
_PLACES = [NAMES.index(name) for name in ESTIMATED]
#: Wanted CPU time [s] of a causal calibration of 22 drivers.
_CALIBRATION_S = 3.0
#: Wanted CPU time [s] of the diagnosis.
_DIAGNOSIS_S = 15.0
_STEPS, _MESSAGES, _MESSAGE_BYTES = 200, 10_000, 100
#: Wanted time [µs] for one message of a bag: 150,000 messages in a second.
_MESSAGE_AT_MOST_US = 6.7
# Vehicles on lanes, and the samples in which each is in view: 1.1 million rows, as many as NGSIM's I-80 has.
_VEHICLES, _LANES, _SAMPLES, _PERIOD_S = 2200, 5, 500, 0.1
_SPEED, _EVERY_S = 10.0, 10.0
#: Wanted CPU time [s] and memory [MB] to read them, and CPU time [s] to calibrate a driver.
_READ_AT_MOST, _MEMORY_AT_MOST, _DRIVER_AT_MOST = 3.0, 500.0, 0.8
_READ = """
import json, sys, time
from pathlib import Path
from sugiyama_ros.formats.registry import read_tracks
before = time.process_time()
tracks = read_tracks(Path(sys.argv[1]))
# the kernel counts ru_maxrss from before this program began, when the process was a copy of its parent
status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
peak = int(status["VmHWM"].split()[0]) / 1024
print(json.dumps([time.process_time() - before, peak, len(tracks), int((tracks.leader_row >= 0).sum())]))
"""
_DRIVERS, _MANY_S, _CARS_IN_A_GROUP = 10_000, 60.0, 22
#: Wanted share of the process that hands out the work [%].
_SERIAL_AT_MOST = 1.0
# Gaps [m] within a group of cars and behind it. So each group makes its own wave.
_GAP_M, _GAP_BEHIND_M = 6.0, 120.0


def exponentials(perceived: paper.Perceived) -> Callable[[], object]:
    """Make a function that computes the exponentials of one likelihood in one call of numpy: the floor.

    Each action takes three exponentials at each moment: two for the utility and one for the weight. An action that
    ends at a low speed takes a fourth exponential.
    """
    slow = perceived.speed[:, None] + perceived.period_s * ACTIONS < FORWARD
    x = -np.random.default_rng(0).uniform(0.0, 10.0, 3 * slow.size + int(slow.sum()))
    out = np.empty_like(x)
    return lambda: np.exp(x, out=out)


def likelihoods(t: DenseTracks, rounds: int) -> dict[str, float]:
    """Measure one likelihood of a driver in both formulations, and the floor.

    Returns CPU times [s] of ``floor``, ``paper`` (with its gradient and information) and ``causal``.
    """
    perceived, p = paper.perceive(t, DRIVER), defaults()
    jobs = [causal.ChainJob(chain_behind(t, DRIVER + k), p) for k in range(_TOGETHER)]
    functions: dict[str, Callable[[], object]] = {
        "floor": exponentials(perceived),
        "paper": lambda: paper.score(perceived, p, _PLACES),
        "causal": lambda: causal.predict_samples(jobs),
    }
    spent = cpu_of_functions(functions, rounds)
    return spent | {"causal": spent["causal"] / _TOGETHER}


def floors() -> tuple[SpeedFigure, ...]:
    """The two likelihoods, compared with the exponentials that they cannot do without."""
    t = jam()
    spent = likelihoods(t, _ROUNDS)
    floor, step = spent["floor"], 1e6 / len(t.position_m)
    return (
        SpeedFigure("floor_ms", "exponentials of one likelihood, in one call of numpy: the floor", 1e3 * floor, "ms"),
        SpeedFigure(
            "paper_likelihood_over_floor",
            "one likelihood in the paper's form, with gradient and information, over the floor",
            spent["paper"] / floor,
        ),
        SpeedFigure("filter_pass_over_floor", "one pass of the causal filter over the floor", spent["causal"] / floor),
        SpeedFigure(
            "filter_pass_us", "one pass of the causal filter, for each driver and step", step * spent["causal"], "µs"
        ),
    )


def calibration() -> tuple[SpeedFigure, ...]:
    """Calibration of all drivers in both formulations, compared with what it consists of."""
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
            "causal_calibrate_s",
            f"calibration of {cars} drivers, causal form",
            causal_s,
            "s of CPU time",
            _CALIBRATION_S,
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


def diagnosis() -> tuple[SpeedFigure, ...]:
    """The diagnosis of 22 drivers: its CPU time, and how often it filters a driver.

    Nothing is missing in this recording, so the search ends after one round. Each effect that is found adds a round.
    """
    t = jam()
    chains = [chain_behind(t, i) for i in range(len(t.vehicle))]
    one_pass = cpu_of_functions(
        {"pass": lambda: [causal.log_likelihood(chain, defaults()) for chain in chains]}, rounds=10
    )["pass"]
    passes, cpu_s = counted(lambda: diagnose(tracks_of(t), workers=os.cpu_count() or 1))
    return (
        SpeedFigure("diagnosis_s", f"diagnosis of {len(chains)} drivers", cpu_s, "s of CPU time", _DIAGNOSIS_S),
        SpeedFigure("diagnosis_passes", "passes of the filter over one driver in this diagnosis", passes, "passes"),
        SpeedFigure("diagnosis_over_pass", "the same diagnosis over one pass over each driver", cpu_s / one_pass),
    )


def throughput() -> tuple[SpeedFigure, ...]:
    """How much a simulation and a bag take in."""
    length = np.full(CARS, LENGTH_M)
    start = platoon(length, JAM_GAP_M)
    simulator = Simulator(defaults(CARS), length, start, Road(RING_M), np.random.default_rng(0))

    def simulate() -> None:
        for _ in range(_STEPS):
            simulator.step()

    with tempfile.TemporaryDirectory() as folder, BagWriter(Path(folder) / "a.mcap") as bag:
        channel, data = bag.topic("/header", "std_msgs/msg/Header"), bytes(_MESSAGE_BYTES)

        def write() -> None:
            for k in range(_MESSAGES):
                bag.write(channel, data, k, k)

        spent = cpu_of_functions({"simulate": simulate, "write": write}, rounds=5)
    return (
        SpeedFigure(
            "simulation_us", "simulation, for each driver and step", 1e6 * spent["simulate"] / (CARS * _STEPS), "µs"
        ),
        SpeedFigure(
            "bag_message_us",
            f"one message of {_MESSAGE_BYTES} bytes in a bag",
            1e6 * spent["write"] / _MESSAGES,
            "µs",
            _MESSAGE_AT_MOST_US,
        ),
    )


def tracks() -> tuple[SpeedFigure, ...]:
    """Reading of many rows of tracks, and calibration of drivers on lanes."""
    with tempfile.TemporaryDirectory() as name:
        path = Path(name) / "many.parquet"
        write_tracks(_many(), path)
        done = subprocess.run((sys.executable, "-c", _READ, str(path)), check=True, capture_output=True, text=True)
    cpu, peak, rows, led = json.loads(done.stdout)
    tracks = two_lanes(np.random.default_rng(1))
    calibrate_tracks(tracks)
    before = time.process_time()
    found = calibrate_tracks(tracks)
    each = (time.process_time() - before) / len(found.drivers)
    text = f"reading {rows:,} rows of tracks, {led:,} with leaders"
    return (
        SpeedFigure("read_tracks_s", text, cpu, "s of CPU time", _READ_AT_MOST),
        SpeedFigure("read_tracks_mb", "memory of the process that reads them", peak, "MB", _MEMORY_AT_MOST),
        SpeedFigure("tracks_driver_s", "calibration of a driver on tracks", each, "s of CPU time", _DRIVER_AT_MOST),
    )


def _many() -> Tracks:
    """Vehicles that come one after the other on each lane, all at one speed."""
    vehicle = np.repeat(np.arange(_VEHICLES), _SAMPLES)
    sample = np.tile(np.arange(_SAMPLES), _VEHICLES)
    came = vehicle // _LANES * round(_EVERY_S / _PERIOD_S)
    return of_columns(
        {
            "vehicle": labels_of(vehicle.tolist()),
            "lane": labels_of((vehicle % _LANES).tolist()),
            "time_s": (came + sample) * _PERIOD_S,
            "s_m": sample * (_PERIOD_S * _SPEED),
        },
        About(source="bench"),
    )


def many() -> tuple[SpeedFigure, ...]:
    """The causal calibration of many drivers on all cores."""
    length = np.full(_DRIVERS, LENGTH_M)
    is_last = np.arange(_DRIVERS) % _CARS_IN_A_GROUP == _CARS_IN_A_GROUP - 1
    gap = np.where(is_last, _GAP_BEHIND_M, _GAP_M)
    end = np.cumsum(length + gap)
    road, rng = Road(float(end[-1])), np.random.default_rng(1)
    simulator = Simulator(defaults(_DRIVERS), length, end - length - gap, road, rng)
    measured = simulate(simulator, _MANY_S, stop_at_collision=False).dense
    before = os.times()
    with workers(_DRIVERS) as work:
        each_driver(measured, Settings(), work=work)
    after = os.times()
    here = after.user + after.system - before.user - before.system
    everywhere = here + after.children_user + after.children_system - before.children_user - before.children_system
    text = f"calibration of {_DRIVERS:,} drivers of {_MANY_S:.0f} s, causal form, in processes on all cores"
    share = "share of the process that hands out the work"
    return (
        SpeedFigure("many_drivers_s", text, everywhere, "s of CPU time"),
        SpeedFigure("many_drivers_serial", share, 100.0 * here / everywhere, "%", _SERIAL_AT_MOST),
    )

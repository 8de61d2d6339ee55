"""A thousand drivers on a Dask cluster of two workers, of which one is killed.

``python -m benchmarks.cluster`` prints whether the numbers are those of this machine alone, and
what the scheduler needs.
"""

import logging
import os
import signal
import threading
import time
from pathlib import Path

import numpy as np
from distributed import LocalCluster

from sugiyama_ros.calibration.on_tracks import calibrate_tracks
from sugiyama_ros.calibration.result import Calibration
from sugiyama_ros.driver.parameters import SIGMA_A, defaults
from sugiyama_ros.simulation.lanes import Lane, simulate_lanes
from sugiyama_ros.studies.rings import LENGTH_M
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.workers import workers

# Lanes, vehicles on each, and the time [s] for which they drive.
_LANES, _VEHICLES, _DURATION_S = 48, 22, 60.0
# Acceleration noise [m/s^2], with which nobody collides.
_CALM = 0.1
# Part of the drivers after which a worker is killed.
_KILLED_AT = 0.3


def main() -> None:
    """Calibrate the same drivers with a cluster and without."""
    tracks = _tracks()
    with workers(1) as here:
        alone = calibrate_tracks(tracks, work=here)
    warnings: list[str] = []
    handler = logging.Handler()
    handler.emit = lambda record: warnings.append(record.getMessage())  # type: ignore[method-assign]
    logging.getLogger("distributed").addHandler(handler)
    logging.captureWarnings(True)
    logging.getLogger("py.warnings").addHandler(handler)
    before = _peak_mb(os.getpid())
    with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
        began = time.monotonic()
        there = _with_a_death(tracks, cluster)
        wall_s = time.monotonic() - began
    print(f"drivers: {len(there.drivers)}, {wall_s:.0f} s")
    print(f"largest difference of a parameter: {_difference(alone, there):.3g}")
    print(f"scheduler and client in one process: {_peak_mb(os.getpid()):.0f} MB at most ({before:.0f} MB before)")
    print(f"warnings of large graphs: {sum('large graph' in one.lower() for one in warnings)}")


def _tracks() -> Tracks:
    rows = defaults(_VEHICLES)
    rows[:, SIGMA_A] = _CALM
    lane = Lane(rows, np.full(_VEHICLES, LENGTH_M), ["car"] * _VEHICLES)
    return simulate_lanes([lane] * _LANES, _DURATION_S, np.random.default_rng(1))


def _with_a_death(tracks: Tracks, cluster: LocalCluster) -> Calibration:
    """Calibrate on a cluster, one of whose workers is killed on the way."""
    victim = next(iter(cluster.workers.values())).pid
    killed = threading.Event()

    def on_progress(done: int, total: int) -> None:
        if done >= _KILLED_AT * total and not killed.is_set():
            killed.set()
            os.kill(victim, signal.SIGKILL)
            print(f"a worker was killed after {done} of {total} drivers", flush=True)

    with workers(1, cluster.scheduler_address) as work:
        return calibrate_tracks(tracks, work=work, on_progress=on_progress)


def _difference(one: Calibration, other: Calibration) -> float:
    return float(np.abs(one.rows - other.rows).max())


def _peak_mb(process: int) -> float:
    """Largest memory [MB] of a process so far."""
    with Path(f"/proc/{process}/status").open() as status:
        return next(int(line.split()[1]) / 1024.0 for line in status if line.startswith("VmHWM"))


if __name__ == "__main__":
    main()

"""What each compiler option of `sugiyama_ros.jit` is worth: the causal filter compiled without it.

    python -m benchmarks.compiler

Each option is switched off in a process of its own, with compiled code of its own. The figures are ratios to the filter
with all options: CPU time of one thread, and wall time with the drivers on two threads.
"""

import json
import os
import subprocess
import sys
import tempfile
import time

from sugiyama_ros import jit

_DRIVERS, _RING_M, _DURATION_S, _ROUNDS = 10, 105.0, 150.0, 25


def measure(without: str) -> dict[str, float]:
    """Measure the time of one filter pass over all drivers.

    Returns CPU time on one thread and wall time on two threads [s]: the shortest of several rounds.
    """
    jit.OPTIONS.discard(without)
    from concurrent.futures import ThreadPoolExecutor

    import numpy as np

    from sugiyama_ros.driver.parameters import defaults, population
    from sugiyama_ros.filters.causal import log_likelihood
    from sugiyama_ros.filters.extract import chain_behind
    from sugiyama_ros.road import Road
    from sugiyama_ros.simulation.simulator import Simulator, platoon, simulate

    length = np.full(_DRIVERS, 4.33)
    rng, road = np.random.default_rng(1), Road(_RING_M)
    t = simulate(Simulator(defaults(_DRIVERS), length, platoon(length, 2.0), road, rng), _DURATION_S).dense
    chains = [chain_behind(t, i) for i in range(_DRIVERS)]
    log_likelihood(chains[0], population())
    cpu, wall = [], []
    with ThreadPoolExecutor(2) as pool:
        for _ in range(_ROUNDS):
            began = time.process_time()
            for chain in chains:
                log_likelihood(chain, population())
            cpu.append(time.process_time() - began)
            began = time.perf_counter()
            list(pool.map(lambda chain: log_likelihood(chain, population()), chains))
            wall.append(time.perf_counter() - began)
    return {"cpu_s": min(cpu), "two_threads_s": min(wall)}


def main() -> None:
    """Print a table of ratios."""
    if len(sys.argv) > 1:
        print(json.dumps(measure(sys.argv[1])))
        return
    found = {}
    for option in ("", *sorted(jit.OPTIONS)):
        with tempfile.TemporaryDirectory() as folder:
            environment = os.environ | {"NUMBA_CACHE_DIR": folder}
            command = [sys.executable, "-m", "benchmarks.compiler", option]
            output = subprocess.run(command, env=environment, capture_output=True, text=True, check=True).stdout
        found[option] = json.loads(output)
    print(f"{'without':<14}{'CPU time':>12}{'two threads':>14}")
    for option, figures in found.items():
        ratios = [figures[name] / found[""][name] for name in ("cpu_s", "two_threads_s")]
        print(f"{option or 'nothing':<14}{ratios[0]:>12.2f}{ratios[1]:>14.2f}")


if __name__ == "__main__":
    main()

"""Benchmark of model files on fresh recordings: of the same people with other noise, and of other people.

    python -m benchmarks.fresh --seeds 10 --first-seed 8000

Each seed is one road with a hidden effect of the benchmark away from home. The effect is added by name to the model of
the first recording, and its file is used on the other two. Printed are the errors after 10 s of all cars, held out, and
the gain over the base model.
"""

import argparse
import tempfile
from collections.abc import Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.away.drivers import drawn
from benchmarks.away.hidden import MECHANISMS
from benchmarks.away.world import Setup, record
from sugiyama_ros.diagnosis.base import base_model
from sugiyama_ros.diagnosis.forecast import Forecasts, forecasts
from sugiyama_ros.diagnosis.refine import with_named, without_folds
from sugiyama_ros.diagnosis.table import errors, gains
from sugiyama_ros.fit.given import fit_people, prepare_for
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model_file import read_model, write_model
from sugiyama_ros.fit.preparation import prepare
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.trajectories.dense import tracks_of
from sugiyama_ros.trajectories.tracks import Tracks

# What is hidden, in turn, and the road.
_HIDDEN = ("grade", "slow patch", "drag", "delay of 0.2 s", "lag")
_SCENE = Setup(drivers=12, ring_m=125.0, duration_s=200.0)


def recorded(name: str, seed: int) -> list[Tracks]:
    """Record a road three times: twice with the same people, once with others. Raises ValueError."""
    for attempt in range(20):
        rng = np.random.default_rng([seed, attempt])
        built = MECHANISMS[name][0](1.0, _SCENE, rng)
        first, others = (drawn(_SCENE.drivers, rng) for _ in range(2))
        runs = [record(_SCENE, people, [built.hidden], rng.spawn(1)[0]) for people in (first, first, others)]
        known = [tracks_of(replace(one, source=f"run {k}")) for k, one in enumerate(runs) if one is not None]
        if len(known) == len(runs):
            return known
    raise ValueError(f"{name}: cars always collide")


def _held_out(data: Recorded, fit: JointFit, work: Executor) -> Forecasts:
    return forecasts(data, without_folds(data, fit, work), work)


def _on(tracks: Tracks, path: Path, work: Executor) -> tuple[Forecasts, Forecasts, Recorded]:
    """Forecasts of a recording by the base model and by a model file."""
    file = read_model(path)
    data, base = base_model(prepare_for(tracks, file) or prepare(tracks), work)
    fitted, _ = fit_people(data, base, file, work)
    return _held_out(data, base, work), _held_out(data, fitted, work), data


def judge(seed: int, work: Executor) -> str:
    """Judge one road, as a row of the table."""
    name = _HIDDEN[seed % len(_HIDDEN)]
    right = MECHANISMS[name][1][0]
    first, *fresh = recorded(name, seed)
    data, base = base_model(prepare(first), work)
    fitted = with_named(data, base, [right], work)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "model.yaml"
        write_model(path, data, fitted)
        cells = [_told(_held_out(data, base, work), _held_out(data, fitted, work), data)]
        cells += [_told(*_on(one, path, work)) for one in fresh]
    return f"| {seed} | {right} | {' | '.join(cells)} |"


def _told(before: Forecasts, after: Forecasts, data: Recorded) -> str:
    won = gains(data, after, before)["all"]
    ends = [errors(one)["free_run_10s_m"] for one in (before, after)]
    return f"{ends[0]:.2f} -> {ends[1]:.2f} m, {won.nats:.0f} +- {won.se:.0f}"


def main(arguments: Sequence[str] | None = None) -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10, help="number of roads")
    parser.add_argument("--first-seed", type=int, default=0, help="first seed")
    given = parser.parse_args(arguments)
    print("| seed | effect | diagnosed | same people, other noise | other people |\n|---|---|---|---|---|")
    with ThreadPoolExecutor(2) as work:
        for seed in range(given.first_seed, given.first_seed + given.seeds):
            print(judge(seed, work), flush=True)


if __name__ == "__main__":
    main()

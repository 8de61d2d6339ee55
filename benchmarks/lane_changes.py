"""How well changes of lane are simulated, fitted and named online; ``docs/lane_changes.md`` has the figures.

- ``recovery``: fits of simulated recordings: estimates, stated errors, coverage of 95 % intervals, gain over MOBIL.
- ``ramps``: merges, contacts and stuck drivers at a ramp and at a barrier, with small and with the paper's noise.
- ``manoeuvres``: share of the changes that the filter names before half of the movement across the road.
- ``sumo``: a road and an on-ramp simulated by SUMO (``pip install eclipse-sumo``), whose drivers follow other laws.

    python -m benchmarks.lane_changes recovery --seeds 0 100
"""

import argparse
import subprocess
import tempfile
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path

import numpy as np

import sugiyama_ros as sg
from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.lane_change import (
    CHANGE_S,
    KEEP,
    LANE_PARAMETERS,
    LEFT,
    RIGHT,
    LaneSpan,
    OnLanes,
    choose,
    lane_features,
    see_lanes,
)
from sugiyama_ros.driver.parameters import REFERENCE_PERIOD_S, defaults
from sugiyama_ros.filters.manoeuvres import ManoeuvreFilter
from sugiyama_ros.fit.lane_change import decisions_of, held_out_loss
from sugiyama_ros.simulation.multilane import END_OF_LANE, MultilaneRun
from sugiyama_ros.trajectories.tracks import Tracks

TRUTH = np.array([p.default for p in LANE_PARAMETERS])
#: A quarter of the paper's acceleration noise alone, as in the studies, in which the paper's drivers do not collide.
QUIET = {"sigma_a": 0.07, "sigma_v": 0.0, "sigma_x": 0.0}
RAMP, BARRIER = {0: (150.0, 350.0)}, {0: (-np.inf, 350.0)}
#: Drivers that SUMO simulates, with its own rule for changes of lane (LC2013).
_CAR = 'id="car" length="4.33" minGap="2" maxSpeed="40" speedFactor="normc(0.9,0.15,0.5,1.3)"'
KRAUSS = f'{_CAR} carFollowModel="Krauss" sigma="0.5" tau="1.2" accel="2.6" decel="4.5"'
IDM = f'{_CAR} carFollowModel="IDM" tau="1.2" accel="1.5" decel="2"'
#: A road of three lanes, and a road of two with an on-ramp from 500 to 800 m, which is lane 0.
ROAD_FILES = {
    "n.xml": '<nodes><node id="a" x="0" y="0"/><node id="b" x="2000" y="0"/></nodes>',
    "e.xml": '<edges><edge id="E" from="a" to="b" numLanes="3" speed="30"/></edges>',
    "r.xml": """<routes><vType DRIVER/><route id="r" edges="E"/><flow id="f" type="car" route="r" begin="0" end="300"
        vehsPerHour="4500" departLane="random" departSpeed="desired" departPos="base"/></routes>""",
}
RAMP_FILES = {
    "n.xml": """<nodes><node id="a" x="0" y="0"/><node id="b" x="500" y="0"/><node id="c" x="800" y="0"/>
        <node id="d" x="1500" y="0"/></nodes>""",
    "e.xml": """<edges>
        <edge id="E1" from="a" to="b" numLanes="3" speed="25">
            <lane index="0" changeLeft="emergency"/><lane index="1" changeRight="emergency"/></edge>
        <edge id="E2" from="b" to="c" numLanes="3" speed="25"><lane index="1" changeRight="emergency"/></edge>
        <edge id="E3" from="c" to="d" numLanes="3" speed="25"><lane index="0" disallow="all"/></edge></edges>""",
    "c.xml": "<connections>"
    + "".join(
        f'<connection from="{a}" to="{b}" fromLane="{k}" toLane="{k}"/>'
        for a, b, lanes in (("E1", "E2", (0, 1, 2)), ("E2", "E3", (1, 2)))
        for k in lanes
    )
    + "</connections>",
    "r.xml": '<routes><vType DRIVER/><route id="r" edges="E1 E2 E3"/>'
    + "".join(
        f'<flow id="f{lane}" type="car" route="r" begin="0" end="600" vehsPerHour="{flow}" departLane="{lane}"'
        f' departSpeed="{speed}"/>'
        for lane, flow, speed in ((0, 600, "15"), (1, 1000, "desired"), (2, 1000, "desired"))
    )
    + "</routes>",
}
ON_RAMP = {0: (500.0, 800.0)}


def recovery(seeds: range) -> None:
    """Print what fits of simulated recordings find, without and with the noise of positions."""
    for sigma_x in (0.0, 0.05):
        runs = (sg.simulate_lane_changes(parameters={"sigma_x": sigma_x}, seed=seed) for seed in seeds)
        found = [sg.lane_changes(run) for run in runs]
        value, std = (np.array([getattr(one, name) for one in found]) for name in ("estimate", "std"))
        inside = np.mean(np.abs(value - TRUTH) < 1.96 * std, axis=0)
        ratio = np.array([one.gain / one.gain_std for one in found])
        print(f"sigma_x {sigma_x}: {np.mean([one.changes for one in found]):.0f} changes in a recording")
        for k, p in enumerate(LANE_PARAMETERS):
            error = value[:, k].std(ddof=1) / np.sqrt(len(seeds))
            spread = f"spread {value[:, k].std(ddof=1):.3g}, stated {np.median(std[:, k]):.3g}"
            print(f"  {p.name}: {value[:, k].mean():.4g} ± {error:.2g}, {spread}, inside {inside[k]:.1%}")
        losses = [(one.log_loss, one.mobil_log_loss, one.gain) for one in found]
        print(
            f"  log-loss, MOBIL's, gain {np.mean(losses, axis=0)}; gain in standard errors: {ratio.mean():.1f}", end=""
        )
        print(f", above 2 in {np.mean(ratio > 2.0):.0%}")


def ramps(seeds: range) -> None:
    """Print merges and contacts at a ramp and a barrier."""
    for noise, parameters in (("a quarter", QUIET), ("the paper's", {})):
        for name, spans in (("ramp", RAMP), ("barrier", BARRIER)):
            merges, contacts, ends, passed = 0, 0, 0, 0
            for spacing_m in (30.0, 20.0):
                for seed in seeds:
                    run = sg.simulate_lane_changes(
                        40, 2, 180.0, spans=spans, parameters=parameters, spacing_m=spacing_m, seed=seed
                    )
                    merges += sum(one.to_lane == 1 for one in run.changes)
                    contacts += len(run.collisions)
                    ends += sum(one.leader == END_OF_LANE for one in run.collisions)
                    passed += int(np.sum(run.tracks.s_m[run.tracks.start[1:] - 1] > 350.0))
            drivers = 80 * len(seeds)
            print(
                f"{noise} noise, {name}: {merges} merges, {contacts} contacts ({ends} at the end of the lane)", end=""
            )
            print(f", {passed} of {drivers} drivers have passed")


def manoeuvres_named(run: MultilaneRun, noise_std: float, seed: int, sees_traffic: bool = True) -> tuple[float, float]:
    """Follow all drivers of a run with a `ManoeuvreFilter`.

    sees_traffic: whether the filter knows what drivers see; otherwise a change begins with 1 % in each period.

    Returns the share of the changes that are named before half of the movement, and the share of the samples without a
    movement in which a change is named.
    """
    t = run.tracks
    steps = len(np.unique(np.round(t.time_s / REFERENCE_PERIOD_S)))
    d_m = (t.d_m + np.random.default_rng(seed).normal(0.0, noise_std, len(t))).reshape(-1, steps)  # type: ignore[operator]
    probability = _decided(run, steps)
    if not sees_traffic:
        probability[:] = 0.99, 0.005, 0.005
    named, truth = np.zeros((2, len(d_m), steps), dtype=int)
    for i, places in enumerate(d_m):
        one = ManoeuvreFilter(REFERENCE_PERIOD_S, noise_std)
        named[i] = [np.argmax(one.step(place, p)) for place, p in zip(places, probability[i], strict=True)]
    half, moving = (round(share * CHANGE_S / REFERENCE_PERIOD_S) for share in (0.5, 1.0))
    hits = []
    for change in run.changes:
        k = round(change.time_s / REFERENCE_PERIOD_S)
        truth[change.vehicle, k : k + moving] = LEFT if change.to_lane > change.from_lane else RIGHT
        if k + half < steps:
            own = change.vehicle, slice(k, k + half)
            hits.append(bool(np.any(named[own] == truth[own])))
    return float(np.mean(hits)), float(np.mean(named[truth == KEEP] != KEEP))


def _decided(run: MultilaneRun, steps: int) -> Array:
    """Return the probabilities (N, T, 3) with which drivers decide, out of their tracks."""
    t = run.tracks
    lane = np.array([int(name) for name in t.lane.text])[t.lane.code]  # type: ignore[union-attr]
    tick = np.round(t.time_s / REFERENCE_PERIOD_S).astype(int)
    speed = np.gradient(t.s_m.reshape(-1, steps), REFERENCE_PERIOD_S, axis=1).ravel()
    lanes = see_lanes(OnLanes(tick, lane, t.s_m, speed, t.length_m), run.spans)
    own = np.repeat(np.arange(t.runs), steps)
    return choose(lanes, run.start.parameters[own], run.start.lane_parameters[own]).reshape(-1, steps, 3)


def manoeuvres(seeds: range) -> None:
    """Print how soon the filter names a manoeuvre, and how often wrongly."""
    runs = [sg.simulate_lane_changes(40, 3, 60.0, seed=seed) for seed in seeds]
    for sees_traffic in (True, False):
        for noise_std in (0.05, 0.1, 0.2, 0.4):
            found = [
                manoeuvres_named(run, noise_std, seed, sees_traffic) for run, seed in zip(runs, seeds, strict=True)
            ]
            mean, error = np.mean(found, axis=0), np.std(found, axis=0, ddof=1) / np.sqrt(len(seeds))
            print(f"traffic {'seen' if sees_traffic else 'not seen'}, noise {noise_std} m: before half", end=" ")
            print(f"{mean[0]:.1%} ± {error[0]:.1%}, wrongly named samples {mean[1]:.2%} ± {error[1]:.2%}", flush=True)


def sumo(seeds: range) -> None:
    """Print log-losses on traffic of SUMO: of a constant share of changes, of this model, and of MOBIL."""
    for name, spans in (("Krauss", None), ("IDM", None), ("on-ramp", ON_RAMP)):
        for seed, tracks in _of_sumo(name, seeds):
            found = sg.lane_changes(tracks, sg.calibrate(tracks), spans)
            made = decisions_of(tracks, None if spans is None else {k: LaneSpan(*v) for k, v in spans.items()})
            constant = held_out_loss(lane_features(made.lanes, defaults())[:, :, 2:], made)
            print(f"{name} {seed}: {found.headline()}; constant share {constant.mean():.4f}", flush=True)


def _of_sumo(name: str, seeds: range) -> Iterator[tuple[int, Tracks]]:
    """Let SUMO simulate 300 s on a road of 2 km, or 600 s on a road with an on-ramp."""
    tools, is_ramp = Path(import_module("sumo").SUMO_HOME) / "bin", name == "on-ramp"
    with tempfile.TemporaryDirectory() as folder:
        for file, text in (RAMP_FILES if is_ramp else ROAD_FILES).items():
            (Path(folder) / file).write_text(text.replace("DRIVER", IDM if name == "IDM" else KRAUSS))

        def call(command: str) -> None:
            program, *arguments = command.split()
            subprocess.run([tools / program, *arguments], cwd=folder, check=True, capture_output=True)

        links = "-x c.xml --no-internal-links" if is_ramp else ""
        call(f"netconvert -n n.xml -e e.xml {links} -o net.xml")
        for seed in seeds:
            end = 600 if is_ramp else 300
            output = "--fcd-output fcd.xml --device.fcd.period 0.3"
            call(f"sumo -n net.xml -r r.xml --step-length 0.1 --end {end} --seed {seed} --no-step-log true {output}")
            yield seed, sg.read(Path(folder) / "fcd.xml")


def main() -> None:
    """Run the part that is named."""
    parts = {"recovery": recovery, "ramps": ramps, "manoeuvres": manoeuvres, "sumo": sumo}
    parser = argparse.ArgumentParser(prog="python -m benchmarks.lane_changes", description=__doc__)
    parser.add_argument("part", choices=parts)
    parser.add_argument("--seeds", nargs=2, type=int, default=(0, 20), metavar=("FIRST", "END"))
    asked = parser.parse_args()
    parts[asked.part](range(*asked.seeds))


if __name__ == "__main__":
    main()

"""The speed of the wave in docs/case1.md: as `sugiyama compare` estimates it, its standard error, and along its edges.

python docs/case1_wave.py case1.data
"""

import sys
from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.filters.extract import chain_behind, track
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.registry import read_tracks
from sugiyama_ros.simulation.collective import wave_speed, wave_speed_error
from sugiyama_ros.trajectories.dense import DenseTracks

_FORMED_S, _LEVELS = 155.0, (2.0, 3.0, 4.0)
# Speeds [m/s] that are tried for an edge, and distance [m] from the edge beyond which a crossing is another event.
_TRIED, _NEAR_M = np.arange(-8.0, -4.0, 0.02), 20.0


def along_edge(t: DenseTracks, speed: Array, level: float, starts: bool) -> float:
    """Speed [m/s] of the places at which cars fall below a speed, or at which they rise above it."""
    before, after = speed[:-1], speed[1:]
    crosses = (before < level) & (after >= level) if starts else (before >= level) & (after < level)
    step, car = np.nonzero(crosses)
    step, car = step[step * t.period_s > _FORMED_S], car[step * t.period_s > _FORMED_S]
    time_s, place, ring_m = step * t.period_s, t.position_m[step, car], t.road.circumference_m
    phases = [np.mean(np.exp(2j * np.pi * (place - tried * time_s) / ring_m)) for tried in _TRIED]
    best = int(np.argmax(np.abs(phases)))
    start_m = np.angle(phases[best]) * ring_m / (2.0 * np.pi)
    off_m = t.road.difference(place - _TRIED[best] * time_s, np.full(len(place), start_m))
    near = np.abs(off_m) < _NEAR_M
    return float(_TRIED[best] + np.polyfit(time_s[near], off_m[near], 1)[0])


def main(source: Path) -> None:
    """Print the speeds."""
    t = read_tracks(source, Choices(ring_m=230.0)).dense()
    tracks = [track(chain_behind(t, i, vehicles=1)) for i in range(len(t.vehicle))]
    position, speed = (np.stack([one[:, k] for one in tracks], axis=1) for k in range(2))
    headway_m = t.road.space_headway(np.take_along_axis(position, t.leader, axis=1), position)
    whole = (speed, headway_m, t.leader, t.period_s)
    print(f"whole recording: {wave_speed(*whole):.2f} ± {wave_speed_error(*whole):.2f} m/s")
    for first, last in ((150.0, 200.0), (200.0, 250.0)):
        k = slice(round(first / t.period_s), round(last / t.period_s))
        print(f"{first:g} to {last:g} s: {wave_speed(speed[k], headway_m[k], t.leader[k], t.period_s):.2f} m/s")
    for starts, edge in ((False, "where cars slow down"), (True, "where cars start")):
        speeds = [along_edge(t, speed, level, starts) for level in _LEVELS]
        print(f"{edge}: {', '.join(f'{one:.2f}' for one in speeds)} m/s, at {_LEVELS} m/s")


if __name__ == "__main__":
    main(Path(sys.argv[1]))

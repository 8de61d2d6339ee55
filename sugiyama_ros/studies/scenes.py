"""Drivers who meet, with a hidden effect: what the demonstration and the benchmark of junctions look for."""

from collections.abc import Mapping

import numpy as np

from sugiyama_ros.arrays import Ints
from sugiyama_ros.driver.parameters import SIGMA_NU, V_STAR, defaults
from sugiyama_ros.effects.effect import Values
from sugiyama_ros.effects.registry import ROW, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.simulation.junction import JunctionRun
from sugiyama_ros.simulation.scenes import simulate_scene

#: Effects that can be hidden at each scene, with their values; the first one is hidden if none is named.
HIDDEN: Mapping[str, Mapping[str, Values]] = {
    "roundabout": {
        "blind_sector": {"sight": 8.0},
        "ignored_yield": {"share": 0.98},
        "curve_speed": {"lateral": 2.0},
        "accepted_gap": {"longer": -2.0},
    },
    "signals": {"late_start": {"delay": 1.5}, "curve_speed": {"lateral": 2.0}},
}
# Part of the drivers who do not yield, and how the others differ.
_WHO_IGNORE, _SPREAD = 0.15, 0.1
# Std [m] of the measured positions, as in videos from above, and the desired speed [m/s] in a town.
_NOISE_M, _DESIRED = 0.1, 11.0


def hide_at_scene(scene: str, hidden: str | None, seed: int, drivers: int = 60) -> tuple[JunctionRun, str, Values]:
    """Simulate drivers who meet at a scene and have an effect; ``ignored_yield`` is of 3 in 20 of them.

    Returns the run, the name of the effect, and its values. Raises InputError for an effect that is not in `HIDDEN`.
    """
    known = HIDDEN[scene]
    name = hidden or next(iter(known))
    if name not in known:
        raise InputError(f"--hidden {name}: is not for the scene {scene}; give one of {', '.join(known)}")
    rows = defaults(drivers)
    rows[:, SIGMA_NU], rows[:, V_STAR] = _NOISE_M, _DESIRED
    rows = ROW.with_effects(rows)
    who: Ints = np.arange(drivers)
    if name == "ignored_yield":
        who = np.random.default_rng([seed, 1]).permutation(drivers)[: round(_WHO_IGNORE * drivers)]
    rows[who] = switch_on(rows[who], name, known[name])
    return simulate_scene(scene, rows, seed, spread=_SPREAD), name, known[name]

"""Preferences that wander at random while drivers drive."""

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.effects.registry import EFFECTS, ROW

_WANDERING = tuple(e for e in EFFECTS.values() if e.wanders)


class Wandering:
    """Preferences of N drivers that wander as Ornstein-Uhlenbeck processes.

    period_s: time [s] between two samples; rng: generator of the random changes.
    """

    def __init__(self, period_s: float, rng: np.random.Generator) -> None:
        self._period_s, self._rng = period_s, rng
        self._mood: dict[str, Array] = {}

    def next_rows(self, drivers: Array) -> Array:
        """Return the rows (N, width) of the drivers, at the period of the samples, with the preferences of the moment.

        The rows that are given stay as they are.
        """
        rows = drivers
        for effect in _WANDERING:
            std, time = drivers[:, ROW.places[effect.name]].T[:2]
            if not std.any():
                continue
            is_first = effect.name not in self._mood
            mood = self._mood.setdefault(effect.name, np.zeros((len(effect.wanders), len(rows))))
            memory: Array = np.exp(-self._period_s / np.where(std > 0.0, time, 1.0)) * (not is_first)
            fresh = self._rng.standard_normal(mood.shape)
            mood[:] = memory * mood + std * np.sqrt(1.0 - np.square(memory)) * fresh
            rows = rows.copy()
            rows[:, [index(name) for name in effect.wanders]] *= np.exp(mood.T)
        return rows

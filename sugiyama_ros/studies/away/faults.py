"""Faults of the measurement: what a camera or a receiver makes of the positions."""

from collections.abc import Callable, Mapping

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.studies.away.catalogue import Builder, Built
from sugiyama_ros.studies.away.world import Hidden, Setup

Spoil = Callable[[Array, Setup, np.random.Generator, float], Array]


def _spoiled(spoil: Spoil) -> Builder:
    def build(strength: float, scene: Setup, rng: np.random.Generator) -> Built:
        return Built(Hidden(spoil=lambda x, s, noise: spoil(x, s, noise, strength)))

    return build


def clock_offset(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """Each vehicle has a clock of its own, off by 0.15 s."""
    time = scene.period_s * np.arange(len(x))
    off = 0.15 * strength * rng.standard_normal(x.shape[1])
    return np.array([np.interp(time + o, time, column) for o, column in zip(off, x.T, strict=True)]).T


def second_harmonic(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """The camera's picture is an ellipse: positions are off twice around the ring."""
    turn = 2.0 * np.pi * x / (scene.ring_m or 230.0)
    return np.asarray(x + 0.8 * strength * np.sin(2.0 * turn + rng.uniform(0.0, 2.0 * np.pi)))


def held_frames(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """Some frames repeat the frame before."""
    found = x.copy()
    for k in np.flatnonzero(rng.random(len(x)) < 0.05 * strength):
        found[k] = found[max(k - 1, 0)]
    return found


def rounding(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """Positions are rounded to a metre."""
    return np.asarray(np.round(x / strength) * strength)


def correlated(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """An error that wanders, as that of a satellite receiver does: 5 s, 0.4 m."""
    keep = float(np.exp(-scene.period_s / 5.0))
    off = np.zeros_like(x)
    off[0] = rng.standard_normal(x.shape[1])
    for k in range(1, len(x)):
        off[k] = keep * off[k - 1] + np.sqrt(1.0 - keep**2) * rng.standard_normal(x.shape[1])
    return np.asarray(x + 0.4 * strength * off)


def smoothed(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """Positions were smoothed over a second by whoever made the file."""
    size = max(3, round(1.0 / scene.period_s) | 1)
    edge = np.concatenate([np.repeat(x[:1], size // 2, axis=0), x, np.repeat(x[-1:], size // 2, axis=0)])
    return np.array([np.convolve(column, np.full(size, 1.0 / size), "valid") for column in edge.T]).T


def missing(x: Array, scene: Setup, rng: np.random.Generator, strength: float) -> Array:
    """One sample in twenty is missing, and each vehicle is out of sight once for 5 s."""
    found = np.where(rng.random(x.shape) < 0.05 * strength, np.nan, x)
    for i in range(x.shape[1]):
        begin = int(rng.integers(len(x) // 10, len(x) * 8 // 10))
        found[begin : begin + round(5.0 / scene.period_s), i] = np.nan
    return found


#: Faults that a diagnosis should not take for behaviour, and the names of the catalogue that are faults as well.
FAULTS: Mapping[str, tuple[Builder, tuple[str, ...]]] = {
    "clock offset": (_spoiled(clock_offset), ("gap_offset", "clock_offset")),
    "second harmonic": (_spoiled(second_harmonic), ("sensor_eccentricity",)),
    "held frames": (_spoiled(held_frames), ("outlier_noise", "noise_constants")),
    "rounding": (_spoiled(rounding), ("noise_constants",)),
    "correlated noise": (_spoiled(correlated), ("noise_constants", "gap_offset")),
}
#: Faults that the base model should bear.
SMOOTHED, MISSING = _spoiled(smoothed), _spoiled(missing)

"""Whether an addition holds where the model is used: beyond the end of the fitted part, and in each regime.

Interleaved blocks show that an addition predicts samples between those that were fitted. A simulation starts where the
data end, and it lives in one regime for long. So the model is also fitted without the last part of the recording, and
drives into that part by itself.
"""

from collections.abc import Iterator, Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from functools import lru_cache
from itertools import product
from typing import Literal, get_args

import numpy as np
from scipy.stats import t as student

from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.diagnosis.addition import Addition
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.free_runs import HORIZONS_S, FreeRuns, rmse
from sugiyama_ros.diagnosis.last_part import LastPart, last_part, last_part_from_nothing
from sugiyama_ros.diagnosis.refits import added_to_all
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.tables import figure

#: What a model is for.
Purpose = Literal["prediction", "simulation", "online"]
_PURPOSES: tuple[Purpose, ...] = get_args(Purpose)
# Worse by this many paired standard errors; worse by chance with this probability, and by this factor of the mean
# square error.
_CLEARLY, _CHANCE, _TOLERANCE = 2.0, 0.05, 1.1
# Below this speed [m/s] a car stands; below this part of the fastest tenth's speed it is in a jam.
_STANDING, _SLOW = 0.5, 0.5
_FEWEST = 20

#: Number of effects that a diagnosis adds at most: by default, and if additions are asked for.
FEW_ADDITIONS, MANY_ADDITIONS = 3, 8


@dataclass(frozen=True)
class Goal:
    """What may be added to a model, and what the model is for.

    Parameters
    ----------
    only : tuple of str
        Names of what is added, whatever the data say of it; empty for a search among all candidates.
    forces : bool
        Whether the best force without a name may be added at the end.
    purpose : {"prediction", "simulation", "online"}
        Nothing is added that makes the last part worse: one step for ``"online"``, free runs too for ``"simulation"``.
        For ``"prediction"`` it is only told.
    most : int
        Maximum number of effects to add.
    """

    only: tuple[str, ...] = ()
    forces: bool = False
    purpose: Purpose = "prediction"
    most: int = FEW_ADDITIONS


#: Any candidate may be added, but no force without a name.
ANYTHING = Goal()


class Use:
    """What a model is for, and whether extended models do worse there than the base model.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The model without additions, fitted to the whole recording.
    purpose : {"prediction", "simulation", "online"}
        What the model is for.
    work : Executor
        Runs the filters.

    Attributes
    ----------
    refuses : bool
        Whether what is worse there is not to be added.
    """

    def __init__(self, data: Recorded, base: JointFit, purpose: Purpose, work: Executor) -> None:
        self._data, self._base, self._purpose, self._work = data, base, purpose, work
        self.refuses = purpose != "prediction"
        self._from_nothing: dict[tuple[str, ...], LastPart] = {}

        # the base model and the model before are asked for again with each candidate
        @lru_cache(maxsize=3)
        def of(fitted: JointFit) -> LastPart:
            return last_part(data, fitted, work)

        self._last_part = of

    def worse(self, additions: Sequence[Addition], fitted: JointFit, before: JointFit) -> tuple[str, ...]:
        """Say where a model does worse in the last part, than the base model or, for simulations, than one before it.

        For simulations, the models are fitted from nothing to what comes before the last part, where they can be: a
        fit to the whole recording knows the last part, and a search that begins there may never forget it.

        Parameters
        ----------
        additions : sequence of Addition
            What the model has beyond the base model, the newest one last.
        fitted, before : JointFit
            The model, and the model without the newest addition.

        Returns
        -------
        tuple of str
            In words; empty if the model is nowhere worse. Tracks have no last part.
        """
        if not self._data.vicinity.is_whole_road:
            return ()
        effects = added_to_all(self._data, additions) if self._purpose == "simulation" else []
        if effects:
            ours, last, base = (self._of_effects(effects[:n]) for n in (len(effects), len(effects) - 1, 0))
        else:
            ours, last, base = (self._last_part(one) for one in (fitted, before, self._base))
        found = worse_where(ours, base, self._purpose)
        if self._purpose == "simulation" and not found:
            return worse_where(ours, last, self._purpose)
        return found

    def is_worse(self, fitted: JointFit, before: JointFit) -> bool:
        """Return whether a model is somewhere worse in the last part than another one; tracks have no last part."""
        if not self._data.vicinity.is_whole_road:
            return False
        return bool(worse_where(self._last_part(fitted), self._last_part(before), self._purpose))

    def _of_effects(self, effects: Sequence[Candidate]) -> LastPart:
        """Errors in the last part of a model that was fitted from nothing."""
        names = tuple(one.name for one in effects)
        if names not in self._from_nothing:
            self._from_nothing[names] = last_part_from_nothing(self._data, effects, self._work)
        return self._from_nothing[names]


def purpose_of(name: str) -> Purpose:
    """Return what a model is for, by name. Raises InputError for an unknown name."""
    for purpose in _PURPOSES:
        if purpose == name:
            return purpose
    raise InputError(f"--for {name}: is not known; give {', '.join(_PURPOSES)}")


def worse_where(ours: LastPart, base: LastPart, purpose: Purpose) -> tuple[str, ...]:
    """Say where a model does worse in the last part than the base model, from the same starts.

    What is told must hold against the number of comparisons. A model for simulations has no error that is larger, not
    even by chance, in both halves of the last part: what drivers really do brings all horizons closer.

    Parameters
    ----------
    ours, base : LastPart
        Errors of both models.
    purpose : {"prediction", "simulation", "online"}
        What counts: one step ahead only for ``"online"``; free runs as well otherwise.

    Returns
    -------
    tuple of str
        In words; empty if the model is nowhere worse.
    """
    found = []
    change = ours.drivers - base.drivers
    spread = float(np.sqrt(len(change) * np.var(change, ddof=1))) if len(change) > 1 else 0.0
    if change.sum() < -_CLEARLY * spread and change.sum() < 0.0:
        found.append(f"one step ahead into the last part it loses {-change.sum():.0f} nats")
    if purpose == "online":
        return tuple(found)
    compared: list[tuple[str, float, str]] = []
    start_s = np.asarray(ours.period_s * (base.runs.start - base.runs.start[:1]), dtype=np.float64)
    for regime, chosen in _regimes(base.runs):
        if not regime and purpose == "simulation":
            found += _larger(ours.runs, base.runs)
            continue
        for k, horizon in enumerate(HORIZONS_S):
            ends, base_ends = (np.where(chosen[:, k], one.runs.coupled[:, k], np.nan) for one in (ours, base))
            if beside := _beside(ends, base_ends, np.floor(start_s / horizon)):
                compared.append((f"free runs of {horizon:g} s into the last part{regime}", *beside))
    found += [f"{runs} end {told}" for runs, p, told in compared if p < _CHANCE / len(compared)]
    more = ours.collisions - base.collisions
    by_chance = 0.0 if purpose == "simulation" else _CLEARLY * np.sqrt(ours.collisions + base.collisions)
    if more > by_chance:
        cars = "1 car collides" if ours.collisions == 1 else f"{ours.collisions} cars collide"
        found.append(f"{cars} in free runs into the last part instead of {base.collisions}")
    return tuple(found)


def drivers_worse(before: list[tuple[float, float]], after: list[tuple[float, float]]) -> list[int]:
    """Return the columns of drivers whose single-car error after 10 s grows by a fifth; arguments as ``by_driver``."""
    pairs = zip(before, after, strict=True)
    return [i for i, ((_, then), (_, now)) in enumerate(pairs) if now > 1.2 * then]


def _regimes(runs: FreeRuns) -> Iterator[tuple[str, Mask]]:
    """All samples and the samples of each regime, as words and masks (S, H, N)."""
    speed: Array = runs.speed
    yield "", np.ones(speed.shape, np.bool_)
    if not np.isfinite(speed).any():
        return
    slow = max(_SLOW * float(np.nanquantile(speed, 0.9)), _STANDING)
    yield ", while standing,", speed < _STANDING
    yield ", in a jam,", (speed >= _STANDING) & (speed < slow)
    yield ", in free flow,", speed >= slow


def _larger(ours: FreeRuns, base: FreeRuns) -> Iterator[str]:
    """Say at which horizons free runs end further off than the base model's, in each half of the starts."""
    middle = len(base.start) // 2
    halves = (("first", slice(middle)), ("second", slice(middle, None)))
    kinds = (("free runs", ours.coupled, base.coupled), ("free runs of a single car", ours.single, base.single))
    for (half, starts), (kind, ends, base_ends) in product(halves, kinds):
        both = np.isfinite(ends[starts] + base_ends[starts])
        for k, horizon in enumerate(HORIZONS_S):
            off, base_off = (rmse(one[starts, k][both[:, k]]) for one in (ends, base_ends))
            if off > base_off:
                runs = f"{kind} of {horizon:g} s into the {half} half of the last part"
                yield f"{runs} end {figure(off)} m off instead of {figure(base_off)} m"


def _beside(ours: Array, base: Array, block: Array) -> tuple[float, str] | None:
    """Probability that our errors (S, N) are larger than the base model's by chance, and both in words.

    None if there are too few; 1 if ours are hardly larger. Runs that overlap have the same number in block (S,); blocks
    are taken as independent.
    """
    change = np.square(ours) - np.square(base)
    known = np.isfinite(change).sum(axis=1)
    blocks = np.unique(block[known > 0])
    if known.sum() < _FEWEST or len(blocks) < 3:
        return None
    by_block = np.array([np.nansum(change[block == one]) for one in blocks])
    error = float(np.sqrt(len(blocks) * np.var(by_block, ddof=1)))
    squares = [float(np.nanmean(np.square(one))) for one in (ours, base)]
    is_larger = squares[0] > _TOLERANCE * squares[1]
    p = float(student.sf(by_block.sum() / max(error, 1e-9), len(blocks) - 1)) if is_larger else 1.0
    return p, f"{figure(squares[0] ** 0.5, 2)} m off instead of {figure(squares[1] ** 0.5, 2)} m"

"""A regular time base for tracks: every vehicle at the same, evenly spaced times."""

import math
from dataclasses import replace
from fractions import Fraction

import numpy as np

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.errors import InputError
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.assemble import led
from sugiyama_ros.trajectories.labels import Labels
from sugiyama_ros.trajectories.leaders import TICK_S, given_leaders, ticks
from sugiyama_ros.trajectories.tracks import FLAGS, NUMBERS, TEXTS, Tracks, starts

_RESAMPLE = "sugiyama convert FILE even.parquet --period SECONDS"
#: A hole [s] up to which positions are interpolated; a longer hole ends a stretch.
LONGEST_HOLE_S = 0.5
#: Tracks that are sampled more often than this [s] are brought to `_USUAL_S`.
SHORTEST_S, _USUAL_S = 0.06, 0.1
# Part of a period by which a step may miss a multiple of the period.
_JITTER = 0.1
# Share of the steps that may miss it, and number of distinct times over the number expected.
_MISSES, _DISTINCT = 0.01, 1.2
# Targets that are worked on at once, and samples on each side of a target, at most.
_AT_ONCE, _WIDEST = 100_000, 12


def period_of(tracks: Tracks) -> float:
    """Time [s] between two samples of a vehicle: the usual one. Raises InputError if no vehicle has two samples."""
    step = _steps(tracks)
    if len(step) == 0:
        raise InputError(
            f"{tracks.about.source or 'tracks'}: no vehicle has two samples; give tracks, not single points"
        )
    usual = float(np.median(step[step <= 1.5 * np.quantile(step, 0.25)]))
    if usual < TICK_S:
        raise InputError(
            f"{tracks.about.source or 'tracks'}: a sample every {usual:.3g} s; check the unit of the times (--columns)"
        )
    near = step[np.abs(step - usual) <= _JITTER * usual]
    if len(near) == 0 or not _are_multiples(step, usual):
        return float(np.median(step))
    return nearly(float(np.mean(near)))


def nearly(period_s: float) -> float:
    """The simple period [s] that is nearly the same, or the period itself: 0.1 for 0.1003, 1/30 for 0.0333."""
    for simple in (round(period_s, 2), round(period_s * 30.0) / 30.0, round(period_s, 3)):
        if simple > 0.0 and abs(simple - period_s) <= max(1e-3 * simple, TICK_S * 0.5):
            return simple
    return period_s


def _are_multiples(step: Array, period_s: float) -> bool:
    """Whether steps [s] are multiples of a period, but for a few."""
    miss = np.abs(step - np.maximum(np.round(step / period_s), 1.0) * period_s)
    return bool(np.mean(miss > _JITTER * period_s + TICK_S * 1.01) <= _MISSES)


def regular_time_base(time_s: Array, where: str) -> tuple[float, float, Ints]:
    """Find the regular time base of times that may be rounded and may skip samples.

    Parameters
    ----------
    time_s : ndarray, shape (n,)
        Strictly increasing times [s].
    where : str
        Name of the times in an error message.

    Returns
    -------
    start_s, period_s : float
        Time [s] of the first sample, and time [s] between two samples.
    number : ndarray of int, shape (n,)
        Number of each sample on the time base, from 0.

    Raises
    ------
    InputError
        If there are too few times, or if they do not lie on a regular time base.
    """
    if len(time_s) < 2:
        raise InputError(f"{where}: only one time; need at least two samples")
    # A skipped sample makes a step larger, never smaller. So the lower quartile of the steps is the period, up to
    # rounding.
    step = np.diff(time_s)
    period = float(np.median(step[step <= 1.5 * np.quantile(step, 0.25)]))
    number = np.concatenate(([0], np.cumsum(np.round(step / period).astype(np.int64))))
    if number[-1] >= 2 * len(time_s):
        raise InputError(
            f"{where}: {len(time_s)} times are there; {number[-1] + 1} are expected at steps of {period:.4g} s;"
            f" resample: {_RESAMPLE}"
        )
    if len(time_s) > 2:
        period, start = (float(c) for c in np.polyfit(number, time_s, 1))
    else:
        start = float(time_s[0])
    off = np.abs(time_s - (start + period * number))
    worst = int(np.argmax(off))
    if off[worst] > 0.1 * period:
        raise InputError(
            f"{where}: time {time_s[worst]:g} s lies {off[worst]:.3g} s off the regular time base of {period:.4g} s;"
            f" resample: {_RESAMPLE}"
        )
    # The first time is the start. The start of the fitted line may lie before 0, where nothing can be recorded.
    return float(time_s[0]), _unrounded(time_s, number, period), number


def _unrounded(time_s: Array, number: Ints, period: float) -> float:
    """Guess the period [s] before the times were rounded: a simple number, if it explains all times."""
    fraction = float(Fraction(period).limit_denominator(100))
    noise = 8.0 * float(np.spacing(np.abs(time_s).max()))
    # The largest number of digits after the point in any time tells how far rounding may have moved the times.
    digits = next((d for d in range(9) if np.all(np.abs(time_s - np.round(time_s, d)) <= noise)), 9)
    for simple, moved in ((fraction, noise), (round(period, 9), noise), (fraction, 0.5 * 10.0**-digits + noise)):
        if simple > 0.0 and np.ptp(time_s - simple * number) <= 2.0 * moved:
            return simple
    return period


def is_regular(tracks: Tracks) -> bool:
    """Whether all vehicles of a recording are sampled at the same, evenly spaced times."""
    period = period_of(tracks)
    return _are_multiples(_steps(tracks), period) and _distinct(tracks) <= _DISTINCT * _expected(tracks, period)


def _steps(tracks: Tracks) -> Array:
    """Times [s] between successive rows of the same run."""
    step = np.diff(tracks.time_s)
    return np.asarray(step[np.diff(tracks.run) == 0])


def _distinct(tracks: Tracks) -> int:
    """Number of distinct times, counted in each recording."""
    tick = ticks(tracks.time_s)
    recording = tracks.recording.code.astype(np.int64)
    return len(np.unique(recording * (int(tick.max(initial=0)) + 1) + tick))


def _expected(tracks: Tracks, period_s: float) -> float:
    """Number of times on regular bases, counted in each recording while anybody is there."""
    total = 0.0
    first, last = tracks.time_s[tracks.start[:-1]], tracks.time_s[tracks.start[1:] - 1]
    recording = tracks.recording.code[tracks.start[:-1]]
    for code in np.unique(recording):
        here = recording == code
        total += (last[here].max() - first[here].min()) / period_s + 1.0
    return total


def on_time_base(tracks: Tracks, period_s: float | None = None) -> Tracks:
    """Bring tracks to a regular time base, if they are not on one already.

    period_s: time [s] between two samples; by default the tracks' own, but at least 0.06 s: 25 and 30 Hz become 10 Hz.
    Raises InputError.
    """
    if period_s is not None and not 0.01 <= period_s <= 60.0:
        raise InputError(f"period: {period_s:g} s cannot be used; give 0.01 to 60 s")
    own, regular = period_of(tracks), is_regular(tracks)
    wanted = period_s or (_USUAL_S if own < SHORTEST_S or 0.07 < own < 0.15 else round(own, 2) or own)
    if regular and (math.isclose(wanted, own, rel_tol=1e-6) or (period_s is None and own >= SHORTEST_S)):
        return tracks
    return resample(tracks, wanted)


def resample(tracks: Tracks, period_s: float) -> Tracks:
    """Estimate the positions at multiples of a period.

    Each position is the value of a parabola through the samples around it (least squares, within one period, or one and
    a half of the tracks' own periods if that is more). Where fewer than three samples are that near, the position is
    interpolated. Nothing is estimated in a hole of more than 0.5 s.

    period_s: time [s] between two samples.
    """
    regular, own = is_regular(tracks), period_of(tracks)
    piece_start = pieces(tracks, max(LONGEST_HOLE_S, 1.5 * own))
    axis = _Axis(tracks.time_s, piece_start, period_s)
    if len(axis.target) == 0:
        raise InputError(
            f"{tracks.about.source or 'tracks'}: no vehicle is seen for {period_s:g} s; give a shorter period"
        )
    nearest = axis.nearest()
    s = _local_parabola(axis, _unwrapped(tracks), max(period_s, 1.5 * own), nearest)
    about = replace(tracks.about, period_s=0.0)
    about = about.noting(f"positions were estimated at multiples of {period_s:g} s from samples of {own:.3g} s")
    kept: dict[str, Labels | Array | Mask | None] = {}
    for name in (*TEXTS, *NUMBERS, *FLAGS):
        column = tracks.column(name)
        kept["vehicle_class" if name == "class" else name] = None if column is None else column[nearest]
    if tracks.d_m is not None:
        kept["d_m"] = np.interp(axis.target, axis.sample, tracks.d_m)
    for name in ("arrive_s", "clear_s"):  # times that pass
        if (times := tracks.column(name)) is not None:
            kept[name] = np.asarray(times)[nearest] - (axis.target - axis.sample[nearest])
    kept |= {"time_s": axis.time_s, "s_m": s}
    new = replace(tracks, **kept, start=starts(tracks.run[nearest]), about=_smoothed(about, own, period_s))  # type: ignore[arg-type]
    if regular or about.leaders == "given":
        new = replace(new, leader_row=given_leaders(new, tracks.leader[nearest]))
    else:
        new = led(new, None)
    return new


def _smoothed(about: About, own_s: float, period_s: float) -> About:
    """The same, saying that positions are smoothed where several samples went into one."""
    if own_s > 0.8 * period_s:
        return about
    parabola = f"local parabola, {period_s:g} s on each side"
    return replace(about, smoothing=f"{about.smoothing}; {parabola}" if about.smoothing else parabola)


def pieces(tracks: Tracks, longest_hole_s: float) -> Ints:
    """First row of each piece of a run that has no hole and stays on one road, and the number of rows."""
    broken = (np.diff(tracks.run) != 0) | (np.diff(tracks.time_s) > longest_hole_s + TICK_S)
    if tracks.road is not None:  # each road has positions of its own
        broken |= np.diff(tracks.road.code) != 0
    return np.concatenate(([0], np.flatnonzero(broken) + 1, [len(tracks)]))


def _unwrapped(tracks: Tracks) -> Array:
    """Positions [m] that go on growing from turn to turn of a ring, (R,)."""
    ring = tracks.about.ring_m
    if ring == 0.0:
        return tracks.s_m
    step = np.diff(tracks.s_m)
    turns = np.where(np.diff(tracks.run) == 0, -np.round(step / ring), 0.0)
    turned = np.concatenate(([0.0], np.cumsum(turns)))
    return np.asarray(tracks.s_m + ring * (turned - turned[tracks.start[:-1]][tracks.run]))


class _Axis:
    """Samples and targets of all pieces on one growing axis, with room between the pieces."""

    def __init__(self, time_s: Array, start: Ints, period_s: float) -> None:
        first, last = time_s[start[:-1]], time_s[start[1:] - 1]
        low = np.ceil(first / period_s - 1e-6).astype(np.int64)
        high = np.floor(last / period_s + 1e-6).astype(np.int64)
        count = np.maximum(high - low + 1, 0)
        piece = np.repeat(np.arange(len(first)), count)
        step = np.arange(len(piece)) - np.repeat(np.cumsum(count) - count, count)
        offset = np.concatenate(([0.0], np.cumsum(last - first + 100.0 * period_s)))[:-1] - first
        self.time_s = np.round((low[piece] + step) * period_s, 9)
        self.target = self.time_s + offset[piece]
        self.sample = time_s + np.repeat(offset, np.diff(start))

    def nearest(self) -> Ints:
        """The sample nearest to each target."""
        right = np.clip(np.searchsorted(self.sample, self.target), 1, max(len(self.sample) - 1, 1))
        left = right - 1
        right = np.minimum(right, len(self.sample) - 1)
        return np.where(self.target - self.sample[left] <= self.sample[right] - self.target, left, right)


def _local_parabola(axis: _Axis, s_m: Array, within_s: float, nearest: Ints) -> Array:
    """Value at each target of the parabola that fits the samples around it best."""
    value: Array = np.interp(axis.target, axis.sample, s_m)
    usual = float(np.median(np.diff(axis.sample))) if len(axis.sample) > 1 else within_s
    width = int(min(_WIDEST, max(2, math.ceil(within_s / usual))))
    around = np.arange(-width, width + 1)
    for first in range(0, len(value), _AT_ONCE):
        some = slice(first, first + _AT_ONCE)
        index = nearest[some, None] + around
        inside = (index >= 0) & (index < len(s_m))
        index = np.clip(index, 0, len(s_m) - 1)
        x = (axis.sample[index] - axis.target[some, None]) / within_s
        weight = (inside & (np.abs(x) <= 1.0 + 1e-6)).astype(np.float64)
        base = s_m[nearest[some]]
        y = s_m[index] - base[:, None]
        s0, s1, s2, s3, s4 = (np.sum(weight * x**k, axis=1) for k in range(5))
        t0, t1, t2 = (np.sum(weight * y * x**k, axis=1) for k in range(3))
        a, b, c = s2 * s4 - s3 * s3, s1 * s4 - s2 * s3, s1 * s3 - s2 * s2
        determinant = s0 * a - s1 * b + s2 * c
        good = (s0 >= 3.0) & (determinant > 1e-6)
        fitted = (t0 * a - t1 * b + t2 * c) / np.where(good, determinant, 1.0)
        value[some] = np.where(good, base + fitted, value[some])
    return value

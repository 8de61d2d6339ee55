"""Tracks prepared for a fit, in one of two ways.

On a whole road, the drivers see one another. Elsewhere each driver has all stretches on which they follow a known
vehicle, one after the other, behind the vehicles ahead as measured.
"""

from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import repeat
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import COUNT, RHO
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.chain import CHAIN, Chain
from sugiyama_ros.filters.extract import Drive, chain_behind, divided, drives
from sugiyama_ros.fit.coordinates import SMALLEST, fastest, lower_bounds, upper_bounds
from sugiyama_ros.fit.driver import most_seen
from sugiyama_ros.fit.recording import (
    BLOCK_S,
    FOLDS,
    MOST_SAMPLES,
    DriverName,
    Recorded,
    Vicinity,
    behind_measured,
    columns_of,
    numbered,
)
from sugiyama_ros.fit.smooth_positions import (
    Evenness,
    apart_if_smoothed,
    evenness,
    evenness_of,
    measured,
    measured_every,
    smoothed_alike,
    smoothing_window,
    thinned,
    usual_decisions,
    with_short_periods,
)
from sugiyama_ros.fit.smooth_positions import divided as divided_recording
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.dense import DenseTracks, numbers_of, road_of_drivers
from sugiyama_ros.trajectories.stretches import SHORTEST_STRETCH_S
from sugiyama_ros.trajectories.time_base import on_time_base, period_of
from sugiyama_ros.trajectories.tracks import Tracks

_Kind = TypeVar("_Kind", bound=np.generic)
# Time [s] over which the highest speed is measured.
_SPEED_OVER_S = 1.0
# Empty samples between two stretches: as many as anything looks back.
_BETWEEN = 10
# Part of the samples in which a driver must have a leader, to count as a driver who follows.
_LEAST_LED = 0.1
# Shortest block [s] that is held out, where a driver is recorded for long enough.
_SHORT_BLOCK_S = 5.0


def prepare(tracks: Tracks, decisions: int | None = None, most: int | None = MOST_SAMPLES) -> Recorded:
    """Prepare tracks for a fit: as a whole road where everybody's leader is known throughout, else as stretches.

    decisions: number of decisions of the model's drivers from one sample to the next; by default ``usual_decisions``;
    most: drivers times samples, at most; of more, some drivers stand for all; None for no bound. Raises InputError.
    """
    road = road_of_drivers(tracks)
    if road is None:
        return prepare_stretches(tracks, decisions, most)
    return prepare_road(road if decisions is None else divided_recording(measured(road), decisions), most=most)


def within(most: int | None, drivers: int, samples: int) -> range:
    """Return the numbers of drivers who stand for all."""
    return range(0, drivers, 1 if most is None else min(drivers, -(-drivers * samples // most)))


def prepare_road(trajectories: DenseTracks, segment: Ints | None = None, most: int | None = None) -> Recorded:
    """Prepare a whole road for a fit; filters restart where the number of the ``segment`` (T,) changes.

    Raises InputError.
    """
    trajectories = with_short_periods(trajectories)
    seen, decisions = measured(trajectories), measured_every(trajectories)
    window = smoothing_window(seen.road.unwrap(seen.position_m).T, seen.period_s)
    alike = smoothed_alike(trajectories.present.T, window * decisions)
    if decisions == 1:
        every = apart_if_smoothed(window, evenness(trajectories))
        trajectories = replace(trajectories, position_m=thinned(trajectories.position_m, every))
    samples, drivers = trajectories.position_m.shape
    block = _blocks_of_road(trajectories)
    who = within(most, drivers, -(-samples // measured_every(trajectories)))
    chains = tuple(chain_behind(trajectories, i, segment=segment) for i in who)
    unbroken = np.zeros(samples, np.int64) if segment is None else segment
    even, speed = evenness(measured(trajectories)), fastest(measured(trajectories))
    lower, upper = _bounds_of(even, speed)
    is_whole, around = len(who) == drivers, _vicinity_of_road(trajectories)
    return Recorded(
        vicinity=around if is_whole else behind_measured(around, chains, who),
        chains=chains,
        ahead=numbered(drivers, who)[_ahead_of_road(trajectories, who)],
        block=np.tile(block, (len(who), 1)),
        fold=np.tile(block % FOLDS, (len(who), 1)),
        segment=np.tile(unbroken, (len(who), 1)),
        scored=_who_follows(chains)[:, None] & alike[who],
        even=even,
        speed=speed,
        lower=lower,
        upper=upper,
        trajectories=trajectories if is_whole else None,
        every=measured_every(trajectories),
        decisions=decisions,
        smoothed_s=window * seen.period_s,
        left_out=drivers - len(who),
    )


def _blocks_of_road(trajectories: DenseTracks) -> Ints:
    """Number of the block of time of each sample, (T,). Raises InputError for a recording that is too short."""
    samples = len(trajectories.position_m)
    duration = trajectories.period_s * samples
    if duration < 8.0:
        raise InputError(f"{trajectories.source}: lasts {duration:.1f} s; give at least 8 s to fit and to hold out")
    block_s = min(BLOCK_S, duration / (2 * FOLDS))
    number: Ints = (np.arange(samples) * trajectories.period_s / block_s).astype(np.int64)
    return np.minimum(number, round(duration / block_s) - 1)


def _vicinity_of_road(t: DenseTracks) -> Vicinity:
    samples, drivers = t.position_m.shape
    return Vicinity(
        names=tuple(map(DriverName, t.vehicle.tolist(), repeat(""), t.names or repeat(""))),
        position_m=t.position_m,
        length_m=np.tile(t.length_m, (samples, 1)),
        leader=t.leader,
        time_s=np.tile((t.start_s + t.period_s * np.arange(samples))[:, None], (1, drivers)),
        road=t.road,
        period_s=t.period_s,
        is_whole_road=True,
        has_places=True,
        source=t.source,
        sha256=t.sha256,
    )


def _ahead_of_road(t: DenseTracks, who: Sequence[int]) -> Ints:
    """Columns of the vehicles ahead of some drivers in most samples, (N, CHAIN - 1), or -1."""
    number, samples = {v: k for k, v in enumerate(t.vehicle.tolist())}, np.arange(len(t.position_m))
    ahead = np.full((len(who), CHAIN - 1), -1)
    for k, i in enumerate(who):
        column = np.where(t.present[:, i], i, -1)
        for m in range(1, CHAIN):
            column = np.where(column >= 0, t.leader[samples, column], -1)
            ahead[k, m - 1] = number.get(most_seen(np.where(column >= 0, t.vehicle[column], -1)), -1)
    return ahead


def _who_follows(chains: Sequence[Chain]) -> Mask:
    """Whether each driver has a leader in a part of the samples, (N,); all True if nobody has."""
    there = np.array([(chain.identity[:, 0] >= 0).sum() for chain in chains])
    led = np.array([((chain.identity[:, 0] >= 0) & (chain.identity[:, 1] >= 0)).sum() for chain in chains])
    follows = led > _LEAST_LED * there
    return follows if follows.any() else np.ones_like(follows)


def _bounds_of(even: Evenness, speed: float) -> tuple[Array, Array]:
    """Return smallest sizes and upper bounds (WIDTH,) of a search over rows; ``speed``: a high one in the data."""
    lower = np.full(ROW.width, SMALLEST)
    lower[:COUNT] = lower_bounds(even)
    upper = np.array([p.upper for p in ROW.declared])
    upper[:COUNT] = upper_bounds(speed)
    upper[RHO] = 0.99
    return lower, upper


@dataclass(frozen=True, eq=False)
class Followers:
    """The drivers on tracks who follow a known vehicle: the stretches of each.

    enough: those who follow for as long as the shortest stretch lasts; decisions: number of decisions of the model's
    drivers from one measurement to the next; the samples in between are empty.
    """

    enough: tuple[tuple[Drive, ...], ...]
    decisions: int

    @property
    def every(self) -> tuple[Drive, ...]:
        """All stretches of the drivers who follow for long enough."""
        return tuple(drive for own in self.enough for drive in own)


def followers(tracks: Tracks, decisions: int | None = None) -> Followers:
    """Find the drivers who follow a known vehicle; ``decisions``: by default ``usual_decisions``. Raises InputError."""
    by_driver: dict[tuple[str, str], list[Drive]] = defaultdict(list)
    parts = decisions or usual_decisions(period_of(tracks))
    for drive in drives(tracks):
        by_driver[drive.stretch.recording, drive.stretch.vehicle].append(divided(drive, parts))
    own = [tuple(one) for one in by_driver.values()]
    found = Followers(
        tuple(one for one in own if following_s(one) >= SHORTEST_STRETCH_S),
        parts,
    )
    if not found.enough:
        lasts_s = float(np.max(tracks.time_s[tracks.start[1:] - 1] - tracks.time_s[tracks.start[:-1]], initial=0.0))
        if lasts_s < SHORTEST_STRETCH_S:
            raise InputError(
                f"{tracks.about.source}: nobody is seen for more than {lasts_s:.3g} s, but drivers must be seen to"
                f" follow for {SHORTEST_STRETCH_S:g} s; give longer recordings"
            )
        raise InputError(
            f"{tracks.about.source}: nobody follows a known vehicle for {SHORTEST_STRETCH_S:g} s; `sugiyama info` says"
            " which leaders are known"
        )
    return found


def following_s(own: Sequence[Drive]) -> float:
    """Return the time [s] of the scored samples in which somebody, or a line, is ahead of a driver."""
    return sum(
        float((d.scored & ((d.chain.identity[:, 1] >= 0) | np.isfinite(d.chain.around[:, 3]))).sum()) * d.chain.period_s
        for d in own
    )


def evenness_on(every: Sequence[Drive], apart: int = 1) -> Evenness:
    """Return how evenly drivers move on their stretches, from one sample in ``apart``."""
    return evenness_of([d.chain.position_m[::apart, 0] for d in every], apart * every[0].chain.period_s)


def fastest_on(every: Sequence[Drive], apart: int = 1) -> float:
    """Return the speed [m/s] below which 99 % of the samples of stretches are, from one sample in ``apart``."""
    period_s = apart * every[0].chain.period_s
    steps = max(1, round(_SPEED_OVER_S / period_s))
    seen = [d.chain.position_m[::apart, 0] for d in every]
    ways = [position[steps:] - position[:-steps] for position in seen]
    return float(np.nanquantile(np.concatenate(ways), 0.99)) / (steps * period_s)


def prepare_stretches(tracks: Tracks, decisions: int | None = None, most: int | None = None) -> Recorded:
    """Prepare drivers who follow a known vehicle on some stretches, behind the vehicles ahead as measured."""
    tracks = on_time_base(tracks)
    found = followers(tracks, decisions)
    every, parts = found.every, found.decisions
    drivers = [found.enough[i] for i in within(most, len(found.enough), _samples(found.enough, parts) // parts)]
    seen_s = parts * every[0].chain.period_s
    window = smoothing_window([d.chain.position_m[::parts, 0] for d in every], seen_s)
    apart = parts if parts > 1 else apart_if_smoothed(window, evenness_on(every))
    even, speed = evenness_on(every, apart), fastest_on(every, parts)
    chains = tuple(replace(one, position_m=thinned(one.position_m, apart)) for one in _chains(drivers, parts))
    samples = len(chains[0].position_m)
    block = np.array([_blocks(chain) for chain in chains])
    fold = block % FOLDS
    block[1:] += np.cumsum(block.max(axis=1) + 1)[:-1, None]
    lower, upper = _bounds_of(even, speed)
    return Recorded(
        vicinity=_vicinity(tracks, drivers, chains, parts),
        chains=chains,
        ahead=_ahead(drivers),
        block=block,
        fold=fold,
        segment=np.array([_segments(chain) for chain in chains]),
        scored=np.array([_joined([_alike(d, window * parts) for d in own], samples, False, parts) for own in drivers]),
        even=even,
        speed=speed,
        lower=lower,
        upper=upper,
        every=apart,
        decisions=parts,
        smoothed_s=window * seen_s,
        left_out=len(found.enough) - len(drivers),
    )


def driven_anew(data: Recorded, position_m: Array, segment: Ints) -> Recorded:
    """Return a recording with other positions [m] (T, N) of the drivers behind the same vehicles.

    segment: (N, T), number of the unbroken part; the filter restarts where it changes.
    """
    around, chains = data.vicinity, []
    largest = max(int(chain.identity.max()) for chain in data.chains) + 1
    for i, chain in enumerate(data.chains):
        position, identity = chain.position_m.copy(), chain.identity.copy()
        # what the recording misses is missed again
        position[:, 0] = np.where(np.isnan(position[:, 0]), np.nan, position_m[:, i])
        identity[:, 0] = np.where(identity[:, 0] >= 0, identity[:, 0] + largest * (1 + segment[i]), -1)
        chains.append(replace(chain, position_m=position, identity=identity))
    positions = np.concatenate([position_m, around.position_m[:, around.drivers :]], axis=1)
    new = replace(around, position_m=positions, source="simulated from the fitted model")
    return replace(data, vicinity=new, chains=tuple(chains), segment=segment)


def _chains(drivers: Sequence[Sequence[Drive]], parts: int) -> tuple[Chain, ...]:
    """One chain for each driver: the stretches one after the other, all chains of the same length.

    The leader's leader is in a chain where it is known on all stretches. Each measurement is at a multiple of
    ``parts``.
    """
    samples = _samples(drivers, parts)
    return tuple(_chain(own, samples, parts) for own in drivers)


def _samples(drivers: Sequence[Sequence[Drive]], parts: int) -> int:
    """Number of samples of the driver who has most, with those between stretches."""
    between = parts * _BETWEEN
    return max(sum(len(d.scored) + between for d in own) for own in drivers) - between


def _chain(own: Sequence[Drive], samples: int, parts: int) -> Chain:
    vehicles = min(CHAIN, *(d.chain.position_m.shape[1] for d in own))
    # every stretch is another vehicle for the filter, even if it is the same driver behind the same leader
    step = 1 + max(int(d.chain.identity.max()) for d in own)
    identity = [np.where(d.chain.identity >= 0, d.chain.identity + k * step, -1) for k, d in enumerate(own)]
    return Chain(
        position_m=_joined([d.chain.position_m[:, :vehicles] for d in own], samples, np.nan, parts),
        identity=_joined([one[:, :vehicles] for one in identity], samples, -1, parts),
        length_m=_joined([d.chain.length_m[:, :vehicles] for d in own], samples, 0.0, parts),
        around=_joined([d.chain.around for d in own], samples, np.nan, parts),
        period_s=own[0].chain.period_s,
        start_s=own[0].chain.start_s,
        circumference_m=own[0].chain.circumference_m,
    )


def _joined(pieces: Sequence[NDArray[_Kind]], samples: int, empty: float | bool, parts: int) -> NDArray[_Kind]:
    """Pieces (n, ...) one after the other, with ``parts`` times `_BETWEEN` empty samples between, up to ``samples``."""
    joined = np.full((samples, *pieces[0].shape[1:]), empty, dtype=pieces[0].dtype)
    at = 0
    for piece in pieces:
        joined[at : at + len(piece)] = piece
        at += len(piece) + parts * _BETWEEN
    return joined


def _alike(drive: Drive, window: int) -> Mask:
    """Samples of a stretch that count and are as smooth as all others, (T,)."""
    return np.asarray(drive.scored & smoothed_alike(np.ones((1, len(drive.scored)), np.bool_), window)[0])


def _blocks(chain: Chain) -> Ints:
    """Number of the block of each sample, (T,), from 0; the samples after the last one are in the last block."""
    there = chain.identity[:, 0] >= 0
    duration_s = float(there.sum()) * chain.period_s
    block_s = min(BLOCK_S, max(duration_s / (2 * FOLDS), min(_SHORT_BLOCK_S, duration_s / FOLDS)))
    driven_s = np.maximum(np.cumsum(there) - 1, 0) * chain.period_s
    return np.asarray(np.minimum(driven_s // block_s, max(round(duration_s / block_s), 1) - 1), dtype=np.int64)


def _segments(chain: Chain) -> Ints:
    """Number of the unbroken part of each sample, (T,): same stretch, same leader."""
    changed = (np.diff(chain.identity[:, :2], axis=0, prepend=chain.identity[:1, :2]) != 0).any(axis=1)
    return np.asarray(np.cumsum(changed), dtype=np.int64)


def _ahead(drivers: Sequence[Sequence[Drive]]) -> Ints:
    """Numbers of the drivers who are ahead in most samples, (N, CHAIN - 1), or -1."""
    number = {run_of(own): i for i, own in enumerate(drivers)}
    ahead = np.full((len(drivers), CHAIN - 1), -1)
    for i, own in enumerate(drivers):
        for m in range(1, CHAIN):
            runs = [d.chain.identity[:, m] for d in own if d.chain.identity.shape[1] > m]
            known = Counter(run for one in runs for run in one.tolist() if run >= 0)
            if known:
                ahead[i, m - 1] = number.get(known.most_common(1)[0][0], -1)
    return ahead


def run_of(own: Sequence[Drive]) -> int:
    """Number of the driver's run in the tracks."""
    return int(own[0].chain.identity[:, 0].max())


def _vicinity(tracks: Tracks, drivers: Sequence[Sequence[Drive]], chains: Sequence[Chain], parts: int) -> Vicinity:
    position, length, leader = columns_of(chains)
    numbers = numbers_of(tracks)
    names = []
    for own in drivers:
        who = own[0].stretch
        names.append(DriverName(int(numbers[run_of(own)]), who.recording, who.vehicle, who.vehicle_class))
    return Vicinity(
        names=_short(names),
        position_m=position,
        length_m=length,
        leader=leader,
        time_s=np.stack([_times(own, len(position), parts) for own in drivers], axis=1),
        road=Road(tracks.about.ring_m),
        period_s=chains[0].period_s,
        is_whole_road=False,
        has_places=len({one.recording for one in names}) == 1 and (tracks.road is None or len(tracks.road.used()) == 1),
        source=tracks.about.source,
        sha256=tracks.about.sha256,
    )


def _short(names: Sequence[DriverName]) -> tuple[DriverName, ...]:
    """The names without the recording, where there is only one."""
    several = len(Counter(one.recording for one in names)) > 1
    return tuple(one if several else replace(one, recording="") for one in names)


def _times(own: Sequence[Drive], samples: int, parts: int) -> Array:
    """Times [s] of a driver's samples, (T,); NaN between stretches."""
    times: list[Array] = [d.chain.start_s + d.chain.period_s * np.arange(len(d.scored), dtype=np.float64) for d in own]
    return _joined(times, samples, np.nan, parts)

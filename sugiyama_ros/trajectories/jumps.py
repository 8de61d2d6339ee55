"""Jumps of a vehicle that nobody drives: a digit too many, two vehicles of one name, or places in another unit."""

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.tracks import Tracks

#: Speed [m/s] and way [m] between two samples beyond which a vehicle has jumped.
FASTEST, _FARTHEST_M = 100.0, 30.0


def _jumps(step_m: Array, step_s: Array) -> Ints:
    """Numbers of the steps, of ways [m] and times [s] (S,), that are jumps."""
    return np.flatnonzero((np.abs(step_m) > _FARTHEST_M) & (np.abs(step_m) > FASTEST * step_s))


def jumps_noted(tracks: Tracks) -> str:
    """Return a warning that says where vehicles jump; empty if none does."""
    same = np.diff(tracks.run) == 0
    if tracks.road is not None:
        # each road has a start of its own
        same &= np.diff(tracks.road.code) == 0
    step_m = np.where(same, Road(tracks.about.ring_m).difference(tracks.s_m[1:], tracks.s_m[:-1]), 0.0)
    found = _jumps(step_m, np.diff(tracks.time_s))
    if not len(found):
        return ""
    row = int(found[0])
    more = f"; {len(found) - 1} more jumps" * (len(found) > 1)
    return (
        f"warning: vehicle {tracks.run_name(int(tracks.run[row]))} jumps by {step_m[row]:g} m between"
        f" {tracks.time_s[row]:g} s and {tracks.time_s[row + 1]:g} s{more}; correct or remove the rows, or give"
        " vehicles that share a name the column recording"
        + ("" if tracks.about.ring_m else "; of a ring: --ring METRES")
    )


def wrong_ring(tracks: Tracks) -> str:
    """Return a warning about the circumference of a ring on part of which nobody was ever seen; empty otherwise.

    Vehicles that drive round pass every place, so no part that is longer than their steps stays empty.
    """
    road = Road(tracks.about.ring_m)
    if not road.is_ring:
        return ""
    step_m = road.difference(tracks.s_m[1:], tracks.s_m[:-1])[np.diff(tracks.run) == 0]
    if step_m.sum() < road.circumference_m:
        return ""
    seen = np.unique(road.wrap(tracks.s_m))
    apart = np.diff(seen, append=seen[0] + road.circumference_m)
    widest = int(np.argmax(apart))
    # the steps across the part that is too long are few
    if apart[widest] <= 2.0 * float(np.quantile(np.abs(step_m), 0.75)):
        return ""
    first, last = seen[widest], (seen[widest] + apart[widest]) % road.circumference_m
    return (
        f"warning: vehicles drive round, but none was ever between {first:.4g} m and {last:.4g} m: is a circumference"
        f" of {road.circumference_m:g} m right?"
    )

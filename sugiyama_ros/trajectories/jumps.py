"""Jumps of a vehicle that nobody drives: a digit too many, two vehicles of one name, or places in another unit."""

import numpy as np

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories

#: Speed [m/s] and way [m] between two samples beyond which a vehicle has jumped.
FASTEST, FARTHEST_M = 100.0, 30.0


def _jumps(step_m: Array, step_s: Array) -> Ints:
    """Numbers of the steps, of ways [m] and times [s] (S,), that are jumps."""
    return np.flatnonzero((np.abs(step_m) > FARTHEST_M) & (np.abs(step_m) > FASTEST * step_s))


def check_jumps(trajectories: Trajectories, where: str) -> None:
    """Refuse trajectories in which a vehicle jumps. Raises InputError."""
    for column, vehicle in enumerate(trajectories.vehicle.tolist()):
        position = trajectories.position_m[:, column]
        there = np.flatnonzero(np.isfinite(position))
        position, time = position[there], trajectories.time_s[there]
        step_m = trajectories.road.difference(position[1:], position[:-1])
        found = _jumps(step_m, np.diff(time))
        if len(found):
            first = int(found[0])
            raise InputError(
                f"{where}: vehicle {vehicle} jumps by {step_m[first]:g} m between {time[first]:g} s and"
                f" {time[first + 1]:g} s; correct or remove the line, or number the vehicles differently"
            )


def jumps_noted(tracks: Tracks) -> str:
    """Return a warning that says where vehicles jump, as `check_jumps` understands it; empty if none does."""
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


def wrong_ring(trajectories: Trajectories) -> str:
    """Return a warning about the circumference of a ring on part of which nobody was ever seen; empty otherwise.

    Vehicles that drive round pass every place, so no part that is longer than their steps stays empty.
    """
    ring_m = trajectories.road.circumference_m
    if not trajectories.road.is_ring:
        return ""
    step_m = trajectories.road.difference(trajectories.position_m[1:], trajectories.position_m[:-1])
    known = np.isfinite(step_m)
    if not known.any() or step_m[known].sum() < ring_m:
        return ""
    seen = np.unique(trajectories.road.wrap(trajectories.position_m[np.isfinite(trajectories.position_m)]))
    apart = np.diff(seen, append=seen[0] + ring_m)
    widest = int(np.argmax(apart))
    # the steps across the part that is too long are few
    if apart[widest] <= 2.0 * float(np.quantile(np.abs(step_m[known]), 0.75)):
        return ""
    first, last = seen[widest], (seen[widest] + apart[widest]) % ring_m
    return (
        f"warning: vehicles drive round, but none was ever between {first:.4g} m and {last:.4g} m: is a circumference"
        f" of {ring_m:g} m right?"
    )

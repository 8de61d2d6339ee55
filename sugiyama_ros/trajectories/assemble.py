"""Columns as a file gives them, put together to tracks: sorted, checked, at the vehicles' centres, with leaders."""

from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import ArrayLike

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.errors import InputError
from sugiyama_ros.road import Road
from sugiyama_ros.trajectories.about import DEFAULT_LENGTH_M, LONGEST_M, About, Reference, checksum_of_parts
from sugiyama_ros.trajectories.jumps import FASTEST, jumps_noted, wrong_ring
from sugiyama_ros.trajectories.kinds import spelled
from sugiyama_ros.trajectories.labels import Labels, labels, labels_of, matched, numbered, same_label
from sugiyama_ros.trajectories.leaders import (
    LEAST_AGREEMENT,
    agreement,
    are_trusted,
    find_leaders,
    given_leaders,
)
from sugiyama_ros.trajectories.selection import EVERYTHING, Selection, selected
from sugiyama_ros.trajectories.speeds import MOST_OFF, UNITS, Motion, difference
from sugiyama_ros.trajectories.tracks import FLAGS, LINE, NOBODY, TEXTS, UNKNOWN, Tracks, starts

Column: TypeAlias = Labels | ArrayLike
Columns: TypeAlias = Mapping[str, Column]
#: A vehicle that is away for longer is another vehicle with the same number.
LONGEST_ABSENCE_S = 60.0
#: Share of rows that may give a vehicle a second position at the same time.
_MOST_DOUBLE = 0.01
#: Two positions [m] of a vehicle at the same time that differ by less are the same.
_SAME_M = 0.01
#: Lengths [m] of a vehicle that differ by more are noted.
_LENGTH_VARIES_M = 0.5
#: Time [s] beyond which a number is taken for damage: the year 2106.
LATEST_S = 2.0**32
# Numbers from which on nothing can be measured, by the end of a column's name: limit, unit, and what lies beyond.
_IMPOSSIBLE: tuple[tuple[str, float, str, str], ...] = (
    ("_s", LATEST_S, "s", "beyond the year 2106"),
    ("_m", 3e8, "m", "farther than seven times round the earth"),
    ("speed", 3e8, "m/s", "faster than light"),
)
_ANYTHING = ("", np.inf, "", "")
#: Way [m] that all vehicles of a lane together go backward, for the lane to be turned round: more than noise at rest.
_BACKWARD_M = 10.0
#: How a note begins that says how many of the given leaders are the next vehicles ahead.
AGREES = "the next vehicle ahead is the given leader"
# What a text of a column of flags says.
_SAYS = {"1": 1.0, "true": 1.0, "yes": 1.0, "0": 0.0, "false": 0.0, "no": 0.0}
#: Way [vehicle lengths] from the point of reference to the centre.
TO_CENTRE = {"front": -0.5, "centre": 0.0, "rear": 0.5}


def assemble(
    columns: Columns,
    about: About | None = None,
    reference: Reference = "centre",
    checked: bool = True,
    selection: Selection = EVERYTHING,
) -> Tracks:
    """Make tracks of columns.

    columns: (R,), ``vehicle``, ``time_s`` [s] and ``s_m`` [m]; perhaps ``recording``, ``road``, ``lane``, ``class``,
    ``driver``, ``leader``, ``d_m``, ``length_m``, ``width_m`` [m], the columns of `LINE`, ``leader_shift_m`` [m],
    ``measured`` and ``controlled``; rows may stand in any order; positions are compared with ``speed`` [m/s] and, if
    its unit is not known, ``some_speed``, where they are given, in the rows of a selection. Raises InputError.
    """
    table = _table(columns, about or About())
    check_possible(table.number, table.source)
    for step in (_known, _sorted, _once, *([_in_usual_units] if checked else []), _lives, _with_times):
        table = step(table)
    run = _run(table)
    table = _lengths(_speeds(table, run, selection) if checked else table, starts(run))
    table = _along(table, run) if checked else table
    number, text = table.number, table.text
    about = replace(_referred(table.about, reference), checked=not checked)
    tracks = Tracks(
        recording=text["recording"],
        vehicle=text["vehicle"],
        time_s=number["time_s"],
        s_m=number["s_m"] + TO_CENTRE[reference] * number["length_m"],
        leader_row=np.full(len(run), UNKNOWN, dtype=np.int64),
        start=starts(run),
        length_m=number["length_m"],
        about=about,
        road=text.get("road"),
        lane=text.get("lane"),
        vehicle_class=text.get("class"),
        driver=text.get("driver"),
        d_m=number.get("d_m"),
        width_m=number.get("width_m"),
        **{name: number.get(name) for name in (*LINE, "leader_shift_m")},
        measured=number["measured"] != 0.0 if "measured" in number else None,
        controlled=_in_whole_runs(number["controlled"] == 1.0, run) if "controlled" in number else None,
    )
    tracks = led(tracks, text.get("leader"), compared=checked)
    checks = (jumps_noted, wrong_ring) if checked else (wrong_ring,)
    return replace(tracks, about=tracks.about.noting(*(check(tracks) for check in checks)))


def led(tracks: Tracks, named: Labels | None, compared: bool = True) -> Tracks:
    """Return the tracks with their leaders.

    named: (R,), leaders that the file names.
    """
    if named is None:
        return replace(tracks, leader_row=find_leaders(tracks))
    given = given_leaders(tracks, named)
    whose = tracks.about.leaders
    if are_trusted(tracks) or (whose == "given" and not compared):
        return replace(tracks, leader_row=given)
    found = find_leaders(tracks)
    share = agreement(found, given)
    note = f"{AGREES} in {100.0 * share:.4g} %" if np.isfinite(share) else ""
    if share < LEAST_AGREEMENT:
        note = f"warning: {note}, fewer than {100.0 * LEAST_AGREEMENT:g} %; check lanes and positions (--columns)"
    # Whoever follows a vehicle that has no row at this time follows nobody in the table.
    named_free = named.code == (named.text.index(NOBODY) if NOBODY in named.text else len(named.text))
    out_of_view = (named.code >= 0) & ~named_free & (given < 0)
    leader_row = given if whose == "given" else np.where(out_of_view, UNKNOWN, found)
    return replace(tracks, leader_row=leader_row, about=tracks.about.noting(note))


class _Table(NamedTuple):
    """Columns of text and of numbers, with R rows each, and where they come from."""

    text: dict[str, Labels]
    number: dict[str, Array]
    about: About

    def taken(self, rows: Mask | Ints) -> "_Table":
        """Some of the rows."""
        text = {name: column[rows] for name, column in self.text.items()}
        return self._replace(text=text, number={name: column[rows] for name, column in self.number.items()})

    @property
    def source(self) -> str:
        """Name for messages."""
        return self.about.source or "tracks"


def _table(columns: Columns, about: About) -> _Table:
    text: dict[str, Labels] = {}
    number: dict[str, Array] = {}
    for name, column in columns.items():
        if name in FLAGS and isinstance(column, Labels):
            number[name] = _yes_or_no(name, column, about)
        elif isinstance(column, Labels):
            text[name] = labels(column.code, column.text)
        elif name in (*TEXTS, "leader"):
            array = np.asarray(column)
            text[name] = numbered(array) if array.dtype.kind in "fiu" else labels_of(array.tolist())
        else:
            number[name] = np.asarray(column, dtype=np.float64)
    # a column of recordings without a single name says nothing
    if "recording" in text and not (text["recording"].code >= 0).any():
        del text["recording"]
    text.setdefault("recording", same_label(len(number["s_m"]), "1"))
    if "class" in text:
        text["class"] = spelled(text["class"])
    if "leader" in text:
        text["leader"] = matched(text["leader"], text["vehicle"])
    table = _Table(text, number, about)
    return table if about.sha256 else table._replace(about=replace(about, sha256=_checksum(table)))


def _checksum(table: _Table) -> str:
    """Checksum of who is where at what time."""
    recording, vehicle = table.text["recording"], table.text["vehicle"]
    numbers = recording.code, vehicle.code, table.number["time_s"], table.number["s_m"]
    return checksum_of_parts((*recording.text, *vehicle.text, *numbers))


def _yes_or_no(name: str, column: Labels, about: About) -> Array:
    """1 where a text says yes, 0 where it says no, (R,). Raises InputError for a text that says neither.

    Where nothing is said, a row was measured, and a vehicle is not controlled.
    """
    found = [_SAYS.get(text.lower()) for text in column.text]
    if None in found:
        raise InputError(
            f"{about.source or 'tracks'}: column {name}: {column.text[found.index(None)][:40]!r} says neither yes"
            " nor no; give 1 or 0"
        )
    return np.array([*found, float(name == "measured")], dtype=np.float64)[column.code]


def _in_whole_runs(flag: Mask, run: Ints) -> Mask:
    """A flag (R,) in all rows of each run that has it in some row."""
    return np.asarray(np.bincount(run, weights=flag)[run] > 0.0)


def check_possible(numbers: Mapping[str, Array], source: str) -> None:
    """Raise InputError for a number that nothing can have; what is missing or infinite may be.

    numbers: columns (R,), whose names say their units.
    """
    for name, column in numbers.items():
        _, limit, unit, beyond = next((one for one in _IMPOSSIBLE if name.endswith(one[0])), _ANYTHING)
        wrong = np.flatnonzero((np.abs(column) >= limit) & (np.abs(column) < np.inf))
        if len(wrong):
            raise InputError(
                f"{source}: {name} is impossible in {len(wrong)} of {len(column)} rows, first {column[wrong[0]]:.6g}"
                f" {unit}, {beyond}; correct or remove these rows, or get the file again if it is damaged"
            )


def _known(table: _Table) -> _Table:
    """Leave out rows without a time or a position. Raises InputError for a row that has both, and no vehicle.

    Whoever drives behind a vehicle without a name would get the vehicle ahead of it as the leader.
    """
    time, s = table.number["time_s"], table.number["s_m"]
    keep, about = np.isfinite(time), table.about
    about = about.without("no time", int(np.sum(~keep)))
    about = about.without("no position", int(np.sum(keep & ~np.isfinite(s))))
    keep &= np.isfinite(s)
    nameless = {name: np.flatnonzero(keep & (table.text[name].code < 0)) for name in ("vehicle", "recording")}
    if max(map(len, nameless.values())) == keep.sum():
        raise InputError(f"{table.source}: no row has a vehicle, a time and a position; give such rows")
    for name, rows in nameless.items():
        if len(rows):
            raise InputError(
                f"{table.source}: {len(rows)} of {len(time)} rows have a time and a position, but no {name}, first at"
                f" {time[rows[0]]:g} s and {s[rows[0]]:g} m; give each row its {name}, or remove these rows"
            )
    return (table if keep.all() else table.taken(keep))._replace(about=about)


def _sorted(table: _Table) -> _Table:
    """Sort the rows by recording, vehicle and time."""
    vehicle, time = table.text["vehicle"], table.number["time_s"]
    if NOBODY in vehicle.text:
        raise InputError(f"{table.source}: a vehicle is called {NOBODY!r}, which has a meaning of its own; rename it")
    key = table.text["recording"].code.astype(np.int64) * (len(vehicle.text) + 1) + vehicle.code
    step = np.diff(key)
    if np.all((step > 0) | ((step == 0) & (np.diff(time) >= 0.0))):
        return table
    return table.taken(np.lexsort((time, key)))


def _run(table: _Table) -> Ints:
    """Number of the run of each row, (R,)."""
    new = (np.diff(table.text["vehicle"].code) != 0) | (np.diff(table.text["recording"].code) != 0)
    return np.concatenate((np.zeros(1, dtype=np.int64), np.cumsum(new)))


def _once(table: _Table) -> _Table:
    """Keep one row for each vehicle and time."""
    time, s, vehicle = table.number["time_s"], table.number["s_m"], table.text["vehicle"]
    double = np.zeros(len(s), dtype=bool)
    double[1:] = (np.diff(time) == 0.0) & (np.diff(_run(table)) == 0)
    if not double.any():
        return table
    apart = double.copy()
    apart[1:] &= np.abs(np.diff(s)) > _SAME_M
    if apart.sum() > _MOST_DOUBLE * len(s):
        row = int(np.flatnonzero(apart)[0])
        raise InputError(
            f"{table.source}: vehicle {vehicle.at(row)} is at {s[row - 1]:g} m and at {s[row]:g} m at {time[row]:g} s:"
            " recordings that have nothing to do with each other lie over one another; give the column recording"
            " (--columns)"
        )
    about = table.about.without("second row of a vehicle at the same time", int(double.sum() - apart.sum()))
    about = about.without("second position of a vehicle at the same time", int(apart.sum()))
    return table.taken(~double)._replace(about=about)


def _in_usual_units(table: _Table) -> _Table:
    """Raise InputError if vehicles are hardly ever seen, or faster all along than any vehicle is."""
    time, s, run = table.number["time_s"], table.number["s_m"], _run(table)
    step = np.diff(time)[np.diff(run) == 0]
    if len(step) == 0:
        return table
    if (usual := float(np.median(step))) > LONGEST_ABSENCE_S:
        raise InputError(
            f"{table.source}: a vehicle has a sample every {usual:.3g} s; check the unit of the times (--columns)"
        )
    broken = np.diff(run) != 0
    if "road" in table.text:
        # each road has a start of its own
        broken |= np.diff(table.text["road"].code) != 0
    cut = np.flatnonzero(broken)
    first, last = np.append(0, cut + 1), np.append(cut, len(run) - 1)
    first, last = first[last > first], last[last > first]
    way = np.abs(Road(table.about.ring_m).difference(s[last], s[first]))
    speed = float(np.median(way / (time[last] - time[first]))) if len(first) else 0.0
    if speed > FASTEST:
        raise InputError(
            f"{table.source}: vehicles move at {speed:.3g} m/s; check the units of positions and times (--columns)"
        )
    return table


def _lives(table: _Table) -> _Table:
    """Give a vehicle that comes back after a long time a name of its own."""
    vehicle, time, run = table.text["vehicle"], table.number["time_s"], _run(table)
    back = (np.diff(run) == 0) & (np.diff(time) > LONGEST_ABSENCE_S)
    if not back.any():
        return table
    again = np.concatenate((np.zeros(1, dtype=np.int64), np.cumsum(back)))
    start = starts(run)
    life = again - np.repeat(again[start[:-1]], np.diff(start))
    width = int(life.max()) + 1
    unique, code = np.unique(vehicle.code.astype(np.int64) * width + life, return_inverse=True)
    names = [vehicle.text[u // width] + (f"~{u % width + 1}" if u % width else "") for u in unique.tolist()]
    # A name that is used again does not say which of the vehicles leads.
    text = {name: column for name, column in table.text.items() if name != "leader"}
    about = table.about.noting(f"numbers of vehicles are used again {int(back.sum())} times; later ones end in ~2, ~3")
    return _sorted(_Table({**text, "vehicle": labels(code.astype(np.int32), names)}, table.number, about))


def _with_times(table: _Table) -> _Table:
    """Leave out lines of which it is not known when others reach and leave the place behind them."""
    if "line_m" not in table.number:
        return table
    line, unknown = table.number["line_m"], np.full(len(table.number["line_m"]), np.nan)
    timed = ~np.isnan(table.number.get("arrive_s", unknown) + table.number.get("clear_s", unknown))
    lost = int(np.sum(np.isfinite(line) & ~timed))
    note = f"lines without arrive_s and clear_s: {lost} rows, which count as rows without a line" * (lost > 0)
    number = {**table.number, "line_m": np.where(timed, line, np.nan)}
    return table._replace(number=number, about=table.about.noting(note))


def lengths_of(vehicle: Ints, given: Array) -> Array:
    """Lengths [m] of rows (R,) of vehicles with numbers: the median of the lengths given for each, or the usual one."""
    can_be = (given > 0.0) & (given < LONGEST_M)
    length = np.where(can_be, given, np.nan)
    low, high = np.full(int(vehicle.max(initial=-1)) + 1, np.inf), np.full(int(vehicle.max(initial=-1)) + 1, -np.inf)
    np.minimum.at(low, vehicle[can_be], length[can_be])
    np.maximum.at(high, vehicle[can_be], length[can_be])
    for one in np.flatnonzero(high > low).tolist():
        low[one] = np.nanmedian(length[vehicle == one])
    return np.where(np.isfinite(low), low, DEFAULT_LENGTH_M)[vehicle]


def _lengths(table: _Table, start: Ints) -> _Table:
    """One length [m] for each run, repeated for its rows."""
    rows = np.diff(start)
    if "length_m" not in table.number:
        note = f"no lengths: every vehicle counts as {DEFAULT_LENGTH_M:g} m long"
        usual = np.full(int(start[-1]), DEFAULT_LENGTH_M)
        return table._replace(number={**table.number, "length_m": usual}, about=table.about.noting(note))
    given = table.number["length_m"]
    length = lengths_of(np.repeat(np.arange(len(rows)), rows), given)
    given = np.where((given > 0.0) & (given < LONGEST_M), given, np.nan)
    low, high = np.fmin.reduceat(given, start[:-1]), np.fmax.reduceat(given, start[:-1])
    varies, unknown = int(np.sum(high - low > _LENGTH_VARIES_M)), int(np.sum(np.isnan(low)))
    about = table.about.noting(
        f"lengths that vary by more than {_LENGTH_VARIES_M:g} m: {varies} vehicles; the median counts" * (varies > 0),
        f"lengths that are missing: {unknown} vehicles, which count as {DEFAULT_LENGTH_M:g} m long" * (unknown > 0),
    )
    return table._replace(number={**table.number, "length_m": length}, about=about)


def _speeds(table: _Table, run: Ints, selection: Selection) -> _Table:
    """Compare the positions with the speeds that the file gives, which are left out then."""
    number, about = table.number.copy(), table.about
    speed, some = number.pop("speed", None), number.pop("some_speed", None)
    given = speed if speed is not None else some
    if given is None:
        return table
    road = table.text["road"].code.astype(np.int64) + 1 if "road" in table.text else 0
    piece = run * (int(np.max(road)) + 1) + road
    keep = selected(selection, table.text.get, number["time_s"])
    motion = Motion(piece[keep], number["time_s"][keep], number["s_m"][keep], given[keep])
    units = UNITS[:1] if speed is not None else UNITS
    found = [one for unit in units if (one := difference(motion, about.ring_m, unit)) is not None]
    if found and min(one.part for one in found) > MOST_OFF:
        unit = "m/s" if speed is not None else "(no unit)"
        slow, fast = found[0].by_position, found[0].by_speed
        says = (
            f"vehicles move at {slow:.3g} m/s by their positions, but at {fast:.3g} {unit} by the speeds in the file;"
            " check the positions, the times and their units"
        )
        if not table.source.endswith(".xml"):
            says += ", or say which columns hold them (--format table --columns map.yaml)"
        # Where no vehicle is on a lane, nobody follows anybody, and positions do no harm.
        if speed is not None and ("lane" not in table.text or (table.text["lane"].code >= 0).any()):
            raise InputError(f"{table.source}: {says}")
        about = about.noting(f"warning: {says}")
    return table._replace(number=number, about=about)


def _along(table: _Table, run: Ints) -> _Table:
    """Turn positions round on lanes where most of them decrease, so that they grow along the drive."""
    s, about = table.number["s_m"], table.about
    group = table.text["recording"].code.astype(np.int64)
    for name in ("road", "lane"):
        if name in table.text:
            group = group * (len(table.text[name].text) + 1) + table.text[name].code
    _, group = np.unique(group, return_inverse=True)
    step = np.where((np.diff(run) == 0) & (np.diff(group) == 0), np.diff(s), 0.0)
    if about.ring_m > 0.0:
        step -= about.ring_m * np.round(step / about.ring_m)
    way, steps = (np.bincount(group[1:], weights=w, minlength=int(group.max()) + 1) for w in (step, np.sign(step)))
    # on a ring that nobody has named, most steps go forward, and the jumps at its end go back
    turned = ((way < -_BACKWARD_M) & (steps < 0.0))[group]
    if not turned.any():
        return table
    recording = table.text["recording"].code
    farthest = np.full(int(recording.max()) + 1, -np.inf)
    np.maximum.at(farthest, recording, s)
    note = f"positions decrease along the drive in {100.0 * turned.mean():.3g} % of the rows; they were turned round"
    number = {**table.number, "s_m": np.where(turned, farthest[recording] - s, s)}
    if "line_m" in number:
        number["line_m"] = np.where(turned, farthest[recording] - number["line_m"], number["line_m"])
    if "leader_shift_m" in number:
        number["leader_shift_m"] = np.where(turned, -number["leader_shift_m"], number["leader_shift_m"])
    return table._replace(number=number, about=about.noting(note))


def _referred(about: About, reference: Reference) -> About:
    """The same, with a note that positions were moved to the centres."""
    note = f"positions are {reference} bumpers in the file; they were moved to the centres" * (reference != "centre")
    of_source = about.reference if reference == "centre" else reference
    return replace(about, reference=of_source, unit="m").noting(note)

"""Tracks: what many vehicles did on many lanes, as a table with one row for each vehicle and time."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from sugiyama_ros.arguments import checked
from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import writing
from sugiyama_ros.results import Result, needs, space_time
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.labels import Labels

if TYPE_CHECKING:
    import pandas
    from matplotlib.figure import Figure, SubFigure

    from sugiyama_ros.trajectories.dense import DenseTracks

#: Leader of a driver whom nobody is ahead of, and of a driver whose leader is not in the table.
FREE, UNKNOWN = -1, -2
#: Names of the columns of the road ahead.
LINE = ("line_m", "arrive_s", "clear_s", "curvature_per_m")
#: Names of the columns of numbers that may be infinite.
INFINITE = ("arrive_s", "clear_s")
#: Names of the columns of text and of numbers, in the order of a file.
TEXTS = ("recording", "vehicle", "road", "lane", "class", "driver")
NUMBERS = ("time_s", "s_m", "d_m", "length_m", "width_m", *LINE, "leader_shift_m")
#: Names of the columns that say yes or no.
FLAGS = ("measured", "controlled")
_REQUIRED = ("recording", "vehicle", "time_s", "s_m")
#: What the column ``leader`` of a file says where nobody is ahead. It is empty where the leader is not known.
NOBODY = "free"


@dataclass(frozen=True, eq=False, repr=False)
class Tracks(Result):
    """A table of R rows, sorted by recording, vehicle and time.

    A *run* is all rows of one vehicle in one recording.

    Parameters
    ----------
    recording, vehicle : Labels, shape (R,)
        Which recording, and which vehicle in it.
    time_s, s_m : ndarray, shape (R,)
        Time [s], and position [m] of the vehicle's centre along the road, which grows along the drive.
    leader_row : ndarray of int, shape (R,)
        Row of the vehicle directly ahead at the same time; `FREE` where nobody is ahead, `UNKNOWN` where the vehicle
        ahead is not in the table.
    start : ndarray of int, shape (V + 1,)
        First row of each run, and R.
    length_m : ndarray, shape (R,)
        Length [m] of the vehicle, the same in all rows of a run.
    about : About
        Where the table comes from.
    road, lane, vehicle_class, driver : Labels, shape (R,), optional
        Road and lane of the row; class of the vehicle, and who drives. In files, ``vehicle_class`` is ``class``.
    d_m, width_m : ndarray, shape (R,), optional
        Position [m] across the road, and width [m] of the vehicle.
    measured : ndarray of bool, shape (R,), optional
        Whether the row was measured, not filled in.
    line_m, arrive_s, clear_s : ndarray, shape (R,), optional
        Position [m] of the next line before which the driver lets others pass, and times [s] until who goes first
        reaches the place behind the line and until they have left it; NaN where there is no line. The first time is 0
        while the place is taken or a signal is red, the second is infinite at a red signal, and below 0 after the
        signal has turned green.
    curvature_per_m : ndarray, shape (R,), optional
        Largest curvature [1/m] of the road just ahead.
    leader_shift_m : ndarray, shape (R,), optional
        What must be added to the leader's ``s_m`` [m] to get their position along the driver's own way, where drivers
        come from several ways; NaN for nothing.
    controlled : ndarray of bool, shape (R,), optional
        Whether a controller drives the vehicle, the same in all rows of a run. Such a vehicle leads drivers, but has
        none.

    Examples
    --------
    >>> import numpy as np
    >>> from sugiyama_ros.trajectories.assemble import assemble
    >>> time = np.array([0.0, 0.1, 0.0, 0.1])
    >>> tracks = assemble({"vehicle": ["b", "b", "a", "a"], "time_s": time, "s_m": np.array([9.0, 10.0, 0.0, 1.0])})
    >>> tracks
    <Tracks: 2 vehicles in 1 recording, 4 rows, leaders known in 50 %, from memory>
    >>> tracks.leader_row
    array([ 2,  3, -2, -2])
    """

    recording: Labels
    vehicle: Labels
    time_s: Array
    s_m: Array
    leader_row: Ints
    start: Ints
    length_m: Array
    about: About = field(default_factory=About)
    road: Labels | None = None
    lane: Labels | None = None
    vehicle_class: Labels | None = None
    driver: Labels | None = None
    d_m: Array | None = None
    width_m: Array | None = None
    line_m: Array | None = None
    arrive_s: Array | None = None
    clear_s: Array | None = None
    curvature_per_m: Array | None = None
    leader_shift_m: Array | None = None
    measured: Mask | None = None
    controlled: Mask | None = None

    def __len__(self) -> int:
        return len(self.time_s)

    @property
    def runs(self) -> int:
        """Number V of runs."""
        return len(self.start) - 1

    @cached_property
    def run(self) -> Ints:
        """Number of the run of each row, shape (R,)."""
        return np.repeat(np.arange(self.runs), np.diff(self.start))

    @cached_property
    def leader(self) -> Labels:
        """Name of the vehicle ahead, shape (R,): `NOBODY` on a free road, missing where it is not known."""
        ahead = self.vehicle.code[np.maximum(self.leader_row, 0)]
        code = np.where(self.leader_row >= 0, ahead, np.where(self.leader_row == FREE, len(self.vehicle.text), -1))
        return Labels(code.astype(np.int32), (*self.vehicle.text, NOBODY))

    @cached_property
    def controlled_runs(self) -> Mask:
        """Whether a controller drives the vehicle of each run, shape (V,)."""
        if self.controlled is None:
            return np.zeros(self.runs, dtype=bool)
        return self.controlled[self.start[:-1]]

    @property
    def leaders_known(self) -> float:
        """Share of the rows whose leader is in the table, or who have a free road."""
        return float(np.mean(self.leader_row != UNKNOWN)) if len(self) else 0.0

    def run_name(self, run: int) -> str:
        """Vehicle and recording of a run, for messages."""
        row = int(self.start[run])
        recording = self.recording.at(row)
        return self.vehicle.at(row) + (f" of recording {recording}" if len(self.recording.text) > 1 else "")

    @property
    def controlled_names(self) -> list[str]:
        """Names of the vehicles that a controller drives, as of `run_name`."""
        return [self.run_name(run) for run in np.flatnonzero(self.controlled_runs).tolist()]

    def column(self, name: str) -> Labels | Array | Mask | None:
        """A column by its name in files; None for one that is not there. Raises InputError for another name."""
        if not isinstance(name, str) or name not in (*TEXTS, *NUMBERS, "leader", *FLAGS):
            raise InputError(f"{str(name)[:40]!r}: no column of tracks; choose among {', '.join(self.columns)}")
        found = getattr(self, "vehicle_class" if name == "class" else name)
        return found if found is None or isinstance(found, Labels) else np.asarray(found)

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns that are there, as in files."""
        optional = (
            "road",
            "lane",
            "d_m",
            "length_m",
            "width_m",
            "class",
            "driver",
            "leader",
            *LINE,
            "leader_shift_m",
            *FLAGS,
        )
        return (*_REQUIRED, *(name for name in optional if self.column(name) is not None))

    def select(self, rows: Mask) -> "Tracks":
        """Keep some of the rows; a leader who is left out is unknown from then on, and not everybody is in view.

        Parameters
        ----------
        rows : ndarray of bool, shape (R,)
            Which rows to keep.

        Returns
        -------
        Tracks
            The rows that are kept.

        Raises
        ------
        InputError
            For anything but one yes or no for each row.
        """
        if not isinstance(rows, np.ndarray) or rows.dtype != bool or rows.shape != (len(self),):
            raise InputError(f"rows: give an array of {len(self)} times True or False, as of tracks.time_s > 10.0")
        new_row = np.where(rows, np.cumsum(rows) - 1, UNKNOWN)
        ahead = self.leader_row[rows]
        kept = {name: None if (c := self.column(name)) is None else c[rows] for name in (*TEXTS, *NUMBERS, *FLAGS)}
        kept["vehicle_class"] = kept.pop("class")
        start = starts(self.run[rows])
        leader_row = np.where(ahead >= 0, new_row[np.maximum(ahead, 0)], ahead)
        lost = bool(np.any((ahead >= 0) & (leader_row < 0)))
        about = replace(self.about, view="end") if lost else self.about
        return replace(self, **kept, leader_row=leader_row, start=start, about=about)  # type: ignore[arg-type]

    def dense(self, where: str = "") -> "DenseTracks":
        """Return the positions as arrays with a row for each time and a column for each vehicle.

        Parameters
        ----------
        where : str
            Name of the file in error messages; by default the name of the source.

        Returns
        -------
        DenseTracks
            Positions (T, N) of N vehicles at T regular times; NaN where a vehicle has no row.

        Raises
        ------
        InputError
            For more than one recording, road or lane, and where the vehicle ahead on the lane is not the leader.
        """
        from sugiyama_ros.trajectories.dense import dense

        return dense(self, where)

    def headline(self) -> str:
        """Say how many vehicles, recordings and rows there are, and how many leaders are known."""
        recordings = len(self.recording.used())
        return (
            f"{self.runs} vehicles in {recordings} recording{'s' * (recordings != 1)}, {len(self)} rows, leaders known"
            f" in {100.0 * self.leaders_known:.3g} %, from {self.about.source or 'memory'}"
        )

    def records(self) -> "TrackRows":
        """List the rows, each made when it is asked for."""
        return TrackRows(self)

    def to_frame(self) -> "pandas.DataFrame":
        """Return the table as a data frame; columns of text are categorical.

        Returns
        -------
        pandas.DataFrame
            One row for each row, with the columns of a file.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        needs("pandas", "to_frame()")
        import pandas

        frame: dict[str, Any] = {}
        for name in self.columns:
            column: Any = self.column(name)
            if isinstance(column, Labels):
                column = pandas.Categorical.from_codes(column.code, column.text)
            frame[name] = column
        return pandas.DataFrame(frame)

    @checked()
    def save(self, path: str | Path) -> None:
        """Write the table to a file.

        Parameters
        ----------
        path : str or Path
            File to write: ``.parquet`` for the table with everything that is known about it; ``.csv``, ``.json``,
            ``.png`` and ``.pdf`` as for other results.

        Raises
        ------
        InputError
            For another suffix, or a library that is not installed.
        OutputError
            If the file cannot be written.
        """
        path = Path(path)
        if path.suffix != ".parquet":
            super().save(path)
            return
        from sugiyama_ros.trajectories.exchange import write_parquet

        with writing(path) as stream:
            write_parquet(self, stream)

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw the positions of the longest recording over time, coloured by speed."""
        codes, counts = np.unique(self.recording.code, return_counts=True)
        shown = self.select(self.recording.code == codes[np.argmax(counts)])
        speed = np.full(len(shown), np.nan)
        steps = np.flatnonzero(shown.run[1:] == shown.run[:-1])
        speed[steps] = np.diff(shown.s_m)[steps] / np.diff(shown.time_s)[steps]
        space_time(figure, shown.time_s, shown.s_m[:, None], speed[:, None])


class TrackRows(Sequence[Mapping[str, Any]]):
    """The rows of tracks as mappings of column names to values, each made when it is asked for."""

    def __init__(self, tracks: Tracks) -> None:
        self._columns = {name: tracks.column(name) for name in tracks.columns}
        self._rows = len(tracks)

    def __len__(self) -> int:
        return self._rows

    def __iter__(self) -> Iterator[Mapping[str, Any]]:
        return (self[row] for row in range(self._rows))

    @overload
    def __getitem__(self, row: int) -> Mapping[str, Any]: ...
    @overload
    def __getitem__(self, row: slice) -> Sequence[Mapping[str, Any]]: ...
    def __getitem__(self, row: int | slice) -> Mapping[str, Any] | Sequence[Mapping[str, Any]]:
        if isinstance(row, slice):
            return [self[one] for one in range(*row.indices(self._rows))]
        if not -self._rows <= row < self._rows:
            raise IndexError(row)
        return {name: _cell(column, row) for name, column in self._columns.items()}


def _cell(column: Labels | NDArray[Any] | None, row: int) -> Any:
    if isinstance(column, Labels):
        return column.at(row) or None
    return None if column is None else column[row].item()


def starts(run: Ints) -> Ints:
    """First row of each run, and the number of rows, of numbers (R,) that are sorted by run."""
    new = np.flatnonzero(np.diff(run)) + 1
    return np.concatenate(([0], new, [len(run)])) if len(run) else np.zeros(1, dtype=np.int64)

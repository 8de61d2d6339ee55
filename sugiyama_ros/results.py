"""How results show themselves: as text, a table, a data frame, a picture, a page of HTML, or a file."""

import html
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from io import BytesIO
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from sugiyama_ros.arguments import checked
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import writing

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure

    from sugiyama_ros.arrays import Array

#: A difference is clear from this number of standard errors on.
CLEARLY = 2.0
#: A colour that people with any colour vision tell apart from others (Okabe and Ito).
BLUE = "#0072b2"
_GREY = "#7f7f7f"


def figure(value: float, digits: int = 3) -> str:
    """Write a number for people: with so many digits, and never as 1.63e+03.

    Examples
    --------
    >>> figure(1634.2), figure(0.01234), figure(999.7)
    ('1634', '0.0123', '1000')
    """
    text = f"{value:.{digits}g}"
    return f"{value:.0f}" if "e+" in text else text


def counted(number: int, noun: str) -> str:
    """Write a number of things.

    Examples
    --------
    >>> counted(1, "driver"), counted(3, "driver")
    ('1 driver', '3 drivers')
    """
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


@dataclass(frozen=True)
class TextTable:
    """A table of text.

    title: title above the table; empty for no title; headings: heading of each column; rows: cells of each row, one
    cell for each heading; left: number of columns that are aligned to the left, counted from the left; the other
    columns are aligned to the right.
    """

    title: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: int = 0


class Result:
    """A result that can show itself.

    A result says in one line what it is (`headline`), lists its figures (`records`) and draws its picture (`draw`).
    Everything else follows from these.
    """

    def headline(self) -> str:
        """Say in one line what the result is."""
        raise NotImplementedError

    def records(self) -> Sequence[Mapping[str, Any]]:
        """List the figures: one mapping of column names to values for each row."""
        raise NotImplementedError

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw the picture into an empty figure of matplotlib, or a part of one."""
        raise NotImplementedError

    def to_frame(self) -> "pandas.DataFrame":
        """Return the figures as a data frame.

        Returns
        -------
        pandas.DataFrame
            One row for each record.

        Raises
        ------
        InputError
            If pandas is not installed.
        """
        needs("pandas", "to_frame()")
        import pandas

        return pandas.DataFrame.from_records(list(self.records()))

    def summary(self) -> str:
        """Return the headline and the first records as text.

        Returns
        -------
        str
            One line that says what the result is, and a table with a line for each of the first records.
        """
        rows = self.records()[:_SHOWN]
        names = list(dict.fromkeys(name for row in rows for name in row))
        lines = [names, *([_cell(row.get(name)) for name in names] for row in rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        table = ["  ".join(map(str.rjust, line, widths)) for line in lines if names]
        return "\n".join((self.headline(), *table))

    def plot(self, ax: "Axes | None" = None) -> "Figure | SubFigure":
        """Draw the picture.

        Parameters
        ----------
        ax : matplotlib.axes.Axes, optional
            Axes whose place in a figure the picture takes; a figure of its own without it.

        Returns
        -------
        matplotlib.figure.Figure or matplotlib.figure.SubFigure
            The figure, which a notebook shows; with ``ax`` the part of its figure.

        Raises
        ------
        InputError
            If matplotlib is not installed.
        """
        if ax is None:
            return self._picture()
        place = ax.get_subplotspec() if hasattr(ax, "get_subplotspec") else None
        if place is None:
            raise InputError("plot(ax=): these axes are no part of a grid; make them with subplots()")
        part = ax.figure.add_subfigure(place)
        ax.remove()
        self.draw(part)
        return part

    def _picture(self) -> "Figure":
        needs("matplotlib", "plot()")
        from matplotlib.figure import Figure

        class Picture(Figure):
            """A figure that a notebook shows, whether or not pyplot is in use."""

            def _repr_png_(self) -> bytes:
                stream = BytesIO()
                self.savefig(stream, format="png", dpi=100)
                return stream.getvalue()

        figure = Picture(figsize=(9.0, 5.0), layout="constrained")
        self.draw(figure)
        return figure

    @checked()
    def save(self, path: str | Path) -> None:
        """Write the result to a file.

        Parameters
        ----------
        path : str or Path
            File to write; the suffix says how: ``.json`` and ``.csv`` for the figures, ``.png`` and ``.pdf`` for the
            picture.

        Raises
        ------
        InputError
            For another suffix, or a library that is not installed.
        OutputError
            If the file cannot be written.
        """
        path = Path(path)
        writers = {".json": self._save_json, ".csv": self._save_csv, ".png": self._save_plot, ".pdf": self._save_plot}
        if path.suffix not in writers:
            raise InputError(f"{path}: cannot be written as {path.suffix!r}; give a name in {', '.join(writers)}")
        with writing(path) as stream:
            writers[path.suffix](stream, path.suffix[1:])

    def _save_json(self, stream: BinaryIO, _: str) -> None:
        stream.write((to_json(list(self.records()), indent=2) + "\n").encode())

    def _save_csv(self, stream: BinaryIO, _: str) -> None:
        stream.write(self.to_frame().to_csv(index=False).encode())

    def _save_plot(self, stream: BinaryIO, kind: str) -> None:
        self._picture().savefig(stream, dpi=150, format=kind)

    def __repr__(self) -> str:
        return f"<{type(self).__name__}: {self.headline()}>"

    def _repr_html_(self) -> str:
        """Show the headline and the first rows in a notebook."""
        rows = self.records()
        lines = [f"<p><b>{type(self).__name__}</b>: {html.escape(self.headline())}</p>"]
        if rows:
            names = list(dict.fromkeys(name for row in rows[:_SHOWN] for name in row))
            lines.append("<table><thead><tr>" + "".join(f"<th>{html.escape(n)}</th>" for n in names) + "</tr></thead>")
            for row in rows[:_SHOWN]:
                lines.append("<tr>" + "".join(f"<td>{html.escape(_cell(row.get(n)))}</td>" for n in names) + "</tr>")
            lines.append("</table>")
        if len(rows) > _SHOWN:
            lines.append(f"<p>{len(rows)} rows in all; to_frame() has them.</p>")
        return "".join(lines)


# Rows of a table in a notebook, at most.
_SHOWN = 15


def _cell(value: Any) -> str:
    if value is None:
        return ""
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def needs(module: str, what: str) -> None:
    """Check that an optional library is there. Raises InputError, which says how to install it."""
    if find_spec(module) is None:
        raise InputError(f"{what}: {module} is not installed; pip install {module}")


def to_json(document: Any, indent: int | None = None) -> str:
    """Write a document as JSON; NaN and infinite numbers become null."""
    return json.dumps(plain(document), indent=indent, allow_nan=False)


def plain(value: Any) -> Any:
    """Convert a value to types that JSON knows: no NaN, no infinity, no numpy, no paths."""
    if isinstance(value, Mapping):
        return {str(k): plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, Path):
        return str(value)
    if hasattr(value, "item"):
        # a number of numpy
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def space_time(figure: "Figure | SubFigure", time_s: "Array", position_m: "Array", speed: "Array") -> None:
    """Draw trajectories in space and time, coloured by speed.

    time_s: (T,), times [s]; position_m, speed: (T, N), positions [m], wrapped on a ring, and speeds [m/s]; NaN where
    unknown.
    """
    axes = figure.subplots()
    time = time_s[:, None].repeat(position_m.shape[1], axis=1)
    seen = (time.ravel(), position_m.ravel())
    dots = axes.scatter(*seen, c=speed.ravel(), s=1.5, cmap="cividis", linewidths=0, rasterized=True)
    figure.colorbar(dots, ax=axes, label="speed [m/s]")
    axes.set(xlabel="time [s]", ylabel="position [m]")


def bars(axes: Any, names: list[str], values: list[float], errors: list[float], label: str) -> None:
    """Draw horizontal bars with error bars, the first bar on top."""
    axes.barh(names[::-1], values[::-1], xerr=errors[::-1], color=BLUE, ecolor=_GREY)
    axes.set(xlabel=label)

"""What all results can do in a notebook: become a data frame, a picture, a page of HTML, or a file."""

import html
import json
import math
from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from sugiyama_ros.errors import InputError
from sugiyama_ros.outputs import writing

if TYPE_CHECKING:
    import pandas
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, SubFigure


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
        needs("pandas", "to_frame()", "notebook")
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
        place = ax.get_subplotspec()
        if place is None:
            raise InputError("plot(ax=): these axes are no part of a grid; make them with subplots()")
        part = ax.figure.add_subfigure(place)
        ax.remove()
        self.draw(part)
        return part

    def _picture(self) -> "Figure":
        needs("matplotlib", "plot()", "notebook")
        from sugiyama_ros.picture import Picture

        figure = Picture(figsize=(9.0, 5.0), layout="constrained")
        self.draw(figure)
        return figure

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
        stream.write((json.dumps(plain(list(self.records())), indent=2, allow_nan=False) + "\n").encode())

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


def needs(module: str, what: str, extra: str) -> None:
    """Check that an optional library is there. Raises InputError, which says how to install it."""
    if find_spec(module) is None:
        raise InputError(f"{what}: {module} is not installed; pip install {module}")


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

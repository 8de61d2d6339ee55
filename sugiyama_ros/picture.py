"""A figure of matplotlib that a notebook shows, whether or not pyplot is in use. Only this file needs matplotlib."""

from io import BytesIO

from matplotlib.figure import Figure


class Picture(Figure):
    """A figure that knows its picture."""

    def _repr_png_(self) -> bytes:
        stream = BytesIO()
        self.savefig(stream, format="png", dpi=100)
        return stream.getvalue()

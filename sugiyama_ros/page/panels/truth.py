"""Panel of a simulated run: estimates against the truth."""

from bokeh.models import ColumnDataSource, UIElement, Whisker

from sugiyama_ros.page.panels.base import BLUE, GREY, VERMILION, panel
from sugiyama_ros.page.truth import SHOWN, AgainstTruth


def estimates(found: AgainstTruth, name: str) -> UIElement:
    """Estimate of one parameter over its truth, with 95 % intervals; on the grey line, both are equal."""
    of = [one for one in found.parameters if one.name == name]
    source = ColumnDataSource(
        {
            "truth": [one.truth for one in of],
            "estimate": [one.estimate for one in of],
            "lower": [one.lower for one in of],
            "upper": [one.upper for one in of],
            "colour": [BLUE if one.covered else VERMILION for one in of],
        }
    )
    unit = SHOWN[name]
    plot = panel(f"{name}: estimate and truth; red: outside of the interval", f"true [{unit}]", f"estimated [{unit}]")
    ends = [f(one.truth for one in of) for f in (min, max)] if of else []
    plot.line(ends, ends, color=GREY)
    plot.scatter("truth", "estimate", source=source, size=8, color="colour")
    plot.add_layout(Whisker(base="truth", lower="lower", upper="upper", source=source, line_color=GREY))
    return plot

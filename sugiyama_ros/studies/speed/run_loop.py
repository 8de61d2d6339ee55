"""The loop of ``sugiyama run``, over its floors: an empty graph of nodes, the filters, and writing the file."""

from sugiyama_ros.studies import run_speed
from sugiyama_ros.studies.speed.figure import SpeedFigure
from sugiyama_ros.studies.speed.recording import jam


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the loop with the topics of each vehicle, and with one message for all drivers."""
    return tuple(
        SpeedFigure(f"{kind}_run", f"loop of a run, {kind}, over its floors", one["loop_over_floors"], "times", 2.5)
        for kind, one in run_speed.measure(jam()).items()
    )

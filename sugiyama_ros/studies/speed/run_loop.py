"""The loop of ``sugiyama run``, over its floors: an empty graph of nodes, the filters, and writing the file.

With all drivers in one message, the floors are lower, too. The first version of the loop took 8.3 times the floors with
the topics of each vehicle; one message is to take a sixth of this.
"""

from sugiyama_ros.studies import run_speed
from sugiyama_ros.studies.speed.figure import SpeedFigure
from sugiyama_ros.studies.speed.recording import jam

_FIRST_VERSION, _FASTER = 8.3, 6.0


def measure() -> tuple[SpeedFigure, ...]:
    """Measure the loop with the topics of each vehicle, and with one message for all drivers."""
    found = run_speed.measure(jam())
    each, one = found["topics_of_each_vehicle"], found["one_message"]
    return (
        SpeedFigure(
            "topics_of_each_vehicle_run",
            "loop of a run with the topics of each vehicle, over its floors",
            each["loop_over_floors"],
            at_most=2.5,
        ),
        SpeedFigure(
            "one_message_run",
            "loop of a run with all drivers in one message, over its own floors",
            one["loop_over_floors"],
        ),
        SpeedFigure(
            "one_message_over_topics",
            "the same over the floors with the topics of each vehicle",
            one["loop_s"] / each["floors_s"],
            at_most=round(_FIRST_VERSION / _FASTER, 2),
        ),
    )

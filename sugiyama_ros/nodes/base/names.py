"""Names of the parameters of all nodes. A node refuses a name that no node has, since it is misspelt."""

from collections.abc import Iterable, Mapping
from difflib import get_close_matches

from sugiyama_ros.driver.parameters import NAMES
from sugiyama_ros.errors import InputError

_SOURCE = ("rate", "wait_for", "start_paused", "exit_at_end")
_SIMULATED = ("scene", "vehicles", "ring", "start", "start_gap", "lengths", "period", "duration", "spread", "seed")
_FOLLOWED = ("vehicles", "retire_after", "most_drivers", "reorder_window", "vehicle_topics", "ask_keeper", "autostart")
_LEARNT = ("model", "law", "adapt", "engine", "save_state", "resume")
#: Names of the parameters of each node, by the node's own name: it may be renamed.
PARAMETERS_OF: Mapping[str, tuple[str, ...]] = {
    "critic": NAMES,
    "drivers": (*NAMES, *_FOLLOWED, *_LEARNT, "publish", "centre_line", "frame"),
    "keeper": (),
    "recorder": ("output", "overwrite", "paced_topics", "metadata", "time_source", "split_mb"),
    "replay": (*_SOURCE, "source", "ring", "loop"),
    "simulator": (*NAMES, *_SOURCE, *_SIMULATED, "model", "effects", "controlled", "controller"),
    "tracks": ("centre_line", "topics", "bridge", "frame", "period", "length", "ahead"),
}
# How names begin that ROS itself understands, of every node.
_OF_ROS = "qos_overrides."


def for_other_nodes(node: str, called: str, given: Iterable[str]) -> list[str]:
    """Names of parameters that a node was given and does not have, but another node has.

    ROS hands the section ``/**`` of a parameter file to every node, so that a file for several nodes gives each node
    some of the others' parameters. Raises InputError for a name that no node has, with the nearest name.

    node: name of the node in ``PARAMETERS_OF``; called: its name now.
    """
    own = PARAMETERS_OF.get(node)
    if own is None:
        return []
    known = {name for names in PARAMETERS_OF.values() for name in names}
    others = sorted(name for name in given if name not in own and not name.startswith(_OF_ROS))
    for name in others:
        if name not in known:
            near = "".join(f", the nearest is {one}" for one in get_close_matches(name, own, 1, 0.0))
            raise InputError(
                f"parameter {name}: {called} has none of this name{near}; correct it, or give what is for another node"
                " under its name, not under /**"
            )
    return others

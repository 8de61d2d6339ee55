"""Environment variables that the ROS libraries read. Programs set them before they start a node; imports never do."""

import os
import random
import socket
import sys

from sugiyama_ros.errors import InputError

# Domains whose ports lie outside the range from which Linux takes ephemeral ports.
_DOMAINS = range(1, 102)
# The last domain whose ports exist.
_LAST_DOMAIN = 232
# Participants whose ports fit into a domain.
_PARTICIPANTS = 120


def find_packages() -> None:
    """Say where ROS is installed, unless the environment does: wheels install it below the interpreter's prefix."""
    os.environ.setdefault("AMENT_PREFIX_PATH", sys.prefix)


def isolate() -> str:
    """Keep this process and its children on this machine, in a domain of their own, unless the user has chosen."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    if "ROS_DOMAIN_ID" not in os.environ:
        domains = random.sample(_DOMAINS, len(_DOMAINS))
        os.environ["ROS_DOMAIN_ID"] = str(next(filter(is_free, domains), domains[0]))
    return os.environ["ROS_DOMAIN_ID"]


def domain() -> str:
    """Return the number of the ROS domain, as the environment says it."""
    return os.environ.get("ROS_DOMAIN_ID") or "0"


def check() -> None:
    """Raise InputError for a domain that ROS cannot use, with which it would fail in many ways."""
    given = domain()
    if not (given.isascii() and given.isdecimal() and int(given) <= _LAST_DOMAIN):
        raise InputError(f"ROS_DOMAIN_ID: {given!r} is no domain; give a number from 0 to {_LAST_DOMAIN}")


def is_free(domain: int) -> bool:
    """Whether all ports are free on which participants of a domain listen (DDSI-RTPS, section 9.6.1).

    After a run was killed, its processes may live on for a while. A new run in the same domain would use their road.
    """
    first = 7410 + 250 * domain
    for port in range(first, first + 2 * _PARTICIPANTS, 2):
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            try:
                probe.bind(("", port))
            except OSError:
                return False
    return True

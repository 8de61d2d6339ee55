"""The forms of a mechanism, of which one is chosen."""

from collections.abc import Sequence
from typing import Protocol, TypeVar

from sugiyama_ros.diagnosis.candidates import Candidate


class Gaining(Protocol):
    """A look at a candidate, or a fit of it."""

    @property
    def candidate(self) -> Candidate:
        """The candidate."""

    @property
    def gain(self) -> float:
        """Gain of the candidate [nats]."""


_Look = TypeVar("_Look", bound=Gaining)


def best_forms(looks: Sequence[_Look]) -> list[_Look]:
    """Return the looks at, or the fits of, the form of each mechanism that gains most."""
    best: dict[str, _Look] = {}
    for look in looks:
        mechanism = look.candidate.mechanism
        if mechanism not in best or look.gain > best[mechanism].gain:
            best[mechanism] = look
    return list(best.values())

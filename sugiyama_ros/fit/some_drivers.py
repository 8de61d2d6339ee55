"""Some drivers of a recording, as tracks behind the vehicles that they have followed."""

from collections.abc import Sequence
from dataclasses import replace

from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.vicinity import behind_measured, numbered


def some_drivers(data: Recorded, who: Sequence[int]) -> Recorded:
    """Return the part of a recording that says how some drivers drive."""
    chosen = list(who)
    chains = tuple(data.chains[i] for i in chosen)
    return replace(
        data,
        vicinity=behind_measured(data.vicinity, chains, chosen),
        chains=chains,
        ahead=numbered(data.drivers, chosen)[data.ahead[chosen]],
        block=data.block[chosen],
        fold=data.fold[chosen],
        segment=data.segment[chosen],
        scored=data.scored[chosen],
        trajectories=None,
    )

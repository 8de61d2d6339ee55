"""A search to its end, in both orders where an effect and freed constants cannot be told apart at first."""

from dataclasses import replace

from sugiyama_ros.diagnosis.addition import FLEXIBLE, advice_for
from sugiyama_ros.diagnosis.search import LEVEL, Search
from sugiyama_ros.fit.cross_validation import gain


def grown(search: Search, most: int, *, add_forces: bool) -> Search:
    """Carry out a search to its end, and return it, or the search in the other order if that predicts better.

    Freed constants take in part of whatever is missing, and an effect may stand for constants that are off. What comes
    first decides what is left for the others, so both orders are tried to the end and compared held out. Constants go
    first only by two standard errors; by one where their model is not worse than the base model in the last part, and
    the other model is. If the other order is not worse by one, its first name cannot be told apart.

    Parameters
    ----------
    search : Search
        The search, at its beginning.
    most : int
        Maximum number of effects to add.
    add_forces : bool
        Whether the best force without a name may be added at the end.

    Returns
    -------
    Search
        The search whose final model predicts best.
    """
    _grow(search, most, add_forces)
    other = search.other_order
    if other is None:
        return search
    _grow(other, most, add_forces)
    won = gain(search.data, other.errors.samples, search.errors.samples)
    holds = _is_worse_in_use(search) and not _is_worse_in_use(other)
    if won.nats > (FLEXIBLE if other.named[0].kind == "constants" and not holds else 1.0) * won.se:
        return other
    if won.nats > -won.se:
        _tell(search, other.named[0].name)
    return search


def _grow(search: Search, most: int, add_forces: bool) -> None:
    """Add supported candidates to the model, and one force without a name, if asked for."""
    is_growing = True
    while is_growing:
        while len(search.named) < most and search.add_effect():
            pass
        # a new force may make other candidates supported
        is_growing = add_forces and search.add_force(search.forces(LEVEL))
        add_forces = False


def _is_worse_in_use(search: Search) -> bool:
    """Whether the final model of a search is worse than the base model in the last part."""
    return bool(search.named[-1].worse)


def _tell(search: Search, rival: str) -> None:
    """Say that a name cannot be told apart from the first name of a search."""
    first = search.named[0]
    if rival not in (first.name, *first.indistinguishable):
        rivals = (*first.indistinguishable, rival)
        search.named[0] = replace(first, indistinguishable=rivals, advice=advice_for(first.name, rivals))

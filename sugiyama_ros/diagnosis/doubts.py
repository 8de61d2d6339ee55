"""What speaks against additions to a model, however much they gain."""

from collections.abc import Callable, Mapping, Sequence

from sugiyama_ros.diagnosis.addition import Addition
from sugiyama_ros.diagnosis.discover import FORCE
from sugiyama_ros.diagnosis.law_check import FURTHER
from sugiyama_ros.effects.discovered_force import COVARIATES
from sugiyama_ros.effects.registry import EFFECTS
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.tables import figure

# A sign is wrong if a parameter is on the wrong side by this many standard deviations.
_SURELY = 2.0
# With more other effects that explain the data as well, the cause may not be listed.
_MOST_ALIKE = 1
# Freed constants gain less [nats] from causes too weak to tell, such as a force that an oracle would know by 14 nats.
_OF_ANYTHING = 50.0


def doubts(data: Recorded, named: Sequence[Addition]) -> list[str]:
    """Say what speaks against additions.

    Parameters
    ----------
    data : Recorded
        The recording.
    named : sequence of Addition
        The additions.

    Returns
    -------
    list of str
        Sentences; empty if nothing speaks against them.
    """
    return [
        *_few_say(data, named),
        *_unnamed_say(named),
        *_use_says(named),
        *_runs_say(named),
        *_many_say(named),
        *_constants_say(named),
    ]


def signs_say(named: Sequence[Addition], stds: Mapping[str, float]) -> list[str]:
    """Say which parameters of the additions are on the wrong side of what is physically possible.

    Parameters
    ----------
    named : sequence of Addition
        The additions.
    stds : mapping of str to float
        Standard errors of the shared parameters, by name.

    Returns
    -------
    list of str
        Sentences; empty if all signs make sense.
    """
    return [
        f"{one.name} has a sign that makes no physical sense: {wrong}"
        for one in named
        for wrong in wrong_signs(one, lambda: stds)
    ]


def wrong_signs(one: Addition, stds: Callable[[], Mapping[str, float]]) -> tuple[str, ...]:
    """Return the parameters of an addition that are on the wrong side of what is physically possible.

    Parameters
    ----------
    one : Addition
        The addition.
    stds : callable
        Returns standard errors of its parameters, by name. It is called only if a value is on the wrong side.

    Returns
    -------
    tuple of str
        Each parameter with its value, in words.
    """
    limits = EFFECTS[one.form].least if one.form in EFFECTS else {}
    below = {name: one.parameters[name] - least for name, least in limits.items() if name in one.parameters}
    below = {name: off for name, off in below.items() if off < 0.0}
    errors = stds() if below else {}
    return tuple(
        f"{name} is {figure(one.parameters[name])}"
        for name, off in below.items()
        if off < -_SURELY * errors.get(f"{one.form}.{name}", errors.get(name, 0.0))
    )


def _few_say(data: Recorded, named: Sequence[Addition]) -> list[str]:
    """Which additions stand for something that a few drivers do."""
    return [
        f"{len(one.drivers)} of {data.drivers} drivers bring nearly all of what {one.name} gains: they may do something"
        f" that is not listed"
        for one in named
        if one.is_of_others_too
    ]


def _unnamed_say(named: Sequence[Addition]) -> list[str]:
    """Whether a force without a name was added."""
    covariates = [COVARIATES[round(one.parameters["covariate"]) - 1] for one in named if one.name == FORCE]
    return [f"a force that depends on {covariate} was added, and has no name" for covariate in covariates]


def _use_says(named: Sequence[Addition]) -> list[str]:
    """Whether the additions do worse beyond what they were fitted to; what drivers really do brings errors closer."""
    told = "if the last 40 % are not fitted, it is worse there than the base model"
    return [told for one in named[-1:] if one.worse]


def _runs_say(named: Sequence[Addition]) -> list[str]:
    """Whether free runs end clearly further off with the additions, or as much further as a law would be told for.

    Noises may be added although runs get worse, and a few runs do not say surely that they do.
    """
    if not named:
        return []
    after, before = named[-1].after, named[0].before
    off, base = after.free_run_10s_m, before.free_run_10s_m
    if after.no_worse_than(before) and not off > FURTHER * base:
        return []
    ends = f"{figure(off, 2)} m off instead of {figure(base, 2)} m for the base model"
    return [f"its free runs get worse: after 10 s they end {ends}"]


def _many_say(named: Sequence[Addition]) -> list[str]:
    """Whether so many effects explain the data as well as the first addition that the cause may be none of them."""
    alike = [(one.name, *one.indistinguishable) for one in named[:1] if len(one.indistinguishable) > _MOST_ALIKE]
    return [
        f"{', '.join(names[:-1])} and {names[-1]} explain the data as well: the cause may be none of them"
        for names in alike
    ]


def _constants_say(named: Sequence[Addition]) -> list[str]:
    """Whether what was found first is freed constants that gain little: they take in part of whatever is missing."""
    return [
        f"{one.name} gains {one.heldout.nats:.0f} nats, as freed constants do whatever is missing: the cause may be"
        " something else"
        for one in named[:1]
        if one.kind == "constants" and one.heldout.nats < _OF_ANYTHING
    ]

"""Changes of drivers as people write them: ``NAME=VALUE`` for a parameter, ``NAME:PARAMETER=VALUE`` for an effect."""

from sugiyama_ros.errors import InputError


def read_parameter(text: str, where: str) -> tuple[str, float]:
    """Name and value of a parameter from ``NAME=VALUE``. Raises InputError."""
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise InputError(f"{where} {text}: is not NAME=VALUE with a number as value") from None


def read_effect(text: str, where: str) -> tuple[str, dict[str, float]]:
    """Name of an effect and values of its parameters from ``NAME:PARAMETER=VALUE[,PARAMETER=VALUE]``.

    Raises InputError.
    """
    name, _, pairs = text.partition(":")
    try:
        return name, {k: float(v) for k, _, v in (pair.partition("=") for pair in pairs.split(","))}
    except ValueError:
        raise InputError(f"{where} {text}: is not NAME:PARAMETER=VALUE[,PARAMETER=VALUE]{_parameters(name)}") from None


def _parameters(name: str) -> str:
    """The parameters that an effect has, for the error of one without values."""
    from sugiyama_ros.effects.registry import EFFECTS

    if name not in EFFECTS:
        return ""
    known = (
        f"{p.name} ({p.lower:g} to {p.upper:g}{f' {p.unit}' if p.unit != '1' else ''})"
        for p in EFFECTS[name].parameters
    )
    return f"; {name} has {', '.join(known)}"

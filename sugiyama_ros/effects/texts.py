"""Changes of drivers as people write them: ``NAME=VALUE`` for a parameter, ``NAME:PARAMETER=VALUE`` for an effect."""

from sugiyama_ros.errors import InputError


def read_parameter(text: str, where: str) -> tuple[str, float]:
    """Name and value of a parameter from ``NAME=VALUE``.

    Parameters
    ----------
    text : str
        The text.
    where : str
        Option or parameter that holds the text, for the error.

    Raises
    ------
    InputError
        For another text.
    """
    name, _, value = text.partition("=")
    try:
        return name, float(value)
    except ValueError:
        raise InputError(f"{where} {text}: is not NAME=VALUE with a number as value") from None


def read_effect(text: str, where: str) -> tuple[str, dict[str, float]]:
    """Name of an effect and values of its parameters from ``NAME:PARAMETER=VALUE[,PARAMETER=VALUE]``.

    Parameters
    ----------
    text : str
        The text.
    where : str
        Option or parameter that holds the text, for the error.

    Raises
    ------
    InputError
        For another text.
    """
    name, _, pairs = text.partition(":")
    try:
        return name, {k: float(v) for k, _, v in (pair.partition("=") for pair in pairs.split(","))}
    except ValueError:
        raise InputError(f"{where} {text}: is not NAME:PARAMETER=VALUE[,PARAMETER=VALUE]") from None

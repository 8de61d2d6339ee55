"""Options that several commands share, and the checks of their values."""

import functools
import inspect
import math
import shlex
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, TypeVar, get_type_hints

import typer
from typer.models import ArgumentInfo

from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Output

Sources = Annotated[
    list[Path], typer.Argument(help="Trajectories: files or folders in any known format, each of which is a recording.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON document instead of text.")]
Ring = Annotated[float | None, typer.Option(help="Circumference of the road [m], if the file does not give it.")]
Scheduler = Annotated[
    str | None, typer.Option(help="Address of a Dask scheduler whose workers do the work, such as tcp://host:8786.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace output files that are there already.")]
Rate = Annotated[
    str, typer.Option(help="Speed of the replay in multiples of real time, or max for as fast as possible.")
]
ModelFile = Annotated[
    Path | None, typer.Option("--model", help="Model file (YAML), written by diagnose -o or calibrate -o.")
]
Law = Annotated[str, typer.Option(help="Car-following law by which the drivers drive; `sugiyama laws` lists them.")]
SetParameter = Annotated[
    list[str] | None, typer.Option("--set", help="NAME=VALUE: parameter of all drivers. May be repeated.")
]
AddEffect = Annotated[
    list[str] | None,
    typer.Option("--effect", help="NAME:PARAMETER=VALUE[,...]: effect on all drivers. May be repeated."),
]
Seed = Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")]

_Options = TypeVar("_Options")


def takes(options: type[_Options]) -> Callable[[Callable[[_Options], None]], Callable[..., None]]:
    """Make a command whose function takes one frozen dataclass; each field becomes an argument or an option.

    Typer reads the parameters of a function. This decorator shows Typer one parameter for each field of ``options``.
    """

    def decorate(function: Callable[[_Options], None]) -> Callable[..., None]:
        @functools.wraps(function)
        def command(**values: object) -> None:
            function(options(**values))

        command.__annotations__ = get_type_hints(options, include_extras=True)
        command.__signature__ = inspect.signature(options)  # type: ignore[attr-defined]
        return command

    return decorate


def command_line(name: str, options: Callable[..., object], **values: object) -> str:
    """The command that somebody can paste to run a command with these values of its arguments and options.

    options: its function, or the class of its options, as for ``takes``.
    """
    hints, parameters = get_type_hints(options, include_extras=True), inspect.signature(options).parameters
    arguments, rest = [], []
    for field, value in values.items():
        if value is None or value is False or value == parameters[field].default:
            continue
        (about,) = hints[field].__metadata__
        every = value if isinstance(value, list | tuple) else [value]
        given = [f"{one:g}" if isinstance(one, float) else str(one) for one in every]
        if isinstance(about, ArgumentInfo):
            arguments += given
        else:
            # typer takes the first name of an annotated option for its default
            flags = [flag for flag in (about.default, *(about.param_decls or ())) if isinstance(flag, str)]
            flag = min(flags, key=len, default=f"--{field.replace('_', '-')}")
            rest += [flag] if value is True else [part for one in given for part in (flag, one)]
    return shlex.join(["sugiyama", name, *arguments, *rest])


def names(text: str) -> tuple[str, ...]:
    """The names in a list that is separated by commas. Raises InputError for a list without a name."""
    found = tuple(name.strip() for name in text.split(",") if name.strip())
    if text and not found:
        raise InputError(f"{text!r}: has no name; give names with commas between, or leave out the option")
    return found


def rate_of(text: str) -> float:
    """Multiple of real time; 0 for ``max``. Raises InputError."""
    if text == "max":
        return 0.0
    try:
        rate = float(text)
    except ValueError:
        rate = math.nan
    if not 0.0 < rate < 1e6:
        raise InputError(f"--rate {text}: is not a rate; give a positive number, or max")
    return rate


def to_write(path: Path, overwrite: bool, *endings: str) -> Output:
    """The file to write, checked before the work begins. Raises InputError for another ending, or OutputError."""
    if endings and path.suffix not in endings:
        raise InputError(
            f"{path}: cannot be written as {path.suffix or 'nothing'}; give a name that ends in {' or '.join(endings)}"
        )
    output = Output(path, overwrite)
    output.check()
    return output


def model_to_write(path: Path | None, overwrite: bool) -> Output | None:
    """The model file to write, if one is wanted. Raises InputError or OutputError."""
    return None if path is None else to_write(path, overwrite, ".yaml", ".yml")


def own_output(given: Path | None, own: str, overwrite: bool) -> Output:
    """The file to write: the one that was given, or else the file of the command's own name, which it may replace."""
    return to_write(Path(own), True) if given is None else to_write(given, overwrite, ".mcap")

"""The commands. Each command imports what it needs when it runs, so that ``sugiyama --help`` answers at once."""

import contextlib
import ctypes
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperCommand

from sugiyama_ros import files, progress
from sugiyama_ros.cli import calibrate, catalogue, data, demo, diagnose, limit_bytes, report, run, simulate, study
from sugiyama_ros.errors import InputError

# Names of arguments and options whose files are written; all other files that a command is given are inputs.
_WRITTEN = {"output", "save", "save_state", "directory"}


class _Command(TyperCommand):
    """A command that never writes to a file that it was given as an input, and takes no empty text for a folder."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        # as a path, an empty text is the current folder
        is_empty = "" in args and not any(one and Path(one) == Path() for one in args)
        rest = super().parse_args(ctx, args)
        for name, value in ctx.params.items() if is_empty else ():
            if Path() in (value if isinstance(value, list | tuple) else [value]):
                raise InputError(f"{name}: is empty; give the name of a file or a folder")
        return rest

    def invoke(self, ctx: Any) -> Any:
        for name, value in ctx.params.items():
            if name not in _WRITTEN:
                for path in value if isinstance(value, list | tuple) else [value]:
                    if isinstance(path, Path):
                        files.note_given(path)
        return super().invoke(ctx)


# Without rich's markup, which would take a unit such as [m] for a style and leave it out.
app = typer.Typer(no_args_is_help=True, add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
for command in (
    demo.demo,
    run.run,
    simulate.simulate,
    calibrate.calibrate,
    diagnose.diagnose,
    study.study,
    diagnose.compare,
    catalogue.effects,
    catalogue.laws,
    catalogue.controllers,
    report.report,
    run.live,
    data.convert,
    data.fetch,
    data.info,
    data.echo,
    data.recover,
):
    app.command(cls=_Command)(command)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib import metadata

        print(f"sugiyama {metadata.version('sugiyama_ros')}")
        raise typer.Exit


@app.callback()
def _sugiyama(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Show the version and exit.")
    ] = False,
) -> None:
    """Estimate how people drive, live or from recordings, and find out what the driver model lacks."""
    _check_limit()
    _share_heap()
    progress.on_compiling = progress.CompilingTold()


# Address space [bytes] below which libraries may end in an endless loop instead of an error.
_LEAST = 1 << 30
# Parameter of mallopt in glibc: the largest number of heaps.
_HEAPS = -8


def _check_limit() -> None:
    """Raise InputError if the shell gives less address space than the libraries need."""
    limit = limit_bytes()
    if limit is not None and limit < _LEAST:
        raise InputError(f"ulimit -v: gives {limit >> 20} MB of memory; the commands need {_LEAST >> 20} MB or more")


def _share_heap() -> None:
    """Let all threads share one heap: by default each has its own, and keeps what it has freed (glibc)."""
    # other C libraries have no mallopt
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).mallopt(_HEAPS, 1)

"""The command line: ``sugiyama``. Arguments in, a table or one JSON document out; other rooms do the work.

Tables and documents go to stdout, everything else to stderr. An error that a user can correct ends the program with one
line and exit code 2. Each command imports what it needs when it runs, so that ``sugiyama --help`` answers at once.
"""

import os
import sys
from typing import Annotated

import typer

from sugiyama_ros.cli import calibrate, data, demo, diagnose, report, run, simulate, study
from sugiyama_ros.errors import SugiyamaError

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
    report.report,
    run.live,
    data.convert,
    data.fetch,
    data.info,
    data.echo,
    data.recover,
):
    app.command()(command)


def _print_version(wanted: bool) -> None:
    if wanted:
        from importlib import metadata

        print(f"sugiyama {metadata.version('sugiyama_ros')}")
        raise typer.Exit


@app.callback()
def sugiyama(
    version: Annotated[
        bool, typer.Option("--version", is_eager=True, callback=_print_version, help="Show the version and exit.")
    ] = False,
) -> None:
    """Estimate how people drive, live or from recordings, and find out what the driver model lacks."""


def main() -> None:
    """Entry point of the console script."""
    # The work is shared out over drivers. Threads of the linear algebra would only take processor time from it.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    try:
        app()
    except SugiyamaError as error:
        print(f"error: {error}", file=sys.stderr)
        sys.exit(2)
    except BrokenPipeError:
        # the program that reads the output has closed it
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        sys.exit(1)

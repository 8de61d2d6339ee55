"""``sugiyama convert``, ``fetch``, ``info``, ``echo`` and ``recover``: the files."""

import dataclasses
import sys
from datetime import datetime, timezone
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from sugiyama_ros.cli.options import Json, Overwrite, Ring, Source
from sugiyama_ros.cli.output import print_json, print_line, print_note, print_table, progress, tell, to_json
from sugiyama_ros.errors import InputError
from sugiyama_ros.outputs import Output, name_of_part
from sugiyama_ros.tables import TextTable

if TYPE_CHECKING:
    from sugiyama_ros.formats.mcap_reader import BagInfo


def convert(
    source: Source,
    output: Annotated[Path, typer.Argument(help="MCAP file to write.")],
    overwrite: Overwrite = False,
    ring: Ring = None,
    as_json: Json = False,
) -> None:
    """Convert trajectories to MCAP.

    The file has the topics /road and /measured.
    """
    from sugiyama_ros.formats.convert import convert as convert_file

    t = convert_file(source, Output(output, overwrite), ring)
    document = {
        "output": str(output),
        "vehicles": len(t.vehicle),
        "steps": len(t.position_m),
        "period_s": t.period_s,
        "ring_m": t.road.circumference_m or None,
        "sha256": t.sha256,
    }
    road = f"a ring of {t.road.circumference_m:g} m" if t.road.is_ring else "an open road (a ring? give --ring METRES)"
    text = f"{len(t.vehicle)} vehicles, {len(t.position_m)} samples of {t.period_s:.4g} s on {road}, in {output}"
    tell(document, text, as_json)


def fetch(
    name: Annotated[str, typer.Argument(help="Name of the data set, such as sugiyama2008.")],
    directory: Annotated[Path, typer.Option("--directory", "-d", help="Directory to write to.")] = Path(),
    accept_licence: Annotated[
        bool, typer.Option("--accept-licence", help="Accept the terms of use without being asked.")
    ] = False,
    url: Annotated[str | None, typer.Option(help="Another address of the same file.")] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Download a public data set, check it, and convert it to MCAP."""
    from sugiyama_ros.formats.catalogue import CATALOGUE
    from sugiyama_ros.formats.fetch import fetch as download

    if name not in CATALOGUE:
        raise InputError(f"{name}: not in the catalogue; it has {', '.join(CATALOGUE)}")
    print_note(CATALOGUE[name].licence)
    if not accept_licence:
        if not sys.stdin.isatty():
            raise InputError(f"{name}: its terms were not accepted; add --accept-licence")
        typer.confirm("Do you accept these terms?", abort=True, err=True)
    with progress("downloading") as advance:
        fetched = download(name, directory, url, advance, overwrite)
    tell(dataclasses.asdict(fetched), f"{fetched.data}\n{fetched.bag}", as_json)


def info(
    file: Annotated[Path, typer.Argument(help="MCAP file.")],
    as_json: Json = False,
) -> None:
    """Show what an MCAP file contains, as `ros2 bag info` does."""
    from sugiyama_ros.formats.mcap_reader import Bag

    with Bag(file) as bag:
        about = bag.info()
    if as_json:
        print_json(dataclasses.asdict(about))
        return
    for key, value in _lines(about):
        print_line(f"{key + ':':<13}{value}")
    rows = tuple((t.name, t.type, str(t.count), t.reliability, t.durability) for t in about.topics)
    headings = ("topic", "type", "messages", "reliability", "durability")
    print_table(TextTable("", headings, rows, left=len(headings)), boxed=False)


def _lines(about: "BagInfo") -> list[tuple[str, str]]:
    lines = [
        ("Files", about.file),
        ("Bag size", f"{about.size_bytes / 1024:.1f} KiB"),
        ("Storage id", about.storage),
        ("Compression", ", ".join(about.compression) or "none"),
        ("Duration", f"{about.duration_s:.9g} s"),
        ("Start", _moment(about.start_ns)),
        ("End", _moment(about.end_ns)),
        ("Messages", str(about.messages)),
    ]
    for record, values in about.metadata.items():
        lines.append(("Metadata", f"{record}: " + ", ".join(f"{key}={value}" for key, value in values.items())))
    return lines


def _moment(ns: int) -> str:
    # stamps of a recording are times of day; stamps of converted data count the seconds from the start
    return f"{ns / 1e9:.9f} ({datetime.fromtimestamp(ns / 1e9, tz=timezone.utc):%Y-%m-%d %H:%M:%S} UTC)"


def echo(
    file: Annotated[Path, typer.Argument(help="MCAP file.")],
    topic: Annotated[str, typer.Argument(help="Topic, such as /vehicle_07/innovation.")],
    as_json: Json = False,
) -> None:
    """Print the messages of one topic."""
    from sugiyama_ros.formats.cdr import plain
    from sugiyama_ros.formats.mcap_reader import Bag

    with Bag(file) as bag:
        messages = bag.messages({topic})
        if as_json:
            sys.stdout.write("[")
            for number, (_, _, log_time_ns, message) in enumerate(messages):
                document = {"log_time_ns": log_time_ns, "message": plain(message)}
                sys.stdout.write(("," if number else "") + "\n" + to_json(document))
            sys.stdout.write("\n]\n")
            return
        for _, _, log_time_ns, message in messages:
            sys.stdout.write(f"# {log_time_ns}\n{to_json(plain(message), indent=2)}\n---\n")


def recover(
    file: Annotated[Path, typer.Argument(help="Cut or damaged MCAP file, or the .part file of a run that was killed.")],
    output: Annotated[
        Path | None,
        typer.Option(
            "--output",
            "-o",
            help="File to write. By default FILE without .part, or FILE.recovered.mcap.",
        ),
    ] = None,
    overwrite: Overwrite = False,
    as_json: Json = False,
) -> None:
    """Save the intact part of a cut or damaged MCAP file.

    The intact part goes to a new file, which is verified.
    """
    from sugiyama_ros.formats.recover import recover as salvage

    if output is None:
        output = name_of_part(file) or file.with_name(f"{file.stem}.recovered.mcap")
    saved = salvage(file, Output(output, overwrite))
    text = (
        f"{saved.messages} messages on {saved.topics} topics saved and read back, {saved.lost_bytes} bytes lost;"
        f" in {saved.path}"
    )
    tell(dataclasses.asdict(saved), text, as_json)

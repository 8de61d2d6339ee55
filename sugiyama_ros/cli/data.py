"""``sugiyama convert``, ``fetch``, ``info``, ``echo`` and ``recover``: the files."""

import dataclasses
import math
import sys
from collections.abc import Callable, Iterable
from datetime import datetime, timezone
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from sugiyama_ros.cli.options import Json, Overwrite, Ring, names, takes, to_write
from sugiyama_ros.cli.output import print_json, print_line, print_note, print_table, tell
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Output, name_of_part
from sugiyama_ros.progress import stage
from sugiyama_ros.results import TextTable, to_json

if TYPE_CHECKING:
    from sugiyama_ros.formats.choices import Choices
    from sugiyama_ros.formats.convert import Part
    from sugiyama_ros.formats.mcap_reader import BagInfo
    from sugiyama_ros.trajectories.selection import Selection

# Year in which stamps begin.
_EPOCH = 1970


_RoadFile = Annotated[
    Path | None,
    typer.Option("--road-file", help="Of vehicles in the plane: the road (Lanelet2, CommonRoad, SUMO or CSV)."),
]


@dataclasses.dataclass(frozen=True)
class _ConvertOptions:
    """What ``sugiyama convert`` takes."""

    source: Annotated[Path, typer.Argument(help="File or folder of trajectories, in any known format.")]
    output: Annotated[Path, typer.Argument(help="File to write: .parquet or .csv (tracks), or .mcap (one lane).")]
    ring: Ring = None
    format: Annotated[str, typer.Option("--format", help="Format of the file; an unknown name lists them all.")] = (
        "auto"
    )
    columns: Annotated[
        Path | None, typer.Option("--columns", help="Map (YAML) of columns of tracks to columns of the file.")
    ] = None
    reference: Annotated[
        str | None,
        typer.Option("--reference", help="What positions are of, if not as the format says: centre, front or rear."),
    ] = None
    road_file: _RoadFile = None
    recording: Annotated[str, typer.Option("--recording", help="Recordings to keep, separated by commas.")] = ""
    road: Annotated[str, typer.Option("--road", help="Roads to keep.")] = ""
    lane: Annotated[str, typer.Option("--lane", help="Lanes to keep.")] = ""
    vehicle_class: Annotated[str, typer.Option("--class", help="Classes of vehicles to keep.")] = ""
    without: Annotated[str, typer.Option("--without", help="Vehicles to leave out.")] = ""
    from_s: Annotated[float, typer.Option("--from", help="First time [s] to keep.")] = -math.inf
    to_s: Annotated[float, typer.Option("--to", help="Last time [s] to keep.")] = math.inf
    period: Annotated[
        float | None, typer.Option("--period", help="Time between two samples [s], if not the file's own.")
    ] = None
    odometry: Annotated[
        str, typer.Option("--odometry", help="Of a bag: pattern of the topics of vehicles, such as '/car*/odom'.")
    ] = ""
    centre_line: Annotated[
        Path | None, typer.Option("--centerline", help="With --odometry: centre line (CSV: x, y[, lane, width]).")
    ] = None
    bridge: Annotated[
        Path | None, typer.Option("--bridge", help="With --odometry: what a message of another type says (YAML).")
    ] = None
    frame: Annotated[str, typer.Option("--frame", help="With --odometry: frame of the centre line.")] = ""
    overwrite: Overwrite = False
    as_json: Json = False


@takes(_ConvertOptions)
def convert(options: _ConvertOptions) -> None:
    """Convert a file to tracks, or one lane to MCAP.

    Tracks are a table in Parquet or CSV. An MCAP file has the topics /road and /measured. With --odometry, the tracks
    are those of vehicles that a perception has seen.
    """
    if options.odometry or options.centre_line is not None:
        _convert_seen(options)
        return
    from sugiyama_ros.formats.convert import convert as convert_file

    _refuse(options, ("bridge", "frame"), "needs a bag of sightings; add --odometry and --centerline, or leave it out")
    output = to_write(options.output, options.overwrite)
    _tell_tracks(convert_file(options.source, output, _part(options)), options)


def _convert_seen(options: _ConvertOptions) -> None:
    """Convert what a perception has seen to tracks."""
    from sugiyama_ros.bridges.bridge import read_bridge
    from sugiyama_ros.bridges.from_bag import tracks_of_bag
    from sugiyama_ros.bridges.perception import PerceptionSettings
    from sugiyama_ros.formats.centre_line import read_lanes
    from sugiyama_ros.formats.tracks_parquet import write_tracks
    from sugiyama_ros.trajectories.selection import chosen

    if not options.odometry or options.centre_line is None:
        raise InputError("convert: --odometry and --centerline go together; give both")
    of_files = ("ring", "format", "columns", "reference", "road_file")
    _refuse(options, of_files, "does nothing with --odometry, where the centre line is the road; leave it out")
    if options.output.suffix.lower() not in (".parquet", ".csv"):
        raise InputError(f"{options.output}: tracks are written as .parquet or .csv; give such a name")
    output = to_write(options.output, options.overwrite)
    settings = PerceptionSettings(frame=options.frame)
    if options.period is not None:
        settings = dataclasses.replace(settings, period_s=options.period)
    bridge = read_bridge(options.bridge) if options.bridge is not None else None
    tracks = tracks_of_bag(options.source, options.odometry, read_lanes(options.centre_line), settings, bridge)
    tracks = chosen(tracks, _selection(options))
    write_tracks(tracks, output)
    _tell_tracks(tracks, options)


def _refuse(options: _ConvertOptions, fields: Iterable[str], why: str) -> None:
    """Raise InputError for the first of some options that is given; ``why``: why it cannot be, and the cure."""
    for name in fields:
        if getattr(options, name) != getattr(_ConvertOptions, name):
            raise InputError(f"--{name.replace('_', '-')}: {why}")


def _tell_tracks(tracks: "Tracks", options: _ConvertOptions) -> None:
    """Say what was written."""
    document = {"output": str(options.output), **_document_of(tracks)}
    if options.as_json:
        print_json(document)
        return
    print_line(f"{tracks.runs} vehicles, {len(tracks)} rows, in {options.output}")
    _print_tracks(document)


def _part(options: _ConvertOptions) -> "Part":
    """Which part of the source the options ask for."""
    from sugiyama_ros.formats.choices import Choices, read_choices, reference_of
    from sugiyama_ros.formats.convert import Part
    from sugiyama_ros.formats.roads import read_road

    choices = Choices() if options.columns is None else read_choices(options.columns)
    if (reference := reference_of(options.reference)) is not None:
        choices = dataclasses.replace(choices, reference=reference)
    if options.ring is not None:
        choices = dataclasses.replace(choices, ring_m=options.ring)
    if options.road_file is not None:
        choices = dataclasses.replace(choices, network=read_road(options.road_file))
    return Part(options.format, dataclasses.replace(choices, selection=_selection(options)), options.period)


def _selection(options: _ConvertOptions) -> "Selection":
    """Which rows the options keep."""
    from sugiyama_ros.trajectories.selection import Selection

    return Selection(
        recording=names(options.recording),
        road=names(options.road),
        lane=names(options.lane),
        vehicle_class=names(options.vehicle_class),
        without=names(options.without),
        from_s=options.from_s,
        to_s=options.to_s,
    )


def _print_tracks(document: dict[str, Any]) -> None:
    for key, value in _lines_of(document):
        print_line(f"{key + ':':<13}{value}")
    if document["dropped"]:
        print_table(_ledger(document), boxed=False)


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
    from sugiyama_ros.formats.fetch import CATALOGUE
    from sugiyama_ros.formats.fetch import fetch as download

    if name not in CATALOGUE:
        raise InputError(f"{name}: not in the catalogue; it has {', '.join(CATALOGUE)}")
    print_note(CATALOGUE[name].licence)
    if not accept_licence:
        if not sys.stdin.isatty():
            raise InputError(f"{name}: its terms were not accepted; add --accept-licence")
        typer.confirm("Do you accept these terms?", abort=True, err=True)
    with stage("downloading") as advance:
        fetched = download(name, directory, url, advance, overwrite)
    tell(dataclasses.asdict(fetched), f"{fetched.data}\n{fetched.bag}", as_json)


def info(
    files: Annotated[
        list[Path],
        typer.Argument(help="MCAP files, directories of rosbag2, or trajectories in any known format."),
    ],
    ring: Ring = None,
    road_file: _RoadFile = None,
    as_json: Json = False,
) -> None:
    """Show what files contain.

    Of trajectories: vehicles, classes, lanes, time and leaders. Of an MCAP file: topics, as `ros2 bag info` does.
    """
    from sugiyama_ros.formats.choices import Choices

    choices = Choices(ring_m=ring)
    if road_file is not None:
        from sugiyama_ros.formats.roads import read_road

        choices = dataclasses.replace(choices, network=read_road(road_file))
    # a file that is refused is told before anything is printed of the others
    described = [_described(file, choices) for file in files]
    documents = [document for document, _ in described]
    if as_json:
        print_json(documents if len(documents) > 1 else documents[0])
        return
    for number, (_, show) in enumerate(described):
        if number:
            print_line("")
        show()


def _described(file: Path, choices: "Choices") -> tuple[dict[str, Any], Callable[[], None]]:
    """Describe one file as a document, and with what prints it."""
    from sugiyama_ros.formats.measured import FORMAT as BAG
    from sugiyama_ros.formats.sheet import head_of

    if not BAG.recognise(head_of(file), file):
        from sugiyama_ros.formats.registry import format_of, read_tracks

        document = {"format": format_of(file).name, **_document_of(read_tracks(file, choices))}
        return document, partial(_print_tracks, document)
    from sugiyama_ros.formats.mcap_reader import Bag

    for option, given in (("--ring", choices.ring_m), ("--road-file", choices.network)):
        if given is not None:
            raise InputError(f"{option}: a bag says itself which road it is about; leave out {option}")
    with Bag(file) as bag:
        about = bag.info()
    return dataclasses.asdict(about), partial(_print_bag, about)


def _print_bag(about: "BagInfo") -> None:
    """Print what a bag contains."""
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
        # rosbag2 keeps its metadata.yaml, which the other lines say
        short = (f"{key}={value}" for key, value in values.items() if "\n" not in value)
        lines.append(("Metadata", f"{record}: " + ", ".join(short)))
    return lines


def _moment(ns: int) -> str:
    """A stamp [ns]: a time of day; of data that count the seconds from their start, the seconds."""
    day = datetime.fromtimestamp(ns / 1e9, tz=timezone.utc)
    return f"{ns / 1e9:.9f}" + (
        f" ({day:%Y-%m-%d %H:%M:%S} UTC)" if day.year > _EPOCH else " s from the start of the data"
    )


def echo(
    file: Annotated[Path, typer.Argument(help="MCAP file, or directory of rosbag2.")],
    topic: Annotated[str, typer.Argument(help="Topic, such as /vehicle_07/innovation.")],
    as_json: Json = False,
) -> None:
    """Print the messages of one topic."""
    from sugiyama_ros.formats.cdr import plain
    from sugiyama_ros.formats.mcap_reader import Bag

    with Bag(file) as bag:
        messages = bag.messages({topic})
        if as_json:
            before = "["  # nothing is written before the first message is read
            for _, _, log_time_ns, message in messages:
                document = {"log_time_ns": log_time_ns, "message": plain(message)}
                sys.stdout.write(f"{before}\n{to_json(document)}")
                before = ","
            sys.stdout.write("[\n]\n" if before == "[" else "\n]\n")
        else:
            for _, _, log_time_ns, message in messages:
                sys.stdout.write(f"# {log_time_ns}\n{to_json(plain(message), indent=2)}\n---\n")
        for name, why in bag.undecoded.items():
            print_note(f"{name}: bytes in hexadecimal: {why}")


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
        if not file.name:
            raise InputError(f"{file}: not a file; give the file to recover")
        output = name_of_part(file) or file.with_name(f"{file.stem}.recovered.mcap")
    saved = salvage(file, Output(output, overwrite))
    text = (
        f"{saved.messages} messages on {saved.topics} topics saved and read back, {saved.lost_bytes} bytes lost;"
        f" in {saved.path}"
    )
    tell(dataclasses.asdict(saved), text, as_json)


if TYPE_CHECKING:
    from sugiyama_ros.trajectories.labels import Labels
    from sugiyama_ros.trajectories.tracks import Tracks

# Names that are listed; the others are counted.
_LISTED = 12


def _document_of(tracks: "Tracks") -> dict[str, Any]:
    """Describe tracks as a document."""
    import numpy as np

    from sugiyama_ros.trajectories.time_base import is_regular, period_of

    first, last = tracks.time_s[tracks.start[:-1]], tracks.time_s[tracks.start[1:] - 1]
    moves = bool(np.any(np.diff(tracks.start) > 1))
    return {
        "source": tracks.about.source,
        "sha256": tracks.about.sha256,
        "licence": tracks.about.licence or None,
        "rows": len(tracks),
        "recordings": _counted(tracks, tracks.recording),
        "vehicles": tracks.runs,
        "controlled": tracks.controlled_names,
        "classes": _counted(tracks, tracks.vehicle_class),
        "roads": _counted(tracks, tracks.road),
        "lanes": _counted(tracks, tracks.lane),
        "from_s": float(first.min()),
        "to_s": float(last.max()),
        "driven_s": float(np.sum(last - first)),
        "period_s": period_of(tracks) if moves else None,
        "regular": is_regular(tracks) if moves else None,
        "from_m": float(tracks.s_m.min()),
        "to_m": float(tracks.s_m.max()),
        "ring_m": tracks.about.ring_m or None,
        "leaders": {
            "in_the_table": float(np.mean(tracks.leader_row >= 0)),
            "free_road": float(np.mean(tracks.leader_row == -1)),
            "unknown": float(np.mean(tracks.leader_row == -2)),
        },
        "lines": None if tracks.line_m is None else float(np.mean(np.isfinite(tracks.line_m))),
        "columns": list(tracks.columns),
        "smoothing": tracks.about.smoothing or None,
        "dropped": dict(tracks.about.dropped),
        "notes": list(tracks.about.notes),
    }


def _counted(tracks: "Tracks", column: "Labels | None") -> dict[str, int]:
    """Number of vehicles for each text of a column, by the text; empty for a column that is not there."""
    import numpy as np

    if column is None:
        return {}
    pair = np.unique(np.stack([column.code.astype(np.int64), tracks.run]), axis=1)
    code, vehicles = np.unique(pair[0], return_counts=True)
    return {
        column.text[one] if one >= 0 else "(none)": count
        for one, count in zip(code.tolist(), vehicles.tolist(), strict=True)
    }


def _lines_of(document: dict[str, Any]) -> list[tuple[str, str]]:
    """The document as names and values."""
    leaders = document["leaders"]
    known = ", ".join(f"{leaders[name]:.1%} {name.replace('_', ' ')}" for name in leaders)
    irregular = "" if document["regular"] in (True, None) else ", irregular"
    lines = [
        ("Format", document.get("format", "")),
        ("Source", document["source"] or "not known"),
        ("Licence", document["licence"] or ""),
        ("Rows", f"{document['rows']} ({', '.join(document['columns'])})"),
        ("Recordings", _list(document["recordings"])),
        ("Vehicles", str(document["vehicles"])),
        ("Controlled", ", ".join(document["controlled"])),
        ("Classes", _list(document["classes"])),
        ("Roads", _list(document["roads"])),
        ("Lanes", _list(document["lanes"])),
        ("Time", f"{document['from_s']:.9g} to {document['to_s']:.9g} s"),
        ("Driven", f"{document['driven_s']:.0f} s by all vehicles together"),
        (
            "Period",
            f"{document['period_s']:.4g} s{irregular}" if document["period_s"] else "one sample of each vehicle",
        ),
        ("Positions", f"{document['from_m']:.6g} to {document['to_m']:.6g} m, of the vehicles' centres"),
        ("Ring", f"{document['ring_m']:g} m" if document["ring_m"] else ""),
        ("Leaders", known),
        ("Lines", "" if document["lines"] is None else f"a driver comes to one in {document['lines']:.1%} of the rows"),
        ("Smoothing", document["smoothing"] or ""),
        *(("Note", note) for note in document["notes"]),
    ]
    return [(name, value) for name, value in lines if value]


def _list(counted: dict[str, int]) -> str:
    """Names with their numbers of vehicles."""
    if not counted:
        return ""
    shown = [f"{name} ({count})" for name, count in list(counted.items())[:_LISTED]]
    more = f", and {len(counted) - _LISTED} more" * (len(counted) > _LISTED)
    return f"{len(counted)}: {', '.join(shown)}{more}"


def _ledger(document: dict[str, Any]) -> TextTable:
    """The rows that were left out, and why."""
    rows = tuple((reason, str(count)) for reason, count in document["dropped"].items())
    return TextTable("", ("left out", "rows"), rows, left=1)

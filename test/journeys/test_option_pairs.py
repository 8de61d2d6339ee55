"""All pairs of valid options, or all options of what takes long: each command ends well.

Options that contradict each other are refused in one line.

The options come from the declarations of the commands. A new switch or number is tried as it is; a new option that
takes a text needs a value in ``VALUES``. A covering array has each pair of values at least once, but for those in
``CONTRADICTIONS``, which say what is refused.
"""

import json
import shutil
import socket
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
from allpairspy import AllPairs
from typer.main import get_command

from journeys import recordings
from journeys.forks import Forks
from journeys.terminal import COMMANDS, Said
from sugiyama_ros.cli.app import app

pytestmark = [pytest.mark.system, pytest.mark.timeout(1800)]
#: Values of arguments and options, by "command option" or, for all commands, "option". Words of a value are separated
#: by blanks. An option that may be left out is left out, too. In a case's folder are copies of all inputs.
VALUES: Mapping[str, Sequence[str]] = {
    "SOURCE": ("ring.mcap", "ring.csv", "tracks.parquet"),
    "SOURCES": ("ring.mcap", "ring.csv", "tracks.parquet", "ring.mcap second.mcap"),
    "--ring": ("40",),
    "--model": ("model.yaml",),
    "--set": ("v_star=9", "v_star=9 --set kappa_v=0.25"),
    "--effect": ("drag:c0=0.1",),
    "--effects": ("drag",),
    "--scheduler": ("SCHEDULER",),
    "--rate": ("max", "20"),
    "--spread": ("0.1",),
    "--start": ("jam", "equal"),
    "--output": ("new.mcap", "old.mcap"),
    "demo --data": ("ring.mcap", "ring.csv"),
    "demo --hidden": ("drag",),
    "run --engine": ("compiled", "filterpy"),
    "run --duration": ("20",),
    "run --vehicles": ("3",),
    "run --save-state": ("new_state", "state"),
    "run --resume": ("state",),
    "simulate --output": ("new.csv", "new.mcap", "new.parquet", "old.mcap"),
    "simulate --duration": ("10",),
    "simulate --vehicles": ("3",),
    "simulate --ring": ("40", "0"),
    "simulate --lanes": ("2",),
    "simulate --scene": ("roundabout",),
    "demo --scene": ("roundabout",),
    "simulate --view": ("0,100",),
    "simulate --period": ("0.1",),
    "simulate --controlled": ("0", "0,2"),
    "simulate --controller": ("constant_speed:target=7", "pi_saturation"),
    "calibrate --formulation": ("causal", "paper"),
    "calibrate --parameters": ("v_star,kappa_v",),
    "calibrate --output": ("new.yaml", "old.yaml"),
    "calibrate --classes": ("2",),
    "calibrate --goal": ("exit:place=20,speed=2",),
    "diagnose --add": ("auto", "drag"),
    "diagnose --output": ("new.yaml", "old.yaml"),
    "diagnose --save": ("new.json", "old.json"),
    "--law": ("idm",),
    "simulate --law": ("gipps",),
    "study NAME": ("", "highway", "spectrum", "measured", "simulated", "order"),
    "study SOURCE": ("ring.mcap", "ring.csv"),
    "study --runs": ("1",),
    "study --output": ("new.png", "old.pdf"),
    "effects NAME": ("", "drag"),
    "laws NAME": ("", "idm"),
    "controllers NAME": ("", "follower_stopper"),
    "report SOURCE": ("run.mcap",),
    "report --output": ("new.html", "old.html"),
    "--diagnosis": ("diagnosis.json",),
    "live --host": ("127.0.0.1", "localhost"),
    "live --port": ("PORT",),
    "convert SOURCE": ("rich.csv", "ring.csv", "ring.mcap", "own.csv", "plane.csv", "bag"),
    "convert OUTPUT": ("new.parquet", "new.csv", "new.mcap", "old.mcap"),
    "convert --format": ("auto", "tracks"),
    "convert --columns": ("map.yaml",),
    "convert --reference": ("centre", "front"),
    "convert --recording": ("1",),
    "convert --road-file": ("road.csv",),
    "convert --road": ("1",),
    "convert --lane": ("1",),
    "convert --class": ("car",),
    "convert --without": ("1",),
    "convert --from": ("5",),
    "convert --to": ("15",),
    "convert --period": ("0.5",),
    "convert --odometry": ("/car*/odom",),
    "convert --centerline": ("line.csv",),
    "convert --bridge": ("bridge.yaml",),
    "convert --frame": ("map",),
    "fetch NAME": ("sugiyama2008",),
    "fetch --directory": (".", "state"),
    "fetch --url": ("URL",),
    "FILE": ("run.mcap", "ring.mcap"),
    "info FILES": ("run.mcap", "ring.csv", "tracks.parquet", "ring.csv tracks.parquet", "plane.csv"),
    "info --road-file": ("road.csv",),
    "echo TOPIC": ("/measured", "/road"),
    "recover FILE": ("cut.mcap", "run.mcap"),
}
MAP = "vehicle: track\ntime_s: {column: frame, factor: 0.04}\ns_m: {column: x_ft, factor: 0.3048}\nlane: lane_number\n"
BRIDGE = "type: nav_msgs/msg/Odometry\nx: pose.pose.position.x\ny: pose.pose.position.y\n"
#: Options that are never left out: without them, a demo (test/system/test_demo.py) and a study take long.
GIVEN = {"demo --data", "study --runs"}
#: Commands whose cases take seconds each: each value is tried once, instead of each pair of values.
LONG = {"demo", "run", "calibrate", "diagnose", "study", "compare", "report", "live"}
#: Every case is refused: nothing is downloaded in tests.
REFUSED = {"fetch"}
_CAUSAL = ("no --formulation", "--formulation causal")
#: What is refused, by command: values that contradict each other. An option stands for each of its values, and "no
#: --option" for its absence.
CONTRADICTIONS: Mapping[str, Sequence[Sequence[str]]] = {
    "info": [
        ("run.mcap", "--ring"),
        ("plane.csv", "no --road-file"),
        ("--road-file", "--ring"),
        *((file, "--ring") for file in ("tracks.parquet", "ring.csv tracks.parquet")),
        *((file, "--road-file") for file in VALUES["info FILES"] if file != "plane.csv"),
    ],
    "demo": [
        ("--output old.mcap", "no --overwrite"),
        ("--data ring.csv", "no --ring"),
        ("--data", "--scene"),
        ("--data", "--hidden"),
        ("--hidden drag", "--scene"),
    ],
    "run": [
        ("--output old.mcap", "no --overwrite"),
        ("ring.csv", "no --ring"),
        ("tracks.parquet", "--ring"),
        ("--law", "--engine filterpy"),
        ("--law", "--model"),
        ("--save-state state", "no --overwrite"),
        ("no SOURCE", "no --simulate"),
        *((source, "--simulate") for source in VALUES["SOURCES"][:3]),
        *(("no --simulate", name) for name in ("--vehicles", "--duration", "--spread", "--seed", "--set", "--effect")),
        ("no SOURCE", "--ring", "--simulate", "no --vehicles"),
    ],
    "simulate": [
        ("--law", "--model"),
        ("--output old.mcap", "no --overwrite"),
        ("--output old.mcap", "--lanes"),
        ("--output new.mcap", "--lanes"),
        ("--output old.mcap", "--scene"),
        ("--output new.mcap", "--scene"),
        *(("--scene", name) for name in ("--lanes", "--ring 40", "--controlled", "--start equal", "--view")),
        ("--output new.parquet", "no --lanes", "no --scene"),
        ("--view", "no --lanes"),
        ("--ring 40", "--lanes"),
        ("--ring 40", "no --vehicles"),
        ("--start equal", "--lanes"),
        ("--start equal", "--ring 0"),
        ("--controlled", "no --controller"),
        ("--controller", "no --controlled"),
        ("--controlled", "--lanes"),
        *(("--law", name) for name in ("--spread", "--set")),
    ],
    "calibrate": [
        ("--output old.yaml", "no --overwrite"),
        ("ring.csv", "no --ring", "--formulation paper"),
        ("tracks.parquet", "--ring"),
        ("--seed", "no --classes", "no --goal"),
        *(("--formulation paper", name) for name in ("--effects", "--classes", "--goal")),
        *(("--law", name) for name in ("--formulation paper", "--parameters", "--profile", "--classes", "--goal")),
        *(("--effects", name) for name in ("--profile", "--classes", "--goal")),
        *((name, other) for name in ("--classes", "--goal") for other in ("--regularise", "--profile")),
        *(("--regularise", "--profile", how) for how in _CAUSAL),
        *((several, "--formulation paper") for several in ("tracks.parquet", "ring.mcap second.mcap")),
    ],
    "diagnose": [
        ("--output old.yaml", "no --overwrite"),
        ("--save old.json", "no --overwrite"),
        ("ring.csv", "no --ring"),
        ("tracks.parquet", "--ring"),
    ],
    "study": [
        ("--output old.pdf", "no --overwrite"),
        ("ring.csv", "no --ring"),
        *(("no NAME", source) for source in VALUES["study SOURCE"]),
        *(("no NAME", "no SOURCE", name) for name in ("--runs", "--seed", "--ring", "--output")),
        *((name, "--runs") for name in ("spectrum", "measured")),
        ("measured", "--seed"),
        ("no SOURCE", "--ring"),
        *((name, "no SOURCE") for name in ("measured", "simulated", "order")),
    ],
    "compare": [("ring.csv", "no --ring"), ("tracks.parquet", "--ring")],
    "report": [("--output old.html", "no --overwrite")],
    "live": [
        ("--output old.mcap", "no --overwrite"),
        ("ring.csv", "no --ring"),
        ("tracks.parquet", "--ring"),
        ("--law", "--model"),
    ],
    "recover": [("--output old.mcap", "no --overwrite")],
    "convert": [
        ("old.mcap", "no --overwrite"),
        ("--odometry", "no --centerline"),
        ("--centerline", "no --odometry"),
        ("bag", "no --odometry"),
        *((source, "--odometry") for source in VALUES["convert SOURCE"] if source != "bag"),
        *((output, "--odometry") for output in ("new.mcap", "old.mcap")),
        *((source, output) for source in ("rich.csv", "own.csv", "plane.csv") for output in ("new.mcap", "old.mcap")),
        *(("ring.csv", "no --ring", output) for output in ("new.mcap", "old.mcap")),
        *((s, output, "--without") for s in ("ring.csv", "ring.mcap") for output in ("new.mcap", "old.mcap")),
        ("own.csv", "--ring"),
        ("own.csv", "no --columns"),
        *((source, "--columns") for source in ("rich.csv", "ring.csv", "ring.mcap", "plane.csv")),
        ("plane.csv", "no --road-file"),
        ("--road-file", "--ring"),
        *((source, "--road-file") for source in ("rich.csv", "ring.csv", "ring.mcap", "own.csv")),
        *((source, "--format tracks") for source in VALUES["convert SOURCE"] if source != "bag"),
        *((s, "no --odometry", name) for s in ("ring.csv", "ring.mcap", "own.csv") for name in ("--road", "--class")),
        *((source, "no --odometry", "--lane") for source in ("ring.csv", "ring.mcap")),
        *(("no --odometry", name) for name in ("--bridge", "--frame")),
        *(("--odometry", name) for name in ("--ring", "--format tracks", "--columns", "--reference", "--road-file")),
        # the bag has neither classes nor roads, its lane is 0, and its times are of the day
        *(("--odometry", name) for name in ("--class", "--road", "--lane", "--from", "--to")),
        ("ring.mcap", "--reference"),
    ],
}


@dataclass(frozen=True)
class Inputs:
    """What the cases work on."""

    folder: Path
    forks: Forks
    places: Mapping[str, str]


class _Junk(BaseHTTPRequestHandler):
    """Answers every request with something that is no data set."""

    def do_GET(self) -> None:
        self.send_response(200)
        self.end_headers()
        self.wfile.write(b"no data")

    def log_message(self, *arguments: object) -> None:
        pass


@pytest.fixture(scope="module")
def scheduler() -> Iterator[str]:
    """Address of a Dask cluster with one worker; an address where nobody listens if Dask is not installed."""
    try:
        from distributed import LocalCluster
    except ImportError:
        yield "tcp://127.0.0.1:9"
        return
    with LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", dashboard_address=":0"
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def url() -> Iterator[str]:
    server = HTTPServer(("127.0.0.1", 0), _Junk)
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}/data"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory, forks: Forks, scheduler: str, url: str) -> Inputs:
    """One file of each kind, written by the commands themselves where they can."""
    folder = tmp_path_factory.mktemp("pairs") / "inputs"
    folder.mkdir()
    recordings.ring_csv(folder / "ring.csv", vehicles=3, ring_m=40.0, duration_s=40.0)
    recordings.own_columns(folder / "own.csv")
    recordings.all_columns(folder / "rich.csv")
    recordings.odometry_bag(folder / "bag", duration_s=20.0)
    recordings.centre_line(folder / "line.csv")
    recordings.in_plane(folder / "plane.csv", folder / "road.csv")
    (folder / "map.yaml").write_text(MAP)
    (folder / "bridge.yaml").write_text(BRIDGE)
    small = ["--vehicles", "3", "--duration", "40"]
    for command in (
        ["convert", "ring.csv", "ring.mcap", "--ring", "40"],
        ["simulate", *small, "--ring", "40", "--seed", "2", "-o", "second.mcap"],
        ["simulate", *small, "--lanes", "2", "-o", "tracks.parquet"],
        ["run", "ring.mcap", "-o", "run.mcap", "--critic", "--save-state", "state"],
        ["calibrate", "ring.mcap", "-o", "model.yaml"],
    ):
        said = forks.run(folder, command)
        assert said.code == 0, said.err
    said = forks.run(folder, ["diagnose", "ring.mcap", "--json"])
    (folder / "diagnosis.json").write_text(said.out)
    (folder / "cut.mcap").write_bytes((folder / "run.mcap").read_bytes()[:100_000])
    for name in ("old.mcap", "old.yaml", "old.pdf", "old.html", "old.json"):
        (folder / name).write_text("old")
    return Inputs(folder, forks, {"SCHEDULER": scheduler, "URL": url})


def name_of(parameter: Any) -> str:
    """Name of an option, or of an argument in capitals."""
    return parameter.opts[0] if parameter.param_type_name == "option" else parameter.name.upper()


def choices(command: str, parameter: Any) -> list[str]:
    """Values of an argument or an option, as they stand on the command line; the usual one is first."""
    name = name_of(parameter)
    if getattr(parameter, "is_flag", False):
        return ["", name]
    values = VALUES.get(f"{command} {name}", VALUES.get(name))
    if values is None:
        assert parameter.type_descriptor.annotation in (int, float), (
            f"{command} {name}: add small values of this option to VALUES"
        )
        values = [str(max(parameter.min or 0, min(parameter.max or 1, 1)))]
    said = [f"{name} {value}" if name.startswith("-") and value else value for value in values]
    is_given = parameter.required or "" in said or f"{command} {name}" in GIVEN
    return said if is_given else ["", *said]


def run(inputs: Inputs, folder: Path, command: str, words: Sequence[str]) -> Said:
    """Run a case in a folder with copies of the inputs."""
    shutil.copytree(inputs.folder, folder, copy_function=lambda *pair: Path(pair[1]).symlink_to(pair[0]))
    for path in [*inputs.folder.glob("old.*"), *inputs.folder.glob("state/*")]:
        copy = folder / path.relative_to(inputs.folder)
        copy.unlink()
        shutil.copy(path, copy)
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    places = {**inputs.places, "PORT": port}
    arguments = [places.get(word, word) for text in words for word in text.split()]
    if command == "live" and "PORT" not in " ".join(words):
        arguments += ["--port", port]  # the usual port may be taken
    said = inputs.forks.run(folder, [command, *arguments], "live page:" if command == "live" else "")
    shutil.rmtree(folder)
    return said


def fault(said: Said, words: Sequence[str]) -> str:
    """What is wrong with how a case ended, or nothing."""
    if "Traceback" in said.err or "Warning: " in said.err:
        return "a traceback or a warning"
    if said.code == 0:
        try:
            if "--json" in words:
                json.loads(said.out)
        except ValueError:
            return "no JSON"
        return ""
    lines = said.err.splitlines() or [""]
    if said.code != 2 or not lines[-1].startswith("error: ") or said.err.count("error: ") > 1:
        return f"exit code {said.code}, without one line that says why"
    return "an output before it is refused" if said.out else ""


def holds(condition: str, names: Sequence[str], case: Sequence[str]) -> bool:
    """Whether a condition of a contradiction holds in a case, or in the values that were chosen so far."""
    if condition.startswith("no "):
        return condition[3:] in names[: len(case)] and not case[names.index(condition[3:])]
    return any(value == condition or value.startswith(condition + " ") for value in case)


@pytest.mark.parametrize("command", COMMANDS)
def test_all_pairs_of_options(command: str, inputs: Inputs, tmp_path: Path) -> None:
    declared = [p for p in get_command(app).commands[command].params if p.name != "help"]  # type: ignore[attr-defined]
    names = [name_of(parameter) for parameter in declared]
    values = [choices(command, parameter) for parameter in declared]
    contradictions = CONTRADICTIONS.get(command, ())

    def is_allowed(case: Sequence[str]) -> bool:
        return not any(all(holds(one, names, case) for one in conditions) for conditions in contradictions)

    together = 1 if command in LONG else 2
    cases = AllPairs(values, filter_func=is_allowed, n=together) if len(values) > 1 else [(v,) for v in values[0]]
    wrong = []
    for case in map(tuple, cases):
        said = run(inputs, tmp_path / "case", command, case)
        why = fault(said, case) or ("" if said.code == 0 or command in REFUSED else "refused")
        if why:
            wrong.append(f"sugiyama {command} {' '.join(filter(None, case))}\n{why}\n{said.out[-300:]}{said.err}")
    assert not wrong, "\n\n".join(wrong)


@pytest.mark.parametrize(
    ("command", "conditions"), [(name, one) for name, several in CONTRADICTIONS.items() for one in several], ids=str
)
def test_options_that_contradict_each_other(
    command: str, conditions: Sequence[str], inputs: Inputs, tmp_path: Path
) -> None:
    declared = [p for p in get_command(app).commands[command].params if p.name != "help"]  # type: ignore[attr-defined]
    names = [name_of(parameter) for parameter in declared]
    case = []
    for name, parameter in zip(names, declared, strict=True):
        given = [v for v in choices(command, parameter) for one in conditions if holds(one, [name], [v]) and v]
        left_out = f"no {name}" in conditions
        usual = [value for value in choices(command, parameter) if value or name.startswith("-")]
        case.append("" if left_out else (given or usual)[0])
    said = run(inputs, tmp_path / "case", command, case)
    assert (said.code, fault(said, case)) == (2, ""), f"{case}\n{said.out}{said.err}"
    told = [word.lstrip("-") for one in conditions for word in one.split() if word != "no"]
    told = ["FILE" if word == "SOURCE" else word for word in told]
    assert any(word in said.err for word in told), f"{case}\n{said.err}"

"""A package has what the pages in docs/howto show: an effect, a law, two formats and a study.

Every command knows them.

Another package has an effect of each stage, and one that cannot be loaded. The commands compile their own code, because
a driver's row is longer with more effects. That takes most of the time. So two processes share it: one compiles what
simulates and fits, the other compiles the estimators. Both compile with fewer optimisations (NUMBA_OPT), which takes
three quarters of the time.
"""

import json
import os
import shlex
import subprocess
import sys
import sysconfig
from collections.abc import Callable
from pathlib import Path

import pytest

from journeys.blocks import ROOT, blocks

# Most of this time is for compiling on a busy machine.
pytestmark = [pytest.mark.system, pytest.mark.timeout(1800)]
PAGES = [ROOT / "docs" / "howto" / f"{name}.md" for name in ("effect", "law", "format", "study")]
#: An effect of each stage, beside the one of the page.
MODULE = """
from numba import njit

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ACTUATION, MEASUREMENT, PERCEPTION, PREFERENCE, UTILITY, Effect, Memory, at


@njit
def nearsighted(seen, p):
    return seen.gap * (1.0 - p[0]), seen.speed, seen.leader_speed


@njit
def hurried(v_star, kappa_v, seen, p):
    return v_star * (1.0 + p[0]), kappa_v


@njit
def gentle(seen, action, period, horizon, p):
    return -p[0] * action * action / 16.0


@njit
def weak(acceleration, seen, p):
    return acceleration * (1.0 - p[0])


@njit
def half(wanted, period, p):
    return wanted * (1.0 - p[0])


@njit
def half_expected(wanted, variance, period, p):
    return wanted * (1.0 - p[0]), 1.0 - p[0], 0.0


@njit
def displaced(position, circumference, p):
    return p[0], 0.0


def effect(name, stage, function=None, **hooks):
    parameter = Parameter("k", "k", "1", 0.0, 0.0, 5.0, "how strong it is")
    return Effect(
        name=name, stage=stage, title=name, summary="made up", source="a test", parameters=(parameter,),
        starts=at({"k": 0.02}), function=function, **hooks,
    )


NEARSIGHTED = effect("nearsighted", PERCEPTION, nearsighted)
HURRIED = effect("hurried", PREFERENCE, hurried)
GENTLE = effect("gentle", UTILITY, gentle)
WEAK = effect("weak", ACTUATION, weak)
HALF = effect("half", ACTUATION, memory=Memory(half, half_expected))
DISPLACED = effect("displaced", MEASUREMENT, displacement=displaced)
"""
ENTRIES = """
[sugiyama_ros.effects]
nearsighted = mine:NEARSIGHTED
hurried = mine:HURRIED
gentle = mine:GENTLE
weak = mine:WEAK
half = mine:HALF
displaced = mine:DISPLACED
broken = mine:MISSING
"""
STAGES = ("nearsighted", "hurried", "gentle", "weak", "half", "displaced", "syrup")
#: Program that runs commands in turn: it reads lists of arguments from standard input, and prints codes and outputs.
COMMANDS = """
import json, os, sys, tempfile
from sugiyama_ros.cli import main
commands, streams = json.load(sys.stdin), (sys.stdout, sys.stderr)
answers = os.fdopen(os.dup(1), "w")
for arguments in commands:
    sys.argv, code = ["sugiyama", *arguments], 0
    files = [tempfile.TemporaryFile() for _ in streams]
    for number, file in enumerate(files, 1):
        os.dup2(file.fileno(), number)
    try:
        main()
    except SystemExit as end:
        code = end.code or 0
    for stream in streams:
        stream.flush()
    said = []
    for file in files:
        file.seek(0)
        said.append(file.read().decode())
    print(json.dumps([code, *said]), file=answers, flush=True)
"""


def write_package(folder: Path) -> list[str]:
    """Write the files that the pages show, and install them as the pages say; returns the commands of the pages."""
    project: dict[str, list[str]] = {}
    commands = []
    for block in (block for page in PAGES for block in blocks(page)):
        if block.words == "pyproject.toml":  # the pages share one project
            section = ""
            for line in filter(None, block.text.splitlines()):
                section = line if line.startswith("[") else section
                lines = project.setdefault(section, [section])
                lines += [line] * (line not in lines)
        elif block.mark == "file":
            path = folder / block.words
            path.parent.mkdir(exist_ok=True)
            path.write_text(block.text)
        elif block.is_run:
            commands += block.text.splitlines()
    (folder / "pyproject.toml").write_text("\n".join(line for lines in project.values() for line in lines) + "\n")
    (install,) = {line for line in commands if not line.startswith("sugiyama ")}
    assert install == "pip install -e ."
    subprocess.run(
        [sys.executable, "-m", *install.split()], cwd=folder, env=environment(folder), check=True, capture_output=True
    )
    return [line for line in commands if line != install]


def environment(folder: Path) -> dict[str, str]:
    """Variables with which pip installs into the folder and asks no other machine, and Python finds what is there."""
    where = sysconfig.get_path("purelib", vars={"base": str(folder / "installed")})
    path = os.pathsep.join([where, str(folder), *filter(None, [os.environ.get("PYTHONPATH")])])
    pip = {"PIP_PREFIX": str(folder / "installed"), "PIP_NO_INDEX": "1", "PIP_NO_BUILD_ISOLATION": "0"}
    return os.environ | pip | {"PYTHONPATH": path, "NUMBA_CACHE_DIR": str(folder / "compiled"), "NUMBA_OPT": "1"}


def start(folder: Path, commands: dict[str, list[str]]) -> Callable[[], dict[str, list[object]]]:
    """Start a process that runs commands in turn; returns a function that waits for their answers."""
    process = subprocess.Popen(
        [sys.executable, "-c", COMMANDS],
        cwd=folder,
        env=environment(folder),
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdin is not None
    process.stdin.write(json.dumps(list(commands.values())))
    process.stdin.close()
    process.stdin = None

    def answers() -> dict[str, list[object]]:
        out, err = process.communicate()
        said = [json.loads(line) for line in out.splitlines()]
        assert len(said) == len(commands), err
        return dict(zip(commands, said, strict=True))

    return answers


@pytest.fixture(scope="module")
def answers(tmp_path_factory):
    """Exit code and output of each command, by a short name."""
    folder: Path = tmp_path_factory.mktemp("extensions")
    about = folder / "mine-1.0.dist-info"
    about.mkdir()
    (folder / "mine.py").write_text(MODULE)
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(ENTRIES)
    of_pages = write_package(folder)
    for name in ("small.grid", "my.grid"):
        (folder / name).write_text("grid\n" + "\n".join(f"{3.0 * k} {3.0 * k + 20.0}" for k in range(60)))
    ring = ["--ring", "45", "--json"]
    base = ["--vehicles", "4", "--ring", "45", "--duration", "40", "--seed", "1", "--json"]
    effects = [argument for name in STAGES for argument in ("--effect", f"{name}:k=0.05")]
    estimators = start(folder, {"run grid": ["run", "small.grid", "-o", "grid.mcap", "--json"]})
    fits = {
        **{
            f"simulate {name}": ["simulate", "-o", f"{name}_1.csv", *base, "--effect", f"{name}:k=0.3"]
            for name in STAGES
        },
        "simulate": ["simulate", "-o", "base.csv", *base],
        "simulate all": ["simulate", "-o", "all.csv", *base, *effects],
        "broken": ["simulate", "-o", "broken.csv", *base, "--effect", "broken:k=1"],
        "calibrate": ["calibrate", "syrup_1.csv", *ring, "--effects", "syrup,gentle"],
        "compare": ["compare", "syrup_1.csv", *ring, "--effects", "syrup"],
        "diagnose": ["diagnose", "syrup_1.csv", *ring, "--add", "auto", "-o", "model.yaml"],
        "convert": ["convert", "small.grid", "small.mcap", "--json"],
        "calibrate grid": ["calibrate", "small.grid", "--formulation", "paper", "--json"],
        "studies": ["study"],
        **{line: shlex.split(line)[1:] for line in of_pages},
    }
    found = start(folder, fits)() | estimators()
    followed = {
        "run": ["run", "syrup_1.csv", *ring, "-o", "run.mcap", "--model", "model.yaml"],
        "report": ["report", "run.mcap", "--json"],
    }
    return found | start(folder, followed)()


def document(answer):
    code, out, err = answer
    assert code == 0, err
    return json.loads(out)


@pytest.mark.parametrize("name", STAGES)
def test_an_effect_of_each_stage_is_simulated(answers, name):
    base, with_it = document(answers["simulate"]), document(answers[f"simulate {name}"])
    if name == "displaced":  # this effect acts on the measurement, not on the drivers
        assert with_it["second_half"] == base["second_half"]
    else:
        assert with_it["second_half"] != base["second_half"]
    document(answers["simulate all"])


def test_a_broken_extension_is_named_where_it_is_asked_for(answers):
    code, _, err = answers["broken"]
    assert code == 2
    assert "effect broken: mine:MISSING cannot be loaded" in err


def test_effects_of_others_are_fitted_and_diagnosed(answers):
    assert set(document(answers["calibrate"])["effects"]) == {"syrup", "gentle"}
    assert "base + syrup" in {m["name"] for m in document(answers["compare"])["models"]}
    diagnosed = document(answers["diagnose"])
    # a displacement of all cars alike changes no gap, so there is nothing to search for
    searched = set(STAGES) - {"displaced"}
    assert searched <= set(diagnosed["verdict"]["searched"])
    # some are listed with what a prescreen promises, which is too little for a fit
    assert searched <= {c["name"] for c in diagnosed["candidates"]}


def test_a_law_of_another_package_is_a_rival(answers):
    assert {"follow", "follow_least_squares"} <= {m["name"] for m in document(answers["compare"])["models"]}
    assert "follow" in document(answers["diagnose"])["errors"]


def test_estimators_run_with_them(answers):
    assert document(answers["run"])["messages_lost"] == 0
    assert document(answers["run grid"])["messages_lost"] == 0
    document(answers["report"])


def test_a_format_of_another_package_is_read(answers):
    assert document(answers["convert"])["vehicles"] == 2
    assert len(document(answers["calibrate grid"])["drivers"]) == 2


def test_the_commands_of_the_pages_work(answers):
    said = {words: answer for words, answer in answers.items() if words.startswith("sugiyama ")}
    assert {words.split()[1] for words in said} == {"simulate", "diagnose", "compare", "convert", "study"}
    for words, (code, _, err) in said.items():
        assert code == 0, f"{words}: {err}"
    out = {words.split()[1]: answer[1] for words, answer in said.items()}
    assert "syrup" in out["diagnose"]
    assert "Follower, fitted to gaps" in out["compare"]
    assert "What does one slow driver do to a ring?" in " ".join(out["study"].split())
    assert "slow_drivers" in answers["studies"][1]

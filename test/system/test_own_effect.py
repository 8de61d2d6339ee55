"""An effect of one's own is tried in seconds: it alone is compiled, and nothing is compiled when it goes."""

import json
import os
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

pytestmark = pytest.mark.system
MODULE = """
from numba import njit

from sugiyama_ros.driver.parameters import Parameter
from sugiyama_ros.effects.effect import ENVIRONMENT, UTILITY, Effect, at

FACTOR = 1.0

@njit
def weaker(x):
    return FACTOR * x

@njit
def push(seen, p):
    return -weaker(p[0] * seen.speed)

@njit
def component(seen, action, period, horizon, p):
    return -p[0] * action * action / 16.0

def effect(name, stage, function):
    parameter = Parameter("k", "k", "1/s", 0.0, 0.0, 5.0, "how strong it is")
    return Effect(name=name, stage=stage, title=name, summary="made up", source="a test", parameters=(parameter,),
                  starts=at({"k": 0.01}), function=function)

SYRUP = effect("syrup", ENVIRONMENT, push)
GENTLE = effect("gentle", UTILITY, component)
"""
ENTRIES = "[sugiyama_ros.effects]\nsyrup = mine:SYRUP\ngentle = mine:GENTLE\n"
#: What is compiled for a simulation with effects and for a filter with them, when what both need is there already.
TRY = """
import json, sys
from sugiyama_ros import progress
names, told = json.loads(sys.argv[1]), set()
progress.on_compiling = lambda what, done, total: told.add(what)
from sugiyama_ros.effects.registry import EFFECTS, ROW, switch_on
import sugiyama_ros.effects.control
early = set(told)
from sugiyama_ros.api import simulate
from sugiyama_ros.driver.parameters import defaults
from sugiyama_ros.filters.causal import log_likelihood
from sugiyama_ros.filters.extract import chain_behind

def try_with(effects):
    recording = simulate(3, ring_m=35.0, duration_s=20.0, effects=effects, seed=1).dense
    row = ROW.with_effects(defaults())
    for name, values in effects.items():
        row = switch_on(row, name, values)
    return recording.position_m[-1, 0], log_likelihood(chain_behind(recording, 0), row)
try_with({})
before = set(told)
told.clear()
found = try_with({name: {"k": 0.05} for name in names})
print(json.dumps([found, sorted(early | told), len(EFFECTS), sorted(before)]))
"""


@pytest.fixture
def installed(tmp_path):
    """A folder in which the package is installed, and a function that tries its effects in a process of its own."""
    about = tmp_path / "mine-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text(ENTRIES)
    (tmp_path / "mine.py").write_text(MODULE)

    def attempt(*names: str, environment=None):
        environment = os.environ | (environment or {"PYTHONPATH": str(tmp_path)})
        command = [sys.executable, "-c", TRY, json.dumps(names)]
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout)

    return tmp_path, attempt


def test_only_the_effect_is_compiled_when_it_comes_changes_and_goes(installed):
    folder, attempt = installed
    file: Path = folder / "mine.py"
    first, compiled, with_two, _ = attempt("syrup", "gentle")
    assert compiled == ["component.all_actions", "push"]
    again, compiled, *_ = attempt("syrup", "gentle")
    assert (again, compiled) == (first, [])
    # a comment is no change
    file.write_text(MODULE.replace("FACTOR = 1.0", "FACTOR = 1.0  # how much of it is left"))
    assert attempt("syrup", "gentle")[:2] == [first, []]
    # neither the function of the effect nor its file's other functions, but a constant of what it calls
    file.write_text(MODULE.replace("FACTOR = 1.0", "FACTOR = 0.5"))
    changed, compiled, *_ = attempt("syrup", "gentle")
    assert compiled == ["push"]
    assert changed != first
    (folder / "mine-1.0.dist-info/entry_points.txt").unlink()
    _, compiled, without, _ = attempt()
    assert compiled == []
    assert without == with_two - 2


def test_two_environments_over_one_installation_compile_nothing_for_each_other(installed, tmp_path_factory):
    _, with_effects = installed
    elsewhere = str(tmp_path_factory.mktemp("without"))

    def without_effects():
        return with_effects(environment={"PYTHONPATH": elsewhere})

    first, base = with_effects("syrup", "gentle"), without_effects()
    for _ in range(2):  # one after the other, and at the same time
        with ThreadPoolExecutor(2) as both:
            mine, plain = both.submit(with_effects, "syrup", "gentle"), both.submit(without_effects)
        assert mine.result() == [first[0], [], first[2], []]
        assert plain.result() == [base[0], [], first[2] - 2, []]


def test_a_function_that_cannot_be_compiled_is_named_with_its_package(installed):
    folder, _ = installed
    (folder / "mine.py").write_text(MODULE.replace("-weaker(p[0] * seen.speed)", "-p[0] * seen.velocity"))
    command = [sys.executable, "-m", "sugiyama_ros.cli", "simulate", "--duration", "20", "-o", str(folder / "a.csv")]
    environment = os.environ | {"PYTHONPATH": str(folder)}
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "error: effect syrup: mine.push cannot be compiled" in done.stderr
    assert "velocity" in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1


def test_an_effect_that_divides_by_zero_ends_the_command_with_one_line(tmp_path):
    about = tmp_path / "mine-1.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: mine\nVersion: 1\n")
    (about / "entry_points.txt").write_text("[sugiyama_ros.effects]\nsyrup = mine:SYRUP\n")
    own = MODULE.replace("return -weaker(p[0] * seen.speed)", "return -p[0] * 1.0 / seen.speed")
    (tmp_path / "mine.py").write_text(own)
    arguments = ["simulate", "--vehicles", "2", "--ring", "20", "--duration", "5", "--effect", "syrup:k=1", "-o"]
    said = subprocess.run(
        [Path(sys.executable).parent / "sugiyama", *arguments, tmp_path / "out.csv"],
        env=os.environ | {"PYTHONPATH": str(tmp_path)},
        capture_output=True,
        text=True,
        check=False,
    )
    assert said.returncode == 2
    line = said.stderr.splitlines()[-1]
    assert line.startswith("error: an effect divides by zero; effects of other packages here: syrup;")
    assert "docs/howto/effect.md" in line
    assert "Traceback" not in said.stderr
    assert not (tmp_path / "out.csv").exists()

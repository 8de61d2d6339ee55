"""What the pages say works: their blocks run in order, in an empty folder for each page, as do the next steps printed.

``blocks.py`` says how a page marks a block that is not run, is a file, or goes on until Ctrl-C. A page that works on a
file of the reader's finds a small one of the same name and form here.
"""

import re
import shlex
import sys
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from importlib.util import find_spec
from pathlib import Path

import pytest
from typer.main import get_command

from journeys import recordings
from journeys.blocks import PYTHON, ROOT, SHELL, blocks, has_shape, pages
from journeys.forks import Forks
from journeys.terminal import COMMANDS, Said, Terminal, follow
from sugiyama_ros.cli.app import app

pytestmark = [pytest.mark.system, pytest.mark.timeout(1800)]
#: Files that a page works on, and how they are made.
GIVEN: Mapping[str, Mapping[str, Callable[[Path], object]]] = {
    "docs/first_steps.md": {
        "my.csv": lambda path: recordings.ring_csv(path, ring_m=230.0, duration_s=40.0),
        "case1.data": lambda path: recordings.mstf(path, ring_m=230.0, duration_s=40.0),
    },
    "docs/howto/data.md": {
        "trajectories-0400-0415.txt": recordings.ngsim,
        "mine.csv": recordings.own_columns,
    },
    "docs/ros.md": {
        "case1.data": lambda path: recordings.mstf(path, ring_m=230.0, duration_s=40.0),
        "BAG": recordings.odometry_bag,
        "line.csv": recordings.centre_line,
    },
    "examples/tutorial.md": {
        "first.csv": lambda path: recordings.ring_csv(path, ring_m=105.0, duration_s=40.0),
        "second.csv": lambda path: recordings.ring_csv(path, ring_m=105.0, duration_s=40.0, seed=2),
    },
}
#: Rooms that parts of one's own may be in.
OWN_ROOMS = ("effects", "laws", "controllers", "formats", "studies")
#: Pages about parts of one's own: they share one package, which is compiled once (test_own_parts.py).
OWN_PARTS = tuple(f"docs/howto/{name}.md" for name in ("effect", "law", "format", "study"))
#: Notebooks that `make docs` runs, which checks what they find.
NOTEBOOKS = ("from_a_bag", "live_style", "one_driver", "other_law")
#: A command that needs no shell.
_PLAIN = re.compile(r"(?:\.venv/bin/)?(sugiyama [^|&;$`<*?\\]+)")


def name_of(page: Path) -> str:
    return str(page.relative_to(ROOT))


def run_commands(terminal: Terminal, forks: Forks, text: str) -> Said:
    """Run commands, in children of a process that has loaded everything where they need no shell."""
    lines = [line.split(" #")[0].strip() for line in text.splitlines()]
    plain = [_PLAIN.fullmatch(line) for line in lines if line and not line.startswith("#")]
    if not all(plain):
        return terminal.run(text)
    out, err = "", ""
    for command in filter(None, plain):
        said = forks.run_text(terminal.here, command[1])
        out, err = out + said.out, err + said.err
        if said.code:
            return Said(said.code, out, err)
    return Said(0, out, err)


def run_page(terminal: Terminal, forks: Forks, page: Path) -> Iterator[str]:
    """Run all blocks of a page; yields what is wrong."""
    done: set[str] = set()
    run = partial(run_commands, terminal, forks)
    for block in blocks(page):
        if block.mark == "file":
            path = terminal.here / block.words
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block.text)
        if not block.is_run:
            continue
        if block.language in PYTHON:
            if wrong := terminal.python(block.where, block.text):
                yield f"{block.where}\n{wrong}"
            continue
        for command, shown in block.commands:
            said = terminal.run(command, block.words) if block.mark == "until" else run(command)
            if said.code != 0:
                yield f"{block.where}: exit code {said.code}\n{command}{said.out}{said.err}"
            if shown and not has_shape(said.out + said.err, shown):
                yield f"{block.where}: the page shows\n{shown}but the command prints\n{said.out}{said.err}"
            done |= {line.split("#")[0].strip() for line in command.splitlines()}
            for step, answer in follow(run, said, done):
                if answer.code != 0:
                    yield f"{block.where}: the next step\n{step}\nends with {answer.code}\n{answer.out}{answer.err}"


def with_blocks() -> Iterator[object]:
    """Each page that has blocks to run, as a parameter of a test."""
    for page in pages():
        name = name_of(page)
        if name not in OWN_PARTS and page.stem not in NOTEBOOKS and any(block.is_run for block in blocks(page)):
            yield pytest.param(page, id=name)


@pytest.fixture
def terminal(tmp_path: Path) -> Iterator[Terminal]:
    terminal = Terminal(tmp_path)
    (terminal.here / ".venv").symlink_to(sys.prefix)  # as after `make`
    yield terminal
    terminal.close()


@pytest.mark.parametrize("page", list(with_blocks()))
def test_the_blocks_of_a_page_work(page: Path, terminal: Terminal, forks: Forks) -> None:
    for name, write in GIVEN.get(name_of(page), {}).items():
        write(terminal.here / name)
    wrong = list(run_page(terminal, forks, page))
    assert not wrong, "\n\n".join(wrong)


def test_blocks_without_a_language_are_commands() -> None:
    """Other text says what it is: a block without a language would be run by who reads the page."""
    known = {*SHELL, *PYTHON, "text", "csv", "toml", "yaml", "json"}
    for page in pages():
        for block in blocks(page):
            assert block.language in known or block.language.startswith("{"), block.where


def said_in_text() -> Iterator[tuple[str, str]]:
    """Each command of `sugiyama` that a page names, with its place."""
    for page in pages():
        for number, line in enumerate(page.read_text().splitlines(), 1):
            for code in re.findall(r"`(?:\.venv/bin/)?(sugiyama [^`]+)`", line):
                yield f"{name_of(page)}:{number}", code
        for block in blocks(page):
            if block.language in SHELL:
                for code in re.findall(r"^(?:\$ )?(sugiyama [^|>#;\n]+)", block.text, re.MULTILINE):
                    yield block.where, code


def test_commands_and_options_that_pages_name_exist() -> None:
    known = get_command(app).commands  # type: ignore[attr-defined]
    found = list(said_in_text())
    assert len(found) > 50
    for where, code in found:
        words = shlex.split(re.sub(r"\[([^\]]*)\]", r"\1", code), comments=True)[1:]
        if words[0].startswith("-") or words[0].isupper():  # sugiyama --help, sugiyama COMMAND
            continue
        assert words[0] in known, f"{where}: {code}"
        options = {option for parameter in known[words[0]].params for option in parameter.opts} | {"--help"}
        asked = {word.split("=")[0] for word in words[1:] if re.match(r"-[-a-z]", word)}
        assert asked <= options, f"{where}: {code}: {asked - options}"


def test_targets_and_files_that_pages_name_exist() -> None:
    """`make TARGET`, `python -m MODULE`, and paths in the repository."""
    targets = set(re.findall(r"^([a-z]+):", (ROOT / "Makefile").read_text(), re.MULTILINE))
    for page in pages():
        text = page.read_text()
        for target in re.findall(r"(?:^|`)make ([a-z]+)", text, re.MULTILINE):
            assert target in targets, f"{page}: make {target}"
        for module in re.findall(r"python -m ((?:sugiyama_ros|benchmarks)(?:\.\w+)+)", text):
            assert find_spec(module) is not None, f"{page}: {module}"
        for path in re.findall(
            r"`((?:test|docs|sugiyama_ros|benchmarks|layouts|launch|config|examples|\.ci)/[\w./]+)`", text
        ):
            is_own = any(path.startswith(f"sugiyama_ros/{room}/") for room in OWN_ROOMS)
            is_example = name_of(page) in (*OWN_PARTS, "CONTRIBUTING.md")
            is_made = path.startswith("docs/_build/")
            assert (ROOT / path).exists() or is_made or (is_example and (is_own or path.startswith("test/unit/"))), (
                f"{page}: {path}"
            )


def test_the_examples_of_helps_work(forks: Forks, tmp_path: Path) -> None:
    """`sugiyama COMMAND --help` may end with examples: lines that begin with `sugiyama`."""
    recordings.ring_csv(tmp_path / "ring.csv", duration_s=40.0)
    wrong = []
    for name in COMMANDS:
        said = forks.run(tmp_path, [name, "--help"])
        assert said.code == 0
        for example in re.findall(r"^ +(sugiyama .+)$", said.out, re.MULTILINE):
            answer = forks.run_text(tmp_path, example)
            if answer.code != 0:
                wrong.append(f"{name} --help: {example}\n{answer.err}")
    assert not wrong, "\n".join(wrong)


#: Commands that print next steps, in their order; each works in the folder of those before it.
STARTS = (
    "sugiyama simulate --vehicles 4 --ring 45 --duration 40 --seed 1 -o ring.csv",
    "sugiyama simulate --vehicles 4 --ring 45 --duration 40 --seed 1 -o ring.mcap",
    "sugiyama simulate --lanes 2 --vehicles 3 --duration 40 -o tracks.parquet",
    "sugiyama convert tracks.parquet lane.csv --lane 1",
    "sugiyama calibrate ring.csv --ring 45 -o base.yaml",
    "sugiyama run ring.csv --ring 45 -o run.mcap",
    "sugiyama diagnose ring.csv --ring 45 --seed 2",
    "sugiyama diagnose ring.mcap --add drag -o model.yaml --save drag.json",
    "sugiyama diagnose tracks.parquet",
    "sugiyama compare ring.mcap",
    "sugiyama demo --data ring.mcap -o demo.mcap",
    "sugiyama info run.mcap",
)


def test_the_next_steps_that_commands_print_work(forks: Forks, tmp_path: Path) -> None:
    wrong, done = [], set(STARTS)
    run = partial(forks.run_text, tmp_path)
    for start in STARTS:
        said = run(start)
        assert said.code == 0, f"{start}\n{said.err}"
        for step, answer in follow(run, said, done):
            if answer.code != 0:
                wrong.append(f"after {start}\n{step}\nends with {answer.code}\n{answer.out}{answer.err}")
    assert len(done) > len(STARTS)
    assert not wrong, "\n\n".join(wrong)

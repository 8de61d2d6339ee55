"""A terminal in an empty folder, in which blocks of pages and the next steps that commands print are run."""

import json
import os
import re
import signal
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from typer.main import get_command

from sugiyama_ros.cli.app import app

BIN = Path(sys.executable).parent
COMMANDS = tuple(get_command(app).commands)  # type: ignore[attr-defined]
#: A next step in what a command prints: it ends where the text around it goes on.
_STEP = re.compile(rf"\bsugiyama (?:{'|'.join(COMMANDS)})\b[^;&)\n`]*")
_SECONDS = 600
#: Runs Python blocks that share their names, one after the other: reads JSON lines, answers with a line for each.
_PYTHON = """
import json, sys, traceback
names = {"__name__": "__main__"}
for line in sys.stdin:
    where, text = json.loads(line)
    try:
        exec(compile(text, where, "exec"), names)
        wrong = ""
    except BaseException:
        wrong = traceback.format_exc()
    sys.stdout.flush()
    print(json.dumps({"wrong": wrong}), file=sys.stderr, flush=True)
"""


@dataclass(frozen=True)
class Said:
    """What commands have said: their exit code, and both outputs."""

    code: int
    out: str
    err: str

    @property
    def steps(self) -> list[str]:
        """Next steps that were printed and can be pasted; OTHER stands for a recording that only the user has."""
        return [found.strip() for found in _STEP.findall(self.out + self.err) if " OTHER" not in found]


def environment(folder: Path) -> dict[str, str]:
    """Variables of a user who is new: a home of their own, and programs that open a browser do nothing."""
    stubs, home = folder / "bin", folder / "home"
    for one in (stubs, home):
        one.mkdir()
    for name in ("xdg-open", "sensible-browser", "www-browser", "x-www-browser"):
        (stubs / name).write_text("#!/bin/sh\n")
        (stubs / name).chmod(0o755)
    kept = {k: v for k, v in os.environ.items() if k not in ("ROS_DOMAIN_ID", "ROS_AUTOMATIC_DISCOVERY_RANGE")}
    return kept | {
        "PATH": os.pathsep.join(map(str, (stubs, BIN, os.environ["PATH"]))),
        "HOME": str(home),
        "BROWSER": "true",
        "MPLBACKEND": "Agg",
        "COLUMNS": "120",
    }


def follow(run: Callable[[str], Said], said: Said, done: set[str]) -> Iterator[tuple[str, Said]]:
    """Take each next step that was printed, and the steps that these print.

    Parameters
    ----------
    run : callable
        Runs a step.
    said : Said
        What a command has said.
    done : set of str
        Steps that were taken already; the others are added. A step whose output is there already is taken again with
        --overwrite, as its error says.

    Yields
    ------
    step : str
        The step.
    said : Said
        What it has said.
    """
    steps = said.steps
    while steps:
        step = steps.pop(0)
        if step in done:
            continue
        done.add(step)
        answer = run(step)
        if answer.code == 2 and "--overwrite" in answer.err:
            answer = run(f"{step} --overwrite")
        yield step, answer
        steps += answer.steps


class Terminal:
    """A shell whose variables and folder last from one block to the next, in a folder of its own.

    Parameters
    ----------
    folder : Path
        Folder for everything; the shell starts in a new folder in it. Programs that open a browser do nothing.
    variables : str
        More variables of the environment.
    """

    def __init__(self, folder: Path, **variables: str) -> None:
        self.here, self._state = folder / "here", folder / "state"
        self.here.mkdir()
        self._state.write_text("")
        self.environment = environment(folder) | variables
        self._python: subprocess.Popen[str] | None = None

    def run(self, text: str, until: str = "") -> Said:
        """Run commands. With ``until``, Ctrl-C comes as soon as this text was printed."""
        script = f". {self._state}\nset -eo pipefail\n{text}\nset +e\nexport -p > {self._state}\n"
        script += f"printf 'cd %q\\n' \"$PWD\" >> {self._state}\n"
        process = subprocess.Popen(
            ["bash", "-c", script],
            cwd=self.here,
            env=self.environment,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
            # programs that a shell starts in the background ignore Ctrl-C
            preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
        )
        try:
            if not until:
                out, err = process.communicate(timeout=_SECONDS)
                return Said(process.returncode, out, err)
            return _interrupted(process, until)
        finally:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()

    def python(self, where: str, text: str) -> str:
        """Run Python code after that of earlier blocks. Returns the traceback, or nothing."""
        if self._python is None:
            self._python = subprocess.Popen(
                [sys.executable, "-c", _PYTHON],
                cwd=self.here,
                env=self.environment,
                stdin=subprocess.PIPE,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.PIPE,
                text=True,
            )
        assert self._python.stdin is not None
        assert self._python.stderr is not None
        self._python.stdin.write(json.dumps([where, text]) + "\n")
        self._python.stdin.flush()
        said = ""
        for line in self._python.stderr:
            if line.startswith('{"wrong": '):
                return str(json.loads(line)["wrong"])
            said += line
        return said

    def close(self) -> None:
        """End the process of the Python blocks."""
        if self._python is not None:
            self._python.communicate(timeout=_SECONDS)


def _interrupted(process: "subprocess.Popen[str]", until: str) -> Said:
    """Wait for a text in one of the outputs, press Ctrl-C, and return what was said."""
    came, parts = threading.Event(), {"out": "", "err": ""}

    def read(name: str, stream: "Iterator[str]") -> None:
        for line in stream:
            parts[name] += line
            if until in line:
                came.set()
        came.set()

    streams = {"out": process.stdout, "err": process.stderr}
    readers = [threading.Thread(target=read, args=pair) for pair in streams.items()]
    for reader in readers:
        reader.start()
    assert came.wait(_SECONDS), f"{until!r} did not come: {parts}"
    os.killpg(process.pid, signal.SIGINT)
    process.wait(_SECONDS)
    for reader in readers:
        reader.join()
    for stream in streams.values():
        assert stream is not None
        stream.close()
    return Said(process.returncode, parts["out"], parts["err"])

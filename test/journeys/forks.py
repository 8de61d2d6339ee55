"""Commands of `sugiyama` in children of a process that has loaded everything: a case takes a fraction of a second.

Each command runs in a child of its own, so nothing that it changes reaches the next one. The parent has no threads when
it forks: it has called the commands that load compiled code, and their threads have ended.
"""

import json
import os
import select
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NoReturn

from journeys.terminal import Said

#: A child that takes longer hangs.
SECONDS = 600


class Forks:
    """A process that has loaded the commands, and forks for each command.

    Parameters
    ----------
    folder : Path
        Folder in which the commands run.
    preload : sequence of sequences of str
        Commands that the process calls itself first, to load what they need.
    environment : mapping of str to str
        Variables of its environment.
    """

    def __init__(self, folder: Path, preload: Sequence[Sequence[str]], environment: Mapping[str, str]) -> None:
        places = [str(Path(__file__).parents[1]), *filter(None, [environment.get("PYTHONPATH")])]
        self._process = subprocess.Popen(
            [sys.executable, __file__, json.dumps(list(map(list, preload)))],
            cwd=folder,
            env={**environment, "PYTHONPATH": os.pathsep.join(places)},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )

    def run(self, folder: Path, arguments: Sequence[str], until: str = "") -> Said:
        """Run `sugiyama` with these arguments in a folder. With ``until``, Ctrl-C comes once this text was printed."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write(json.dumps([str(folder), list(arguments), until]) + "\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        assert line, f"the process that forks has ended: {arguments}"
        return Said(*json.loads(line))

    def run_text(self, folder: Path, text: str) -> Said:
        """Run a command as it stands in a text; ``> FILE`` at its end keeps what it prints."""
        command, _, file = text.partition(">")
        said = self.run(folder, shlex.split(command)[1:])
        if file:
            (folder / file.strip()).write_text(said.out)
        return said

    def close(self) -> None:
        """End the process."""
        self._process.communicate()
        assert self._process.returncode == 0


def _call(arguments: Sequence[str]) -> int:
    """Run a command in this process."""
    from sugiyama_ros import cli

    sys.argv = ["sugiyama", *arguments]
    try:
        cli.main()
    except SystemExit as end:
        return int(end.code or 0)
    return 0


def _child(folder: str, arguments: Sequence[str], outputs: Sequence[int]) -> NoReturn:
    """Be the command: run it, and end as its process would."""
    code = 70
    try:
        os.setsid()
        os.chdir(folder)
        signal.signal(signal.SIGINT, signal.default_int_handler)
        for number, output in enumerate(outputs, 1):
            os.dup2(output, number)
        os.dup2(os.open(os.devnull, os.O_RDONLY), 0)
        # what Python knows of the parent's streams, such as whether one can seek in them, does not hold here
        sys.stdout, sys.stderr = (open(number, "w", closefd=False) for number in (1, 2))  # noqa: SIM115
        code = _call(arguments)
    except BaseException:
        import traceback

        traceback.print_exc()
    finally:
        sys.stdout.flush()
        sys.stderr.flush()
        os._exit(code)


def _run(folder: str, arguments: Sequence[str], until: str) -> tuple[int, str, str]:
    """Fork, and read what the child says."""
    pipes = [os.pipe(), os.pipe()]
    pid = os.fork()
    if pid == 0:
        _child(folder, arguments, [writing for _, writing in pipes])
    for _, writing in pipes:
        os.close(writing)
    said = {reading: b"" for reading, _ in pipes}
    left, end, waits = set(said), time.monotonic() + SECONDS, until.encode()
    while left and time.monotonic() < end:
        for reading in select.select(list(left), [], [], 1.0)[0]:
            more = os.read(reading, 1 << 16)
            said[reading] += more
            if not more:
                left.discard(reading)
        if waits and any(waits in text for text in said.values()):
            os.killpg(pid, signal.SIGINT)
            waits = b""
    if left:
        os.killpg(pid, signal.SIGKILL)
    _, status = os.waitpid(pid, 0)
    for reading in said:
        os.close(reading)
    return (os.waitstatus_to_exitcode(status), *(text.decode(errors="replace") for text in said.values()))


def main() -> None:
    """Load, then run one command for each line of the input."""
    requests, answers = sys.stdin, os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    import sugiyama_ros.nodes.live
    import sugiyama_ros.nodes.run  # noqa: F401

    for arguments in json.loads(sys.argv[1]):
        assert _call(arguments) == 0, arguments
    import threading

    assert threading.active_count() == 1, threading.enumerate()
    for line in requests:
        answers.write(json.dumps(_run(*json.loads(line))) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()

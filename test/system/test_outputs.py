"""Outputs and odd circumstances as a user meets them: one line and exit code 2, and no file is lost."""

import os
import resource
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from journeys.terminal import Said

from sugiyama_ros.formats.mcap_reader import Bag

pytestmark = [pytest.mark.system, pytest.mark.timeout(900)]
SUGIYAMA = str(Path(sys.executable).with_name("sugiyama"))
GOOD = "time_s,vehicle,position_m\n" + "".join(f"{0.5 * t},{v},{20 * v + 4 * t}\n" for t in range(40) for v in range(3))
OLD = b"old, and whole"


def sugiyama(*arguments, **options):
    options = {"capture_output": True, "timeout": 120, "check": False} | options
    return subprocess.run([SUGIYAMA, *arguments], **options)


def refused(done, *words):
    """The command was refused with one line, which contains the words."""
    code, said = (done.code, done.err) if isinstance(done, Said) else (done.returncode, done.stderr.decode())
    assert (code, said.count("\n"), said[:7]) == (2, 1, "error: "), said
    assert all(word in said for word in words), said


@pytest.fixture(scope="module")
def good(tmp_path_factory, forks):
    """A table and a recording of the same drive."""
    folder = tmp_path_factory.mktemp("good")
    (folder / "good.csv").write_text(GOOD)
    assert forks.run(folder, ["convert", "good.csv", "good.mcap", "--ring", "80"]).code == 0
    return folder


@pytest.fixture
def here(tmp_path, monkeypatch, good):
    monkeypatch.chdir(tmp_path)
    for file in good.iterdir():
        shutil.copy(file, tmp_path)
    return tmp_path


@pytest.fixture
def forked(here, forks):
    """Run a command in a child of a process that has loaded everything."""
    return lambda *arguments: forks.run(here, arguments)


#: Commands that write, with the name of their output.
WRITE = {
    "convert": ("convert", "good.csv", "out.mcap"),
    "simulate": ("simulate", "-o", "out.mcap", "--duration", "5"),
    "report": ("report", "good.mcap", "-o", "out.html"),
    "recover": ("recover", "good.mcap", "-o", "out.mcap"),
    "run": ("run", "good.mcap", "-o", "out.mcap"),
    "calibrate": ("calibrate", "good.mcap", "-o", "out.yaml"),
    "diagnose": ("diagnose", "good.mcap", "-o", "out.yaml"),
    "study": ("study", "jam", "-o", "out.png"),
    "demo": ("demo", "-o", "out.mcap"),
    "live": ("live", "good.mcap", "-o", "out.mcap"),
}


@pytest.mark.parametrize("command", WRITE)
def test_an_existing_output_is_refused(here, forked, command):
    output = here / next(word for word in WRITE[command] if word.startswith("out."))
    output.write_bytes(OLD)
    refused(forked(*WRITE[command]), output.name, "exists already", "--overwrite")
    output.unlink()
    os.mkfifo(output)
    refused(forked(*WRITE[command], "--overwrite"), output.name, "is a pipe")
    assert output.is_fifo()


@pytest.mark.parametrize(
    "arguments",
    [
        ("convert", "good.mcap", "good.mcap"),
        ("convert", "good.csv", "good.csv"),
        ("convert", ".", "good.csv"),
        ("run", "good.mcap", "-o", "good.mcap"),
        ("live", "good.mcap", "-o", "good.mcap"),
        ("demo", "--data", "good.mcap", "-o", "good.mcap"),
        ("report", "good.mcap", "-o", "link.html"),
        ("recover", "good.mcap", "-o", "good.mcap"),
    ],
)
def test_an_input_is_never_replaced(here, forked, arguments):
    before = (here / "good.mcap").read_bytes()
    (here / "link.html").hardlink_to(here / "good.mcap")
    refused(forked(*arguments, "--overwrite"), "also read by this command")
    assert ((here / "good.mcap").read_bytes(), (here / "good.csv").read_text()) == (before, GOOD)


def test_overwrite_replaces_and_a_part_of_somebody_stays(here, forked):
    (here / "out.csv.part").write_bytes(OLD)
    for overwrite in ((), ("--overwrite",)):
        assert forked("simulate", "-o", "out.csv", "--duration", "5", *overwrite).code == 0
    assert (here / "out.csv.part").read_bytes() == OLD
    assert not list(here.glob("out.csv.*.part"))


def test_an_interrupted_run_ends_with_130_and_a_whole_file(here, forked):
    assert forked("simulate", "-o", "long.mcap", "--vehicles", "3", "--ring", "60", "--duration", "100").code == 0
    command = [SUGIYAMA, "run", "long.mcap", "-o", "out.mcap", "--rate", "4", "--json"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        while not any(part.stat().st_size > 3000 for part in here.glob("out.mcap.*.part")):
            assert running.poll() is None, running.stderr.read()
            time.sleep(0.05)
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=60)
    assert running.returncode == 130
    assert b"Traceback" not in said
    with Bag(here / "out.mcap") as bag:
        assert bag.info().messages > 0


@pytest.mark.parametrize("after_s", [0.15, 1.0])
def test_ctrl_c_while_a_command_is_loaded_ends_it_with_130(here, after_s):
    # a shell that runs the tests in the background has them ignore Ctrl-C, which programs that they start inherit
    command = [SUGIYAMA, "simulate", "--duration", "1e5", "-o", "out.mcap"]
    with subprocess.Popen(
        command, stderr=subprocess.PIPE, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    ) as running:
        time.sleep(after_s)
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=60)
    # before the program has begun, the interpreter itself ends, with the signal
    assert running.returncode in (130, -signal.SIGINT)
    if running.returncode == 130:
        assert b"Traceback" not in said


def test_a_full_stdout_is_one_line(here):
    for arguments in (("info", "good.mcap"), ("echo", "good.mcap", "/measured"), ("--help",)):
        with Path("/dev/full").open("wb") as full:
            refused(sugiyama(*arguments, stdout=full, stderr=subprocess.PIPE, capture_output=False), "No space left")


def test_a_full_stderr_does_not_change_the_exit_code(here):
    for arguments in (("info", "missing.csv"), ("fetch", "sugiyama2008"), ("no_such_command",)):
        with Path("/dev/full").open("wb") as full:
            done = sugiyama(*arguments, stdout=full, stderr=full, capture_output=False)
            assert done.returncode == 2


def test_a_closed_stdout_is_no_error_and_no_file_takes_its_place(here):
    done = subprocess.run(
        ["bash", "-c", f"{SUGIYAMA} simulate -o out.csv --duration 5 >&-"], capture_output=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, b"")
    assert (here / "out.csv").read_text().startswith("time_s,vehicle")


def test_a_terminal_without_unicode_is_no_error(here):
    ascii_only = os.environ | {"PYTHONIOENCODING": "ascii", "LC_ALL": "C"}
    (here / "Straße.csv").write_text(GOOD)
    done = sugiyama("convert", "Straße.csv", "Straße.mcap", env=ascii_only)
    assert done.returncode == 0, done.stderr
    assert b"Stra\\xdfe.mcap" in done.stdout
    assert sugiyama("info", "Straße.mcap", env=ascii_only).returncode == 0


@pytest.mark.parametrize("name", ["", ".", "/", "x" * 300 + ".mcap", "good.csv/out.mcap", "missing/out.mcap"])
def test_odd_paths(here, forked, name):
    refused(forked("convert", "good.csv", name))
    if name not in ("", "."):  # this folder has a file of trajectories, so it can be read
        refused(forked("convert", name, "out.mcap"))
        refused(forked("info", name))
    assert sorted(p.name for p in here.iterdir()) == ["good.csv", "good.mcap"]


@pytest.mark.parametrize(
    "arguments",
    [
        ("--duration", "inf"),
        ("--duration", "1e12"),
        ("--vehicles", "1000000000000"),
        ("--effect", "external_push:strength=1"),
    ],
)
def test_simulations_without_end_or_sense_are_refused(here, forked, arguments):
    refused(forked("simulate", "-o", "out.mcap", *arguments))
    assert not (here / "out.mcap").exists()


def test_a_value_that_no_node_takes_is_one_line(here, forked):
    refused(
        forked("run", "--simulate", "-o", "out.mcap", "--vehicles", "2", "--seed", str(2**31)), "seed: out of bounds"
    )
    assert not list(here.glob("out.*"))


@pytest.mark.parametrize("option", ["--model", "--diagnosis"])
def test_a_pipe_as_a_document_is_refused(here, forked, option):
    os.mkfifo(here / "pipe")
    command = ("run", "good.mcap", "-o", "out.mcap") if option == "--model" else ("report", "good.mcap")
    refused(forked(*command, option, "pipe"), "not a regular file")


def test_ctrl_c_while_something_compiles_ends_the_command_within_seconds(tmp_path):
    """The filter alone takes half a minute to compile, in a thread that nothing can interrupt."""
    (tmp_path / "good.csv").write_text(GOOD)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "compiled")}
    command = [SUGIYAMA, "calibrate", "good.csv", "-o", "model.yaml"]
    with subprocess.Popen(
        command,
        cwd=tmp_path,
        env=environment,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as running:
        while b"of run" not in (line := running.stderr.readline()):
            assert line, "nothing was compiled"
        running.send_signal(signal.SIGINT)
        _, said = running.communicate(timeout=10)
    assert running.returncode == 130
    assert b"Traceback" not in said
    assert sorted(one.name for one in tmp_path.iterdir()) == ["compiled", "good.csv"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_compiler_in_another_thread_does_not_keep_the_program(number):
    code = """
import sys, threading, time
from sugiyama_ros import interrupts
def compile_for_ever():
    with interrupts.compiling():
        print("begun", flush=True)
        time.sleep(600)
interrupts.remember()
thread = threading.Thread(target=compile_for_ever)
try:
    thread.start()
    thread.join()
except KeyboardInterrupt:  # as the command line ends
    interrupts.settled()
    sys.exit(130)
"""
    with subprocess.Popen(
        [sys.executable, "-c", code],
        stdout=subprocess.PIPE,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    ) as running:
        assert running.stdout.readline() == b"begun\n"
        running.send_signal(number)
        running.communicate(timeout=60)
    assert running.returncode == 130


def test_an_error_under_a_limit_of_memory_is_one_line(here):
    """Libraries fail in ways of their own, or go on for ever, where the shell gives them too little."""

    def within(megabytes):
        return lambda: resource.setrlimit(resource.RLIMIT_AS, (megabytes << 20,) * 2)

    refused(sugiyama("study", preexec_fn=within(350)), "ulimit -v", "350 MB", "1024 MB")
    assert sugiyama("info", "good.mcap", preexec_fn=within(1030)).returncode == 0
    assert b"calibrate" in sugiyama("--help", preexec_fn=within(500)).stdout


def test_another_interruption_while_the_interpreter_ends_is_silent():
    """A user presses Ctrl-C twice. From the end of the command on, the signal ends the program without a traceback."""
    code = "import atexit, os, signal; atexit.register(os.kill, os.getpid(), signal.SIGINT)\n"
    code += "import sys; sys.argv = ['sugiyama', '--version']\nfrom sugiyama_ros.cli import main; main()"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (-signal.SIGINT, b"")

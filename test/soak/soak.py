"""A soak: replay, drivers, critic, recorder and page run for long, and nodes are killed and started again at random.

    python test/soak/soak.py --minutes 60 [--seed 1] [--rate 20]

The first half is quiet: nobody is killed, and memory and descriptors of every process must stay flat. In the second
half, a node is killed every few seconds, two times of three without a chance to clean up, and started again. Vehicles
come and go all the time, and the recording starts anew again and again. Printed is what was seen; the exit code is 1
if a promise of docs/reliability.md does not hold.
"""

import argparse
import json
import os
import random
import signal
import statistics
import subprocess
import sys
import tempfile
import time
import urllib.request
from collections import Counter
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from threading import Thread
from typing import Any

import numpy as np
from rclpy.node import Node
from sugiyama_msgs.msg import DriverArray, MeasuredPositions

from sugiyama_ros.errors import SugiyamaError
from sugiyama_ros.formats.mcap_reader import Bag
from sugiyama_ros.formats.recover import recover
from sugiyama_ros.nodes.base import environment
from sugiyama_ros.nodes.base.qos import STREAM, reliable
from sugiyama_ros.nodes.base.spin import Spinner, ros

NODES = ("replay", "drivers", "critic", "recorder")
#: What a kill may take [s], and how long a node may take to end when it is asked to.
ALLOWED_S, END_S = 1.0, 30.0
# Characters of what a process that did not end says about its threads.
_SAID = 3000
#: Growth [MB] of a process in the quiet half, after its first third, and change of its descriptors.
GROWTH_MB, DESCRIPTORS = 10.0, 2
#: Time [s] in which the page answers, and the answers of the quiet half are there, on a machine of others too.
PATIENCE_S = 120.0
# A recorder that is killed sooner [ns] may have nothing on the disk.
_BEGINNING_NS = 10_000_000_000
_PORT, _LOOK_S, _VISIT_S = 5077, 2.0, 10.0
_PERIOD_S, _LOOP_S, _IN_VIEW_S, _HEADWAY_S = 0.1, 60.0, 20.0, 2.5


def write_tracks(path: Path, rng: np.random.Generator) -> None:
    """A car enters every 2.5 s, 30 m behind the one before, and is in view for 20 s. Its positions are noisy."""
    rows = ["recording,vehicle,time_s,s_m,lane,length_m"]
    for number in range(round((_LOOP_S - _IN_VIEW_S) / _HEADWAY_S)):
        for i in range(round(_IN_VIEW_S / _PERIOD_S)):
            driven = 12.0 * _PERIOD_S * i + 2.0 * np.sin(0.3 * _PERIOD_S * i + number)
            time_s = number * _HEADWAY_S + _PERIOD_S * i
            rows.append(f"a,{number + 1},{time_s:.2f},{driven + rng.normal(0.0, 0.1):.3f},1,4.5")
    path.write_text("\n".join(rows) + "\n")


class Listener(Node):
    """Hears the samples and the answers of all drivers, with the time at which they come."""

    def __init__(self) -> None:
        super().__init__("listener")
        self.samples: list[tuple[int, bytes]] = []
        self.answers: list[tuple[int, bytes]] = []
        for kind, topic, heard in (
            (MeasuredPositions, "/measured", self.samples),
            (DriverArray, "/drivers", self.answers),
        ):
            self.create_subscription(kind, topic, partial(_hear, heard), reliable(5000, STREAM.durability), raw=True)


def _hear(heard: list[tuple[int, bytes]], raw: bytes) -> None:
    heard.append((time.time_ns(), raw[4:12]))


@dataclass
class Process:
    """A process, its memory [MB] and its descriptors over time [s]."""

    name: str
    child: "subprocess.Popen[bytes]"
    output: Path | None = None
    seen: list[tuple[float, float, int]] = field(default_factory=list)
    began_ns: int = field(default_factory=time.time_ns)

    def catches(self, number: signal.Signals) -> bool:
        """Whether the process has a handler for a signal; until it has one, the signal ends it."""
        lines = Path(f"/proc/{self.child.pid}/status").read_text().splitlines()
        masks = [int(line.split()[1], 16) for line in lines if line.startswith("SigCgt")]
        return any(mask >> (number - 1) & 1 for mask in masks)

    def look(self, now_s: float) -> None:
        """Note memory and descriptors."""
        about = Path(f"/proc/{self.child.pid}")
        try:
            pages = int((about / "statm").read_text().split()[1])
            descriptors = sum(1 for _ in (about / "fd").iterdir())
        except OSError:
            return
        self.seen.append((now_s, pages * os.sysconf("SC_PAGE_SIZE") / 1e6, descriptors))


class Soak:
    """The processes, what was done to them, and what is wrong."""

    def __init__(self, folder: Path, rate: float, seed: int) -> None:
        self.folder, self.rate, self.rng = folder, rate, random.Random(seed)
        self.source = folder / "tracks.csv"
        write_tracks(self.source, np.random.default_rng(seed))
        self.running: dict[str, Process] = {}
        self.faults: list[str] = []
        self.kills: Counter[str] = Counter()
        self.figures: dict[str, Any] = {"lost samples": 0, "recorded samples": 0, "bags whole": 0, "most lost [s]": 0.0}
        self.source_ends_ns: list[int] = []
        self._bags = 0
        self._visited_s = self._looked_s = 0.0
        self.visits = 0
        self._visit = Thread()

    def start(self, name: str) -> None:
        """Start a node, or the page."""
        output, given = None, {}
        if name == "recorder":
            output = self.folder / f"bag_{self._bags:04d}.mcap"
            self._bags += 1
            given = {"output": str(output)}
        if name == "replay":
            given = {"source": str(self.source), "loop": True, "rate": self.rate}
        command = [sys.executable, "-m", "sugiyama_ros.nodes.executables", name, "--ros-args"]
        for key, value in given.items():
            command += ["-p", f"{key}:={json.dumps(value)}"]
        if name == "page":
            command = [str(Path(sys.executable).with_name("sugiyama")), "live", "--port", str(_PORT)]
        with (self.folder / f"{name}.log").open("ab") as log:
            child = subprocess.Popen(
                command, stdin=subprocess.DEVNULL, stdout=log, stderr=log, cwd=self.folder,
                start_new_session=True, env=os.environ | {"PYTHONFAULTHANDLER": "1"},
            )  # fmt: skip
        self.running[name] = Process(name, child, output)

    def look(self, now_s: float) -> None:
        """Note memory and descriptors of all, visit the page, and find processes that ended on their own."""
        if now_s - self._looked_s < _LOOK_S:
            return
        self._looked_s = now_s
        for name, one in list(self.running.items()):
            if one.child.poll() is not None:
                self.faults.append(f"{name} ended on its own with code {one.child.returncode}")
                self._check_bag(one, time.time_ns(), killed=True)
                self.start(name)
            one.look(now_s)
        if now_s - self._visited_s > _VISIT_S and "page" in self.running and not self._visit.is_alive():
            self._visited_s = now_s
            self._visit = Thread(target=self.visit, daemon=True)
            self._visit.start()

    def visit(self) -> None:
        """Open the page, as a browser does. At first, it is still starting."""
        try:
            with urllib.request.urlopen(f"http://localhost:{_PORT}/", timeout=PATIENCE_S) as answer:
                self.visits += answer.status == 200
        except OSError as error:
            if self.visits:
                self.faults.append(f"the page does not answer: {error}")

    def end(self, name: str, spin: Any, how: signal.Signals) -> None:
        """Kill a process, or ask it to end; then look at its bag."""
        one = self.running.pop(name)
        at_ns, starting = time.time_ns(), not one.catches(how)
        one.child.send_signal(how)
        deadline = time.monotonic() + END_S
        while one.child.poll() is None and time.monotonic() < deadline:
            spin(0.05)
        if one.child.poll() is None:
            one.child.send_signal(signal.SIGABRT)  # Python then says where each thread is, whoever holds its lock
            one.child.wait()
            said = (self.folder / f"{name}.log").read_text(errors="replace").rpartition("Fatal Python error")[2]
            self.faults.append(f"{name} did not end within {END_S:g} s; it was here:\n{said[:_SAID]}")
        if name == "replay":
            self.source_ends_ns += [at_ns, time.time_ns()]
        if how != signal.SIGKILL and one.child.returncode not in (0, 130, *((-how,) if starting else ())):
            self.faults.append(f"{name} ended with code {one.child.returncode}")
        self.kills[f"{name}, {how.name}"] += 1
        self._check_bag(one, at_ns, how == signal.SIGKILL)

    def _check_bag(self, one: Process, end_ns: int, killed: bool) -> None:
        """Count the samples that came until the end and are not in the bag; the last second of a kill may go."""
        if one.output is None:
            return
        path = one.output
        try:
            if killed:
                parts = list(path.parent.glob(f"{path.name}.*.part"))
                if not parts:
                    return  # killed before it had begun
                recover(parts[0], path)
            with Bag(path) as bag:
                found = [(log_ns, cdr) for topic, cdr, log_ns in stamps(bag) if topic == "/measured"]
        except SugiyamaError as error:
            if not killed or end_ns - one.began_ns > _BEGINNING_NS:
                self.faults.append(f"a bag is not whole: {error}")
            return
        self.figures["bags whole"] += 1
        self.figures["recorded samples"] += len(found)
        if not found:
            return
        until_ns = end_ns - round((ALLOWED_S if killed else 0.2) * 1e9)
        wanted = Counter(
            stamp for at, stamp in self.listener.samples if found[0][0] < at < until_ns and self._counts(at)
        )
        missing = sum((wanted - Counter(stamp for _, stamp in found)).values())
        self.figures["lost samples"] += missing
        if killed:
            self.figures["most lost [s]"] = max(self.figures["most lost [s]"], (end_ns - found[-1][0]) / 1e9)
        if missing:
            self.faults.append(f"{path.name}: {missing} of {sum(wanted.values())} samples are not in the bag")

    def _counts(self, at_ns: int) -> bool:
        """Whether a sample must be recorded: what a source sent in its last second may have reached only some."""
        return all(not end - 1e9 * ALLOWED_S < at_ns < end + 1e8 for end in self.source_ends_ns)

    def check_flat(self, name: str, begin_s: float, end_s: float) -> None:
        """Compare memory and descriptors of a process at the end of a stretch with those after its first third."""
        from_s = begin_s + (end_s - begin_s) / 3.0
        seen = [one for one in self.running[name].seen if from_s <= one[0] <= end_s]
        part = max(len(seen) // 5, 1)
        (first_mb, first), (last_mb, last) = (
            (statistics.median(mb for _, mb, _ in some), statistics.median(n for _, _, n in some))
            for some in (seen[:part], seen[-part:])
        )
        self.figures[f"{name}: memory [MB], descriptors"] = f"{first_mb:.1f} -> {last_mb:.1f}, {first:g} -> {last:g}"
        if last_mb - first_mb > GROWTH_MB:
            self.faults.append(f"{name}: memory grew from {first_mb:.1f} to {last_mb:.1f} MB")
        if abs(last - first) > DESCRIPTORS:
            self.faults.append(f"{name}: descriptors went from {first:g} to {last:g}")

    def unanswered(self, from_ns: int, until_ns: int) -> tuple[int, int]:
        """Samples that came between two times, and how many of them have no answer yet."""
        wanted = Counter(stamp for at, stamp in self.listener.samples if from_ns < at < until_ns)
        return sum(wanted.values()), sum((wanted - Counter(stamp for _, stamp in self.listener.answers)).values())

    def check_answers(self, from_ns: int, until_ns: int) -> None:
        """Every sample of the quiet half is answered."""
        wanted, missing = self.unanswered(from_ns, until_ns)
        self.figures["quiet half: samples, without an answer"] = f"{wanted}, {missing}"
        if missing:
            self.faults.append(f"{missing} samples were not answered")

    def run(self, minutes: float) -> None:
        """Let everything run, first in peace, and then with kills."""
        half_s = 30.0 * minutes
        with ros() as asked_to_stop:
            self.listener = Listener()
            spinner = Spinner([self.listener])

            def spin(time_s: float) -> None:
                spinner.until(asked_to_stop, time_s)
                if asked_to_stop():
                    raise KeyboardInterrupt
                self.look(time.monotonic())

            for name in ("page", "recorder", "drivers", "critic", "replay"):
                self.start(name)
            spinner.until(lambda: len(self.listener.answers) > 0, 120.0)
            begin_s, begin_ns = time.monotonic(), time.time_ns()
            while time.monotonic() - begin_s < half_s:
                spin(0.2)
            for name in self.running:
                self.check_flat(name, begin_s, time.monotonic())
            end_ns = time.time_ns()
            while self.unanswered(begin_ns, end_ns)[1] and time.time_ns() - end_ns < 1e9 * PATIENCE_S:
                spin(1.0)
            self.check_answers(begin_ns, end_ns)
            chaos_s = time.monotonic()
            while time.monotonic() - chaos_s < half_s:
                spin(self.rng.uniform(2.0, 15.0))
                victim = self.rng.choice(NODES)
                self.end(victim, spin, signal.SIGKILL if self.rng.random() < 2 / 3 else signal.SIGTERM)
                spin(self.rng.uniform(0.0, 2.0))
                self.start(victim)
            answered = len(self.listener.answers)
            spinner.until(lambda: len(self.listener.answers) > answered + 20, 60.0)
            if len(self.listener.answers) <= answered + 20:
                self.faults.append("after the last kill, no drivers are followed")
            self.check_flat("page", chaos_s, time.monotonic())
            for name in ("replay", "critic", "drivers", "recorder", "page"):
                self.end(name, spin, signal.SIGTERM)
            spinner.close()
        self.figures |= {
            "samples": len(self.listener.samples),
            "visits of the page": self.visits,
            "kills": dict(self.kills),
        }


def stamps(bag: Bag) -> Any:
    """Topic, stamp and log time [ns] of all messages of a bag."""
    for topic, _, log_ns, message in bag.messages({"/measured"}):
        stamp = message.header.stamp
        yield topic, np.array([stamp.sec, stamp.nanosec], "<u4").tobytes(), log_ns


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--rate", type=float, default=20.0, help="times real time")
    given = parser.parse_args()
    environment.isolate()
    with tempfile.TemporaryDirectory(prefix="soak-") as name:
        soak = Soak(Path(name), given.rate, given.seed)
        try:
            soak.run(given.minutes)
        except KeyboardInterrupt:
            return 130
        finally:
            for one in soak.running.values():
                one.child.kill()
    print(json.dumps(soak.figures, indent=2))
    print("\n".join(["FAULTS", *soak.faults]) if soak.faults else "no faults")
    return 1 if soak.faults else 0


if __name__ == "__main__":
    sys.exit(main())

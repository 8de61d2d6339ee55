"""Benchmark of the diagnosis away from home: conditions, mechanisms, forms, laws and faults of another generator.

    python -m benchmarks.away --part conditions forms --seeds 2 --first-seed 100 -o rows.jsonl

Each recording is one line of JSON in the output. Recordings that the output has already are not diagnosed again, so a
run that was cut off goes on where it stopped. The table of all lines is printed at the end.
"""

import argparse
import json
import sys
import time
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from dataclasses import asdict
from multiprocessing import get_context
from pathlib import Path
from typing import Any

from benchmarks.away.cases import PARTS, STRENGTHS, Case, cases
from benchmarks.away.judged import Judged, judge_named, report
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Output, writing

#: A recording: the case, the strength, and the seed.
Job = tuple[Case, str, int]


def _parsed() -> argparse.Namespace:
    """Read the arguments of the command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", nargs="*", choices=PARTS, default=list(PARTS), help="parts of the benchmark")
    parser.add_argument("--only", nargs="*", default=[], help="names of the cases; all by default")
    parser.add_argument("--seeds", type=int, default=1, help="recordings of each case")
    parser.add_argument("--first-seed", type=int, default=0, help="first seed")
    parser.add_argument("--strength", nargs="*", choices=list(STRENGTHS), default=["strong"], help="strengths")
    parser.add_argument("--budget", type=float, default=float("inf"), help="seconds after which no recording begins")
    parser.add_argument("--workers", type=int, default=1, help="number of processes")
    parser.add_argument("-o", "--output", type=Path, help="lines of JSON, to which this run adds")
    return parser.parse_args()


def _jobs(given: argparse.Namespace) -> Iterator[Job]:
    """List all recordings."""
    for seed in range(given.first_seed, given.first_seed + given.seeds):
        for part in given.part:
            for case in cases(part):
                if given.only and case.name not in given.only:
                    continue
                hides = bool(case.right or case.covariates)
                for strength in given.strength if hides else given.strength[:1]:
                    yield case, strength, seed


def _read(path: Path | None) -> list[Judged]:
    """Read the rows that an earlier run has written."""
    if path is None or not path.exists():
        return []
    rows = []
    for line in path.read_text().splitlines():
        document: dict[str, Any] = json.loads(line)
        values: dict[str, Any] = {k: tuple(v) if isinstance(v, list) else v for k, v in document.items()}
        rows.append(Judged(**values))
    return rows


def main() -> None:
    """Run the benchmark."""
    given, began = _parsed(), time.monotonic()
    rows = _read(given.output)
    known = {(r.part, r.name, r.strength, r.seed) for r in rows}
    left = [job for job in _jobs(given) if (job[0].part, job[0].name, job[1], job[2]) not in known]
    running: set[Future[Judged]] = set()
    # spawned processes can build cases again, but cannot take over their functions
    with ProcessPoolExecutor(given.workers, mp_context=get_context("spawn")) as pool:
        while left or running:
            while left and len(running) < given.workers and time.monotonic() - began < given.budget:
                case, strength, seed = left.pop(0)
                running.add(pool.submit(judge_named, case.part, case.name, strength, seed))
            if not running:
                break
            done, running = wait(running, return_when=FIRST_COMPLETED)
            rows += [row for one in done for row in _finished(one)]
            if given.output is not None:
                _write(rows, given.output)
    print(report(rows))


def _finished(one: Future[Judged]) -> list[Judged]:
    """Take the result of a recording, if there is one."""
    try:
        return [one.result()]
    except (ValueError, InputError) as error:
        print(error, file=sys.stderr, flush=True)
        return []


def _write(rows: Sequence[Judged], output: Path) -> None:
    """Write all rows; the file is whole at any time."""
    with writing(Output(output, overwrite=True)) as stream:
        stream.write("".join(json.dumps(asdict(row)) + "\n" for row in rows).encode())


if __name__ == "__main__":
    main()

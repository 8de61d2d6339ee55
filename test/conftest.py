"""What all tests share: code is compiled before the first test that starts nodes or programs."""

import os
from collections.abc import Iterator

import pytest
from hypothesis import settings
from journeys import recordings
from journeys.forks import Forks
from journeys.terminal import environment

from sugiyama_ros.compile import compile_all

# The suite tries the same examples each time. `make fuzz` sets FUZZ_EXAMPLES, the number of damaged files of each kind,
# and tries others each time.
_EXAMPLES = os.environ.get("FUZZ_EXAMPLES")
settings.register_profile("suite", deadline=None, max_examples=int(_EXAMPLES or 25), derandomize=_EXAMPLES is None)
settings.load_profile("suite")


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile now, so that no time limit of a test or of a node counts it. With compiled code at hand, it is loaded."""
    starts = any(item.get_closest_marker(name) for item in session.items for name in ("ros", "system"))
    shares = hasattr(session.config, "workerinput")  # one of several processes: `make test` compiles before them
    if starts and not shares and not session.config.option.collectonly:
        compile_all(tell=lambda line: None)


@pytest.fixture(scope="session")
def forks(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Forks]:
    """A process that has loaded all commands, and forks for each one."""
    folder = tmp_path_factory.mktemp("forks")
    ring = [recordings.ring_csv(folder / "ring.csv", vehicles=3, ring_m=40.0, duration_s=40.0).name, "--ring", "40"]
    loading = [["calibrate", *ring], ["compare", *ring], ["diagnose", *ring, "--simulations", "1"]]
    forks = Forks(folder, [*loading, ["simulate", "--duration", "5", "-o", "loading.csv"]], environment(folder))
    yield forks
    forks.close()

"""What all tests share: code is compiled before the first test that starts nodes or programs."""

import os

import pytest
from hypothesis import settings

from sugiyama_ros.compile import compile_all

# The fuzzer tries FUZZ_EXAMPLES damaged files of each kind; `make fuzz` sets it.
settings.register_profile("suite", deadline=None, max_examples=int(os.environ.get("FUZZ_EXAMPLES", "25")))
settings.load_profile("suite")


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile now, so that no time limit of a test or of a node counts it. With compiled code at hand, it is loaded."""
    starts = any(item.get_closest_marker(name) for item in session.items for name in ("ros", "system"))
    if starts and not session.config.option.collectonly:
        compile_all(tell=lambda line: None)

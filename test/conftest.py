"""What all tests share: code is compiled before the first test that starts nodes or programs."""

import pytest

from sugiyama_ros.compile import compile_all


def pytest_collection_finish(session: pytest.Session) -> None:
    """Compile now, so that no time limit of a test or of a node counts it. With compiled code at hand, it is loaded."""
    starts = any(item.get_closest_marker(name) for item in session.items for name in ("ros", "system"))
    if starts and not session.config.option.collectonly:
        compile_all(tell=lambda line: None)

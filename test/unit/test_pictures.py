"""The pictures in README and the documentation show the pages as they are."""

import sys
from pathlib import Path

DOCS = Path(__file__).parents[2] / "docs"


def test_the_pictures_are_as_new_as_the_pages_code():
    sys.path.insert(0, str(DOCS))
    try:
        from pictures import CHECKSUM, checksum
    finally:
        sys.path.remove(str(DOCS))
    assert CHECKSUM.read_text().strip() == checksum(), "the pages have changed: run `make pictures`"
    assert all((DOCS / name).stat().st_size > 10_000 for name in ("report.png", "live.png"))

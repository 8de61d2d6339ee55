"""``python -m sugiyama_ros.studies.speed``."""

import argparse
import json
import sys
from pathlib import Path

from sugiyama_ros.errors import InputError
from sugiyama_ros.studies import speed
from sugiyama_ros.studies.speed.figure import SpeedFigure
from sugiyama_ros.studies.speed.page import cells, document, page
from sugiyama_ros.studies.speed.parts import PARTS, measured


def main() -> None:
    """Measure, and print the figures of each part as soon as they are known."""
    parser = argparse.ArgumentParser(description=speed.__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", action="append", choices=PARTS, help="measure this part; all parts by default")
    parser.add_argument("--json", action="store_true", help="print one JSON document instead of text")
    parser.add_argument("--write", type=Path, metavar="FILE", help="write the figures as a page in Markdown")
    given = parser.parse_args()
    found: dict[str, tuple[SpeedFigure, ...]] = {}
    for part in given.part or PARTS:
        try:
            found[part] = measured(part)
        except InputError as error:
            print(f"left out: {error}", file=sys.stderr)
            continue
        if not given.json:
            print_figures(part, found[part])
    if given.json:
        print(json.dumps(document(found), indent=2))
    if given.write is not None:
        given.write.write_text(page(found))


def print_figures(part: str, figures: tuple[SpeedFigure, ...]) -> None:
    """Print the figures of a part as a table."""
    print(part)
    for text, value, aim in map(cells, figures):
        print(f"    {text:<88}{value:>24}" + (f"   at most {aim}" if aim else ""), flush=True)


if __name__ == "__main__":
    main()

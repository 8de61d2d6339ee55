"""Writes the checksums of all pinned packages into the files of requirements, as PyPI's index says them.

Run it after a change of a pin: ``.venv/bin/python .ci/hashes.py``. pip then installs only files with these checksums.
They are the files for CPython 3.10-3.13 on 64-bit Linux; of a package without wheels, it is the source.
"""

import re
import urllib.request
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from packaging.requirements import Requirement
from packaging.tags import Tag
from packaging.utils import InvalidSdistFilename, InvalidWheelFilename, parse_sdist_filename, parse_wheel_filename
from packaging.version import InvalidVersion, Version

ROOT = Path(__file__).parents[1]
FILES = ("requirements.txt", "requirements-dev.txt", "requirements-docs.txt")
INDEX = "https://pypi.org/simple"
PYTHONS = ("cp310", "cp311", "cp312", "cp313")


def fits(tag: Tag) -> bool:
    """Whether a wheel installs on one of the Pythons."""
    if tag.platform != "any" and not re.fullmatch(r"(many)?linux.*x86_64", tag.platform):
        return False
    own = tag.interpreter in PYTHONS and tag.abi in (tag.interpreter, "abi3", "none")
    return own or tag.abi == "abi3" or (tag.abi == "none" and tag.interpreter.startswith("py"))


def known(pin: tuple[str, Version]) -> list[str]:
    """Checksums of the files of one version of a package."""
    name, version = pin
    with urllib.request.urlopen(f"{INDEX}/{name}/", timeout=60) as stream:
        page = stream.read().decode()
    wheels, sources = [], []
    for checksum, file in re.findall(r'sha256=([0-9a-f]{64})"[^>]*>([^<]+)<', page):
        try:
            if file.endswith(".whl"):
                _, found, _, tags = parse_wheel_filename(file)
                if found == version and any(map(fits, tags)):
                    wheels.append(checksum)
            elif parse_sdist_filename(file)[1] == version:
                sources.append(checksum)
        except (InvalidWheelFilename, InvalidSdistFilename, InvalidVersion):
            continue
    if not wheels and not sources:
        raise SystemExit(f"error: {INDEX}/{name}/ has no file of version {version} for {', '.join(PYTHONS)}")
    return sorted(wheels or sources)


def pins(path: Path) -> Iterator[tuple[str, tuple[str, Version] | None]]:
    """Each line of a file of requirements that holds no checksum, and its pin."""
    for line in path.read_text().splitlines():
        bare = line.removesuffix("\\").rstrip()
        if bare.lstrip().startswith("--hash="):
            continue
        if not bare or bare.startswith("#"):
            yield bare, None
            continue
        one = Requirement(bare)
        (pin,) = one.specifier
        yield bare, (one.name.lower().replace("_", "-").replace(".", "-"), Version(pin.version))


def main() -> None:
    every = {pin for name in FILES for _, pin in pins(ROOT / name) if pin}
    with ThreadPoolExecutor(8) as pool:
        checksums = dict(zip(every, pool.map(known, every), strict=True))
    for name in FILES:
        lines = []
        for bare, pin in pins(ROOT / name):
            hashes = [f"    --hash=sha256:{checksum}" for checksum in checksums[pin]] if pin else []
            lines.append(" \\\n".join([bare, *hashes]))
        (ROOT / name).write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()

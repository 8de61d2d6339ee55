"""Lists the licences of all pinned packages in docs/licences.md, and stops at a licence that is not known.

Run it after a change of a pin, in the environment of the pins: ``.venv/bin/python .ci/licences.py``. A test compares
the page with the pins. Licences come from the metadata of the packages, and for packages of ROS from their package.xml.
"""

import re
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, metadata
from pathlib import Path
from xml.etree import ElementTree

from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[1]
FILES = {"requirements.txt": "to run", "requirements-dev.txt": "for tests", "requirements-docs.txt": "for the docs"}
PAGE = ROOT / "docs" / "licences.md"
#: Licences, by what packages say. All of them allow use, change and redistribution, also beside other licences.
KNOWN = {
    "Apache-2.0": (
        "Apache-2.0",
        "Apache 2.0",
        "Apache License 2.0",
        "Apache Software License",
        "Apache License, Version 2.0",
    ),
    "BSD": ("BSD", "BSD License", "BSD License 2.0", "BSD 3-Clause", "New BSD", "Modified BSD", "Berkeley"),
    "BSD-2-Clause": ("BSD-2-Clause", "BSD-2-clause"),
    "BSD-3-Clause": ("BSD-3-Clause", "BSD-3-clause", "3-Clause BSD License"),
    "Boost-1.0": ("BSL-1.0", "Boost Software License", "Boost Software License, Version 1.0"),
    "any open": ("any-OSI",),
    "ISC": ("ISC", "ISC License", "ISC License (ISCL)"),
    "MIT": ("MIT", "MIT License", "MIT-CMU"),
    "MPL-2.0": ("MPL-2.0", "Mozilla Public License 2.0 (MPL 2.0)"),
    "PSF-2.0": ("PSF-2.0", "PSF", "Python Software Foundation License"),
    "Public domain": ("Public Domain", "Unlicense"),
    "Zlib": ("Zlib", "zlib", "zlib license"),
    # of what is not part of the program: empy writes the code of messages, and docutils has a mode for Emacs
    "LGPL-2.1": ("LGPL-2.1",),
    "GPL (one file)": ("GPL-3.0 (one file)", "GNU General Public License (GPL)"),
}
#: Of packages that say it in their files only, or that are installed with older versions of Python only.
GIVEN = {
    "docutils": "Public Domain; PSF-2.0; BSD-2-Clause; GPL-3.0 (one file)",
    "empy": "LGPL-2.1",
    "decorator": "BSD-2-Clause",
    "exceptiongroup": "MIT",
    "pytz": "MIT",
    "ros-fastcdr": "Apache-2.0",
    "ros-fastrtps": "Apache-2.0",
    "tomli": "MIT",
}
NOT_ASKED = ("DFSG approved", "OSI Approved")


def names(said: str) -> Iterator[str]:
    """Known names of the licences in a text. Raises KeyError for another licence."""
    known = {text.lower(): name for name, texts in KNOWN.items() for text in texts}
    for part in re.split(r"\s*;\s*|\s+(?:AND|OR|and|or)\s+", re.sub(r"\s+WITH LLVM-exception", "", said)):
        if part.strip("() ") and part not in NOT_ASKED:
            yield known[(part if part.lower() in known else part.strip("() ")).lower()]


def said(name: str) -> str:
    """What an installed package says about its licence."""
    if name in GIVEN:
        return GIVEN[name]
    if name.startswith("ros-"):
        for folder in (name[4:].replace("-", "_"), name[4:]):
            about = Path(sys.prefix, "share", folder, "package.xml")
            if about.exists():
                return "; ".join(str(one.text).strip() for one in ElementTree.parse(about).iter("license"))
    about = metadata(name)
    kinds = [one.rpartition(" :: ")[2] for one in about.get_all("Classifier") or [] if one.startswith("License")]
    first = (about.get("License") or "").strip().split("\n")[0]
    return about.get("License-Expression") or "; ".join(k for k in kinds if k not in NOT_ASKED) or first


def pins() -> dict[str, tuple[str, str]]:
    """Version of each pinned package, and what it is for."""
    found: dict[str, tuple[str, str]] = {}
    for file, use in FILES.items():
        for line in (ROOT / file).read_text().splitlines():
            if line and not line.startswith(("#", " ")):
                one = Requirement(line.removesuffix("\\"))
                (pin,) = one.specifier
                version, known_use = found.get(canonicalize_name(one.name), ("", use))
                versions = sorted({pin.version, *filter(None, version.split(", "))})
                found[canonicalize_name(one.name)] = ", ".join(versions), known_use
    return found


def main() -> None:
    rows, wrong = [], []
    for name, (version, use) in sorted(pins().items()):
        try:
            licences = sorted(set(names(said(name))))
            if not licences:
                wrong.append(f"{name}: says nothing about its licence; say it in GIVEN")
            rows.append(f"| {name} | {version} | {', '.join(licences)} | {use} |")
        except PackageNotFoundError:
            wrong.append(f"{name}: is not installed; install it, or say its licence in GIVEN")
        except KeyError as unknown:
            wrong.append(f"{name}: {unknown} is no licence that is known")
    if wrong:
        raise SystemExit("\n".join(wrong))
    head = (
        "# Licences of what is installed\n\nsugiyama_ros itself is under the licence in `LICENSE`. `make` installs"
        " these packages; each comes from PyPI under its own licence.\n`.ci/licences.py` writes this page from what the"
        " packages say, and stops at a licence that is not known.\n\n"
        "| package | version | licence | used |\n|---|---|---|---|\n"
    )
    PAGE.write_text(head + "\n".join(rows) + "\n")


if __name__ == "__main__":
    main()

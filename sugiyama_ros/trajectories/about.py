"""Where tracks come from, and what was done to them."""

import hashlib
from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

#: Length [m] of a vehicle if the file does not give the length: the mean of the paper's Table 1.
DEFAULT_LENGTH_M = 4.33
#: Source of what the package simulates, until it is read from a file.
SIMULATED = "simulated drivers"
#: Length [m] of a vehicle from which on a number is taken for damage: trains are shorter.
LONGEST_M = 1000.0
View = Literal["end", "whole"]
Reference = Literal["centre", "front", "rear"]
Leaders = Literal["found", "given"]


def source_in(file: str, source: str) -> str:
    """Source of a recording in a file that names its source; what was simulated comes from this file."""
    return f"{file} ({SIMULATED})" if source == SIMULATED else source


def file_in(source: str) -> str:
    """File that a source names."""
    return source.removesuffix(f" ({SIMULATED})")


@dataclass(frozen=True)
class About:
    """What is known of tracks beside their rows.

    reference: which point of a vehicle the positions were of in the source; those of tracks are of the centre; unit:
    unit of all lengths; smoothing: how the positions were smoothed; empty if nobody says; view: "end": vehicles beyond
    the first one were out of view, so that the leader of the first is unknown; "whole": everybody was in view, so that
    the first vehicle has a free road; leaders: "found": the next vehicle ahead leads, and what the file says is only
    compared; "given": the file says who leads; ring_m: circumference [m] of a ring road; 0 for open roads; period_s:
    time [s] between two samples, if the source states it; 0 if not; source, sha256, licence: name and checksum of the
    file, or of the rows where there is no file, and its terms of use; dropped: the ledger: reasons for which rows were
    left out, and how many rows; notes: what was changed or looks odd; checked: whether gaps below zero have been looked
    for, or need not be.
    """

    reference: Reference = "centre"
    unit: str = "m"
    smoothing: str = ""
    view: View = "end"
    leaders: Leaders = "found"
    ring_m: float = 0.0
    period_s: float = 0.0
    source: str = ""
    sha256: str = ""
    licence: str = ""
    dropped: tuple[tuple[str, int], ...] = ()
    notes: tuple[str, ...] = ()
    checked: bool = False

    def without(self, reason: str, rows: int) -> "About":
        """The same, with rows left out for a reason; nothing changes for 0 rows."""
        if rows == 0:
            return self
        ledger = dict(self.dropped)
        ledger[reason] = ledger.get(reason, 0) + int(rows)
        return replace(self, dropped=tuple(ledger.items()))

    def noting(self, *notes: str) -> "About":
        """The same, with notes that are not empty and not there yet."""
        new = tuple(note for note in dict.fromkeys(notes) if note and note not in self.notes)
        return replace(self, notes=(*self.notes, *new))


def checksum_of_parts(parts: Iterable[str | NDArray[np.generic]]) -> str:
    """Checksum (SHA-256) of texts and arrays, for what comes from no single file."""
    digest = hashlib.sha256()
    for part in parts:
        digest.update(part.encode(errors="surrogateescape") if isinstance(part, str) else part.tobytes())
        digest.update(b"\0")
    return digest.hexdigest()

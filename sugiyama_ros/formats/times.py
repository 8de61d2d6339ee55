"""Times as text: seconds, a clock such as 0:01:02.5, or a date with a clock."""

import re
from collections.abc import Iterable
from datetime import datetime, timezone

import numpy as np

from sugiyama_ros.arrays import Array

#: A day [s].
DAY_S = 86_400.0
#: What a text should look like that is not a time, for messages.
FORMS = "seconds, or a time such as 0:01:02.5 or 2024-05-31 10:00:00"
# Perhaps days, as 2:00:00:01 or 2 days 00:00:01; hours, minutes and seconds. Without hours, there is a fraction: nobody
# knows whether 10:30 means minutes or hours.
_CLOCK = re.compile(r"(?:(\d{1,6})(?::| days? ,?))?(\d{1,4}):(\d{1,2}):(\d{1,2}(?:[.,]\d*)?)")
_MINUTES = re.compile(r"(\d{1,6}):(\d{1,2}[.,]\d*)")
_DATE = re.compile(
    r"(\d{4})[-/](\d{2})[-/](\d{2})[T ](\d{2}):(\d{2})(?::(\d{2}(?:[.,]\d*)?))?\s?(Z|UTC|[+-]\d{2}:?\d{2})?"
)


def seconds_of(text: str) -> float | None:
    """Seconds that a text says; None for a text that is no time.

    Returns the time [s].
    """
    text = text.strip()
    try:
        return float(text if "." in text else text.replace(",", "."))
    except ValueError:
        pass
    if found := _CLOCK.fullmatch(text):
        days, hours, minutes, rest = found[1] or 0, found[2], found[3], found[4]
        return DAY_S * int(days) + 3600.0 * int(hours) + 60.0 * int(minutes) + _number(rest)
    if found := _MINUTES.fullmatch(text):
        return 60.0 * int(found[1]) + _number(found[2])
    return _since_1970(text)


def times_of(texts: Iterable[str]) -> tuple[Array, str]:
    """Times [s] of texts, (N,), and the first text that is no time, or nothing.

    A clock that passes midnight goes on counting.
    """
    texts = list(texts)
    found = [seconds_of(text) for text in texts]
    bad = next((text for text, time in zip(texts, found, strict=True) if time is None), "")
    time = np.array([np.nan if one is None else one for one in found], dtype=np.float64)
    clock = np.array([_CLOCK.fullmatch(text.strip()) is not None for text in texts], dtype=bool)
    if clock.any() and clock.all() and np.nanmax(time) < DAY_S:
        ordered = np.unique(time[np.isfinite(time)])
        hole = np.diff(ordered)
        # nobody records for half a day; what comes after such a hole was before midnight
        if len(hole) and hole.max() > 0.5 * DAY_S:
            time = np.where(time <= ordered[np.argmax(hole)], time + DAY_S, time)
    return time, bad


def _since_1970(text: str) -> float | None:
    if not (found := _DATE.fullmatch(text)):
        return None
    year, month, day, hour, minute = (int(found[k]) for k in range(1, 6))
    try:
        start = datetime(year, month, day, hour, minute, tzinfo=timezone.utc).timestamp()
    except ValueError:
        return None
    zone = found[7] or "Z"
    ahead = 0.0
    if zone[0] in "+-":
        ahead = (3600.0 * int(zone[1:3]) + 60.0 * int(zone[-2:])) * (-1.0 if zone[0] == "-" else 1.0)
    return start + _number(found[6] or "0") - ahead


def _number(text: str) -> float:
    return float(text.replace(",", "."))

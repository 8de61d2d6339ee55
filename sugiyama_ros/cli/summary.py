"""What ``convert`` and ``info`` print about tracks."""

from typing import TYPE_CHECKING, Any

from sugiyama_ros.tables import TextTable

if TYPE_CHECKING:
    from sugiyama_ros.trajectories.labels import Labels
    from sugiyama_ros.trajectories.tracks import Tracks

# Names that are listed; the others are counted.
_LISTED = 12


def document_of(tracks: "Tracks") -> dict[str, Any]:
    """Describe tracks as a document."""
    import numpy as np

    from sugiyama_ros.trajectories.time_base import is_regular, period_of

    first, last = tracks.time_s[tracks.start[:-1]], tracks.time_s[tracks.start[1:] - 1]
    moves = bool(np.any(np.diff(tracks.start) > 1))
    return {
        "source": tracks.about.source,
        "sha256": tracks.about.sha256,
        "licence": tracks.about.licence or None,
        "rows": len(tracks),
        "recordings": _counted(tracks, tracks.recording),
        "vehicles": tracks.runs,
        "classes": _counted(tracks, tracks.vehicle_class),
        "roads": _counted(tracks, tracks.road),
        "lanes": _counted(tracks, tracks.lane),
        "from_s": float(first.min()),
        "to_s": float(last.max()),
        "driven_s": float(np.sum(last - first)),
        "period_s": period_of(tracks) if moves else None,
        "regular": is_regular(tracks) if moves else None,
        "from_m": float(tracks.s_m.min()),
        "to_m": float(tracks.s_m.max()),
        "ring_m": tracks.about.ring_m or None,
        "leaders": {
            "in_the_table": float(np.mean(tracks.leader_row >= 0)),
            "free_road": float(np.mean(tracks.leader_row == -1)),
            "unknown": float(np.mean(tracks.leader_row == -2)),
        },
        "columns": list(tracks.columns),
        "smoothing": tracks.about.smoothing or None,
        "dropped": dict(tracks.about.dropped),
        "notes": list(tracks.about.notes),
    }


def _counted(tracks: "Tracks", column: "Labels | None") -> dict[str, int]:
    """Number of vehicles for each text of a column, by the text; empty for a column that is not there."""
    import numpy as np

    if column is None:
        return {}
    pair = np.unique(np.stack([column.code.astype(np.int64), tracks.run]), axis=1)
    code, vehicles = np.unique(pair[0], return_counts=True)
    return {
        column.text[one] if one >= 0 else "(none)": count
        for one, count in zip(code.tolist(), vehicles.tolist(), strict=True)
    }


def lines_of(document: dict[str, Any]) -> list[tuple[str, str]]:
    """The document as names and values."""
    leaders = document["leaders"]
    known = ", ".join(f"{leaders[name]:.1%} {name.replace('_', ' ')}" for name in leaders)
    irregular = "" if document["regular"] in (True, None) else ", irregular"
    lines = [
        ("Source", document["source"] or "not known"),
        ("Licence", document["licence"] or ""),
        ("Rows", f"{document['rows']} ({', '.join(document['columns'])})"),
        ("Recordings", _list(document["recordings"])),
        ("Vehicles", str(document["vehicles"])),
        ("Classes", _list(document["classes"])),
        ("Roads", _list(document["roads"])),
        ("Lanes", _list(document["lanes"])),
        ("Time", f"{document['from_s']:.9g} to {document['to_s']:.9g} s"),
        ("Driven", f"{document['driven_s']:.0f} s by all vehicles together"),
        (
            "Period",
            f"{document['period_s']:.4g} s{irregular}" if document["period_s"] else "one sample of each vehicle",
        ),
        ("Positions", f"{document['from_m']:.6g} to {document['to_m']:.6g} m, of the vehicles' centres"),
        ("Ring", f"{document['ring_m']:g} m" if document["ring_m"] else ""),
        ("Leaders", known),
        ("Smoothing", document["smoothing"] or ""),
        *(("Note", note) for note in document["notes"]),
    ]
    return [(name, value) for name, value in lines if value]


def _list(counted: dict[str, int]) -> str:
    """Names with their numbers of vehicles."""
    if not counted:
        return ""
    shown = [f"{name} ({count})" for name, count in list(counted.items())[:_LISTED]]
    more = f", and {len(counted) - _LISTED} more" * (len(counted) > _LISTED)
    return f"{len(counted)}: {', '.join(shown)}{more}"


def ledger(document: dict[str, Any]) -> TextTable:
    """The rows that were left out, and why."""
    rows = tuple((reason, str(count)) for reason, count in document["dropped"].items())
    return TextTable("", ("left out", "rows"), rows, left=1)

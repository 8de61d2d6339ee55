"""Car-following pairs: each row has a follower and the leader at one time."""

from pathlib import Path

import numpy as np

from sugiyama_ros.arrays import Array
from sugiyama_ros.formats.choices import Choices
from sugiyama_ros.formats.columns import (
    Rows,
    Take,
    about_file,
    fits,
    need,
    put_together,
    read_columns,
    rename,
    sheet_format,
    stacked,
    take,
    text_of,
)
from sugiyama_ros.formats.ngsim import CLASSES
from sugiyama_ros.formats.reading import shown_stem
from sugiyama_ros.formats.sheet import Sheet, sheet_of
from sugiyama_ros.trajectories.labels import Labels, same_label
from sugiyama_ros.trajectories.tracks import Tracks

# Columns of the kinds of pair files; those of the leader begin with ``leader_``.
_KINDS: tuple[dict[str, Take], ...] = (
    {
        "recording": take("run_no"),
        "vehicle": take("follower_id"),
        "leader_vehicle": take("leader_id"),
        "time_s": need("timestamp"),
        "s_m": need("xFollowerReal"),
        "leader_s_m": need("xLeaderReal"),
        "speed": take("vFollowerReal"),
        "leader_speed": take("vLeaderReal"),
        "gap_m": take("spacing"),
    },
    {
        "vehicle": need("vehicle_id"),
        "leader_vehicle": need("preceding"),
        "time_s": need("frame_id", factor=0.1),
        "s_m": need("local_y"),
        "leader_s_m": need("preceding_local_y"),
        "speed": take("v_vel"),
        "leader_speed": take("preceding_vel"),
        "d_m": take("local_x"),
        "length_m": take("v_length"),
        "leader_length_m": take("preceding_length"),
        "width_m": take("v_width"),
        "leader_width_m": take("preceding_width"),
        "class": take("v_class"),
        "leader_class": take("preceding_class"),
        "lane": take("lane_id"),
    },
    {
        "recording": take("Trajectory_ID"),
        "vehicle": take("ID_FAV"),
        "leader_vehicle": take("ID_LV"),
        "time_s": need("Time_Index"),
        "s_m": need("Pos_FAV"),
        "leader_s_m": need("Pos_LV"),
        "speed": take("Speed_FAV"),
        "leader_speed": take("Speed_LV"),
        "gap_m": take("Space_Gap", "Spatial_Gap"),
    },
)


def _read(sheet: Sheet, choices: Choices) -> Tracks:
    """Read pairs. A vehicle that follows in one pair and leads in another is one vehicle."""
    pair = read_columns(sheet, next(kind for kind in _KINDS if fits(sheet, kind)))
    rename(pair, "class", CLASSES)
    rename(pair, "leader_class", CLASSES)
    both = both_of(pair)
    both.setdefault("recording", same_label(len(np.asarray(both["s_m"])), shown_stem(sheet.path)))
    return put_together(both, about_file(sheet.path, leaders="given"), choices, "front")


def both_of(pair: Rows) -> Rows:
    """Rows of the followers and of the leaders, of rows that have both.

    pair: columns (R,) of the followers; those of the leaders begin with ``leader_``; perhaps ``gap_m`` [m], bumper to
    bumper; without names, there is one pair in each recording, ``follower`` and ``leader``.
    """
    rows = len(np.asarray(pair["s_m"]))
    if "vehicle" not in pair or "leader_vehicle" not in pair:
        pair["vehicle"], pair["leader_vehicle"] = same_label(rows, "follower"), same_label(rows, "leader")
    pair["leader_vehicle"] = _somebody(text_of(pair, "leader_vehicle"), np.asarray(pair["leader_s_m"]))
    if "gap_m" in pair and "length_m" not in pair:
        pair["leader_length_m"] = pair["length_m"] = _length(pair)
    if "leader_length_m" in pair:
        pair.setdefault("length_m", np.full(rows, np.nan))
    # Followers come first, so that the row with the leader stays where a vehicle has two.
    both: Rows = {"leader": _twice(pair["leader_vehicle"], Labels(np.full(rows, -1, np.int32), ()))}
    for name, column in pair.items():
        if name not in ("gap_m", "d_m", "leader") and not name.startswith("leader_"):
            own = np.full(rows, np.nan) if name.endswith("speed") else column
            both[name] = _twice(column, pair.get(f"leader_{name}", own))
    there = np.concatenate((np.ones(rows, dtype=bool), text_of(pair, "leader_vehicle").code >= 0))
    return {name: column[there] for name, column in both.items()}


def _somebody(leader: Labels, leader_s_m: Array) -> Labels:
    """The leaders; a number such as 0 without a place is nobody, but a vehicle may have the number 0."""
    gone = np.append([text in ("0", "-1") for text in leader.text], False)[leader.code]
    placed = np.isfinite(leader_s_m) & (leader_s_m != 0.0)
    return Labels(np.where(gone & ~placed, -1, leader.code).astype(np.int32), leader.text)


def _length(pair: Rows) -> Array:
    """Length [m] of the leader (R,), from the gap bumper to bumper."""
    # what becomes too large is no length
    with np.errstate(over="ignore", invalid="ignore"):
        length = np.asarray(pair["leader_s_m"]) - np.asarray(pair["s_m"]) - np.asarray(pair["gap_m"])
        return np.asarray(np.round(length, 2))


def _twice(follower: Array | Labels, leader: Array | Labels) -> Array | Labels:
    """A column for the followers and, below, for the leaders."""
    if isinstance(follower, Labels) and isinstance(leader, Labels):
        return stacked((follower, leader))
    return np.asarray(np.concatenate((np.asarray(follower), np.asarray(leader))), dtype=np.float64)


def _sheet(path: Path, head: bytes) -> Sheet | None:
    sheet = sheet_of(path, head)
    return sheet if sheet is not None and any(fits(sheet, kind) for kind in _KINDS) else None


FORMAT = sheet_format(
    name="pairs",
    suffixes=(".csv", ".parquet"),
    summary="car-following pairs, a follower and the leader in each row (FHWA, NGSIM pairs, unified FAV tables)",
    sheet_of=_sheet,
    read=_read,
    refusal="1: not the columns of pairs; say which is which with --format table --columns map.yaml",
)

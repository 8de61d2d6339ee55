"""The status line of the live page: where the recording is, or what the page waits for."""

import math
from html import escape

from sugiyama_ros.page.feed import Feed, Status

# Time [s] without a sample after which the source counts as silent.
_SILENT_S = 3.0


def status_line(status: Status, feed: Feed) -> str:
    """The status line as HTML."""
    if not feed.vehicles:
        waiting = "the first positions on /measured" if status.source else "a road on /road and positions on /measured"
        return (
            f"Waiting for {waiting}, in ROS domain {escape(status.domain)}. To feed this page, replay a file with"
            " <code>sugiyama live FILE</code>, or start <code>sugiyama run FILE -o run.mcap --rate 1</code> or nodes"
            f" with <code>ROS_DOMAIN_ID={escape(status.domain)}</code>."
        )
    total = f" of {status.total_s:.0f}" if status.total_s > 0.0 else ""
    if status.ended:
        state = "ended"
    elif status.silent_s > _SILENT_S:
        state = f"silent for {status.silent_s:.0f} s"
    else:
        state = "running"
    rate = "" if math.isnan(status.real_rate) or state != "running" else f", {status.real_rate:.1f} times real time"
    end = ""
    if status.ended:
        end = " Ctrl-C in the terminal ends the page."
        if status.recording:
            command = f"sugiyama report {status.recording} --open"
            end = f" Ctrl-C in the terminal closes the recording; <code>{escape(command)}</code> makes a report of it."
    return (
        f"<b>{escape(status.source or 'live source')}</b>: {status.time_s:.0f}{total} s, {state}{rate};"
        f" {len(feed.now)} vehicles on the road; ROS domain {escape(status.domain)}.{end}"
    )

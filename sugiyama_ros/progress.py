"""How long work reports its progress: functions that a caller hands in."""

from collections.abc import Callable

#: Called with how much is done, and how much there is in all.
OnProgress = Callable[[int, int], None]
#: Called with the name of the stage, how much of it is done, and how much there is in all.
OnStage = Callable[[str, int, int], None]

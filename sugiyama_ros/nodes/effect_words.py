"""Effects in words, for people at the live page."""

from collections.abc import Mapping

from sugiyama_ros.effects.effect import RecordingExtent
from sugiyama_ros.effects.registry import EFFECTS, effect

#: Name for people of each effect.
TITLES: Mapping[str, str] = {name: e.title for name, e in EFFECTS.items()}


def can_be_added(extent: RecordingExtent) -> dict[str, str]:
    """Effects that can be added while drivers are followed; each with what it is, and what its parameters mean."""
    names = [name for name, e in EFFECTS.items() if e.function is not None and e.starts(extent)]
    return {name: explained(name) for name in names}


def explained(name: str) -> str:
    """What an effect is, and what its parameters mean, in their units."""
    found = effect(name)
    means = [
        f"{p.name}{f' [{p.unit}]' if p.unit not in ('', '1') else ''}: {p.description.split(';')[0]}"
        for p in found.parameters
    ]
    text = f"{found.title}: {found.summary}. Strength: {'; '.join(means)}."
    return text.replace("^2", "²").replace("^3", "³")

"""Extensions that other packages bring, found by their entry points."""

from importlib.metadata import entry_points

#: Why an extension was left out, by the group and the name of its entry point.
FAILED: dict[tuple[str, str], str] = {}


def load(group: str, kind: type) -> dict[str, object]:
    """Load all extensions of one group. An extension that cannot be loaded is left out and noted in ``FAILED``.

    Parameters
    ----------
    group : str
        Group of entry points, such as ``sugiyama_ros.formats``.
    kind : type
        What every extension of the group must be an instance of.

    Returns
    -------
    dict
        Extensions by the name of their entry point, in alphabetical order.
    """
    found: dict[str, object] = {}
    for point in sorted(entry_points(group=group), key=lambda point: point.name):
        try:
            extension = point.load()
        except Exception as error:
            FAILED[group, point.name] = f"{point.value} cannot be loaded: {error!r}"
            continue
        if isinstance(extension, kind):
            found[point.name] = extension
        else:
            FAILED[group, point.name] = f"{point.value} is not a {kind.__name__}"
    return found

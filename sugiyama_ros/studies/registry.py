"""All studies: the built-in studies and the studies of other packages.

A study of another package is a ``Study`` behind an entry point of the group ``sugiyama_ros.studies``.
"""

from collections.abc import Mapping

from sugiyama_ros import plugins
from sugiyama_ros.studies.study import Study

#: Group of the entry points by which other packages add studies.
GROUP = "sugiyama_ros.studies"
#: Studies by name.
STUDIES: Mapping[str, Study] = plugins.registered(
    GROUP,
    Study,
    (
        "recovery",
        "lanes",
        "effects",
        "spectrum",
        "measured_drivers",
        "driver_types",
        "waves:SIMULATED",
        "waves:ROBUSTNESS",
        "waves:ABLATION",
        "waves:ONE_DRIVER",
        "waves:TADAKI",
        "waves:HIGHWAY",
        "order",
        "online",
        "style_change",
        "filters",
        "controlled",
        "beta_nash",
    ),
    "STUDY",
)


def study(name: str) -> Study:
    """Look up a study. Raises InputError, which lists the names, for an unknown one."""
    return plugins.find(STUDIES, GROUP, name, "study")

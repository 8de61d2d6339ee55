"""Every study, by name."""

from collections.abc import Mapping

from sugiyama_ros.errors import InputError
from sugiyama_ros.studies import driver_types, filters, measured_drivers, online, recovery, spectrum, what_if
from sugiyama_ros.studies.study import Study

STUDIES: Mapping[str, Study] = {
    study.name: study
    for study in (
        recovery.STUDY,
        spectrum.STUDY,
        measured_drivers.STUDY,
        driver_types.STUDY,
        *what_if.STUDIES,
        *online.STUDIES,
        filters.STUDY,
    )
}


def study(name: str) -> Study:
    """The study of that name. Raises InputError, which lists the names, for an unknown one."""
    if name not in STUDIES:
        raise InputError(f"study {name!r}: not known; the studies are {', '.join(STUDIES)}")
    return STUDIES[name]

"""Names that somebody may ask a diagnosis to add, checked before it reads anything."""

from collections.abc import Sequence

from sugiyama_ros.diagnosis.candidates import CONSTANTS
from sugiyama_ros.diagnosis.discover import FORCE, is_force
from sugiyama_ros.effects.discovered_force import COVARIATES
from sugiyama_ros.effects.registry import EFFECTS, MECHANISM
from sugiyama_ros.errors import InputError


def check_names(names: Sequence[str]) -> None:
    """Check that names are those of effects, of their forms, of groups of constants, or of forces without a name.

    Parameters
    ----------
    names : sequence of str
        The names.

    Raises
    ------
    InputError
        For a name that is none of them. The message lists what can be given.
    """
    constants = [one.name for one in CONSTANTS]
    for name in names:
        covariate = name.partition(":")[2]
        if is_force(name):
            if covariate and covariate not in COVARIATES:
                raise InputError(
                    f"{name}: a force along {covariate!r} cannot be added; give {FORCE}: and one of"
                    f" {', '.join(COVARIATES)}"
                )
        elif name not in (*EFFECTS, *MECHANISM.values(), *constants):
            raise InputError(
                f"effect {name!r}: is not known; give names that `sugiyama effects` lists, {', '.join(constants)}, or"
                f" {FORCE}:COVARIATE"
            )

"""Can one driver stop the waves?"""

from collections.abc import Callable

from sugiyama_ros.driver.parameters import KAPPA_V, V_STAR
from sugiyama_ros.studies.cases import compare
from sugiyama_ros.studies.rings import Ring, changed, estimated, site_of
from sugiyama_ros.studies.study import Answer, Asked, Study


def _answer(asked: Asked) -> Answer:
    """Make one driver slower, or much more cautious, than all others."""
    drivers, site = estimated(asked), site_of(asked.measured)._asdict()

    def with_one(place: int, value: float, jammed: bool) -> Callable[[int], Ring]:
        return lambda seed: Ring(changed(drivers, place, value, first_only=True), seed, jammed=jammed, **site)

    return compare(
        asked,
        {
            "as measured": lambda seed: Ring(drivers, seed, **site),
            "v* of one: 8 m/s": with_one(V_STAR, 8.0, False),
            "v* of one: 7 m/s": with_one(V_STAR, 7.0, False),
            "v* of one: 8 m/s, out of a jam": with_one(V_STAR, 8.0, True),
            "v* of one: 7 m/s, out of a jam": with_one(V_STAR, 7.0, True),
            "kappa_v of one: 2 s": with_one(KAPPA_V, 2.0, False),
        },
    )


STUDY = Study(
    name="one-driver",
    question="Can one driver stop the waves?",
    paper=(
        "8 m/s: not as easily; 7 m/s: much harder to form; a cautious driver changes nothing (sections 6.2.2, 6.2.3)."
    ),
    answer=_answer,
)

"""Do the estimated drivers make the measured waves?"""

from collections.abc import Callable
from dataclasses import replace

from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.check import collective_of
from sugiyama_ros.studies.cases import compare
from sugiyama_ros.studies.rings import FACTOR, FULL_NOISE_AT, PAPERS_FACTOR, Ring, alike, estimated, site_of
from sugiyama_ros.studies.study import Answer, Asked, Study


def _answer(asked: Asked) -> Answer:
    """Simulate the estimated drivers on the measured ring, from equal gaps and out of a jam."""
    site = site_of(asked.measured)._asdict()
    cases: dict[str, Callable[[int], Ring]] = {}
    full_at = asked.full_noise_at or FULL_NOISE_AT
    for factor, fading_at in ((PAPERS_FACTOR, 0.0), (FACTOR, 0.0), (PAPERS_FACTOR, full_at)):
        drivers = estimated(replace(asked, full_noise_at=fading_at), factor)
        law = f", whole from {fading_at:g} m/s on" if fading_at else ""
        for jammed, start in ((False, "equal gaps"), (True, "out of a jam")):

            def make(seed: int, drivers: Array = drivers, jammed: bool = jammed) -> Ring:
                return Ring(drivers, seed, jammed=jammed, **site)

            cases[f"{start}, sigma_a times {factor:g}{law}"] = make
    cases["paper's mean parameters, out of a jam"] = lambda seed: Ring(alike(), seed, jammed=True)
    answer = compare(asked, cases)
    measured = collective_of(asked.measured)
    of_measured = {
        "mean speed [m/s]": measured.mean_speed,
        "least [m/s]": measured.least_speed,
        "largest [m/s]": measured.largest_speed,
        "wave speed [m/s]": measured.wave_speed,
        "queue [cars]": measured.queue_vehicles,
    }
    return Answer(({"case": "measured, all of it", **of_measured}, *answer.rows), answer.draw)


STUDY = Study(
    name="simulated",
    question="Do the estimated drivers make the measured waves?",
    paper="Waves form by themselves; V_avg is 0.5 m/s too low, the queue a vehicle too long (section 6.1).",
    answer=_answer,
)

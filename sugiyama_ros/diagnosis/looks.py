"""What has been seen of the candidates, from round to round of a search."""

from collections.abc import Iterable, Sequence
from concurrent.futures import Executor

from sugiyama_ros.diagnosis.candidacy import LEAST_GAIN
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.prescreen import Prescreen, Promise, beyond_chance, prescreen, worth_screening
from sugiyama_ros.diagnosis.screen import Effort, Screened, forecast, screen, screen_again
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.progress import OnStage
from sugiyama_ros.workers import at_once

# Number of candidates that are screened again after the first round.
_LATER_LOOKS = 8


class Looks:
    """Prescreens and screens of candidates.

    Parameters
    ----------
    data : Recorded
        The recording.
    base : JointFit
        The fitted model beside which candidates are prescreened.
    work : Executor
        Runs the filters.
    effort : Effort
        Limits of the search.

    Attributes
    ----------
    prescreens : dict of str to Prescreen
        Prescreens beside ``base``, by the name of the candidate.
    left_out : list of Promise
        Candidates that were not screened in the first round.
    """

    def __init__(self, data: Recorded, base: JointFit, work: Executor, effort: Effort) -> None:
        self._data, self._base, self._work, self._effort = data, base, work, effort
        self.prescreens: dict[str, Prescreen] = {}
        self.left_out: list[Promise] = []
        self._seen: dict[str, tuple[JointFit, Screened]] = {}

    @property
    def is_first_round(self) -> bool:
        """Whether no candidate has been looked at yet."""
        return not self._seen

    def beside(self, current: JointFit) -> dict[str, Prescreen]:
        """Return the prescreens beside the current model, by the name of the candidate."""
        return self.prescreens if current is self._base else {}

    def copy(self) -> "Looks":
        """Return a copy that can be kept up to date by itself."""
        other = Looks(self._data, self._base, self._work, self._effort)
        other.prescreens, other._seen = self.prescreens, dict(self._seen)
        return other

    def forget(self) -> None:
        """Give up everything, which takes memory."""
        self.prescreens = {}
        self._seen = {}

    def keep(self, looks: Iterable[Screened], current: JointFit) -> None:
        """Keep looks beside the current model."""
        self._seen |= {look.candidate.name: (current, look) for look in looks}

    def worth_a_look(
        self, possible: Sequence[Candidate], current: JointFit, on_progress: OnStage
    ) -> Sequence[Candidate]:
        """Return the candidates that promise something: after a prescreen of each, or by what is known of them already.

        Parameters
        ----------
        possible : sequence of Candidate
            The candidates.
        current : JointFit
            The current model.
        on_progress : callable
            Called with the name of the stage, the number of steps done, and the number of all steps.

        Returns
        -------
        sequence of Candidate
            All that promise something in the first round, a few later.
        """
        if self.is_first_round:

            def at(candidate: Candidate) -> Prescreen:
                return prescreen(self._data, self._base, candidate, self._work)

            found = at_once(at, possible, "first screen", on_progress)
            self.prescreens = {one.candidate.name: one for one in found}
            chosen, self.left_out = worth_screening(self._data, self._base, self.prescreens, self._effort.refuted)
            return chosen

        def gain_of(candidate: Candidate) -> float:
            if candidate.name in self._seen:
                return forecast(self._data, *self._seen[candidate.name], current)
            return beyond_chance(self._data, current, self.prescreens[candidate.name])

        return sorted(possible, key=gain_of, reverse=True)[:_LATER_LOOKS]

    def look(self, candidate: Candidate, current: JointFit) -> Screened:
        """Screen a candidate from the end of an earlier look, or from the start if the earlier look leads nowhere."""
        before = self._seen.get(candidate.name)
        if before and before[1].gain > 0.0:
            again = screen_again(self._data, current, *before, self._work, self._effort)
            if again.gain > 0.0 or again.predicted_gain < LEAST_GAIN:
                return again
        seen = self.beside(current).get(candidate.name)
        return screen(self._data, current, candidate, self._work, self._effort, seen)

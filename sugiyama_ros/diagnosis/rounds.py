"""The results of a diagnosis: its rounds, and what they say together."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Literal

from sugiyama_ros.arguments import checked
from sugiyama_ros.arrays import Array
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.chance import Chance
from sugiyama_ros.diagnosis.check import Check
from sugiyama_ros.diagnosis.forecast import HORIZONS_S
from sugiyama_ros.diagnosis.score import Score
from sugiyama_ros.diagnosis.table import Difference, Entry, errors
from sugiyama_ros.diagnosis.where import Located
from sugiyama_ros.fit.model_file import write_model
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.results import Result, bars, plain, to_json
from sugiyama_ros.statistics import ALPHA

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

#: What the diagnosis concludes.
Outcome = Literal["adequate", "explained", "not_explained"]


@dataclass(frozen=True, eq=False)
class Round:
    """One round: what was scored and fitted beside a model, and what was added to it.

    current: The model at the beginning of the round; scores: The best score of each mechanism, the most improbable
    one first; chance: What chance gives; gains: The models that were fitted, the best one first, with their gains over
    the current model, by column; added: The model to go on with; None if no model is clearly better; gain: What it
    gains on unseen data, by column; is_better: Whether it is better on unseen data; alike: Models that cannot be told
    apart from the one that was added; closest_effect: The best one of the effects with a physical name, and how far it
    is behind the model at the end of the round.
    """

    current: Entry
    scores: tuple[Score, ...]
    chance: Chance
    gains: dict[Entry, dict[str, Difference]]
    added: Entry | None
    gain: dict[str, Difference]
    is_better: bool = False
    alike: tuple[Entry, ...] = ()
    closest_effect: tuple[str, Difference] | None = None

    @property
    def after(self) -> Entry:
        """The model at the end of the round."""
        return self.added or self.current

    @property
    def new(self) -> tuple[Candidate, ...]:
        """What was added."""
        return tuple(c for c in self.after.added if c not in self.current.added)

    @property
    def is_supported(self) -> bool:
        """Whether the data ask for what was added: chance rarely shows as much, and unseen data are forecast better."""
        rare = all(self.chance.p_values.get(c.mechanism, 1.0) < ALPHA for c in self.new)
        return rare and self.is_better


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Result):
    """The diagnosis of a recording, in numbers.

    Parameters
    ----------
    data : Recorded
        The recording.
    searched : Recorded
        The drivers that were searched: all of them, or some of many.
    rounds : tuple of Round
        What was scored, fitted and added, in order.
    base, final : Entry
        The model without and with the additions.
    laws : tuple of Entry
        Other car-following laws on the same samples, but those that are far behind.
    floor : dict of str to float
        Errors of the final model on recordings that it simulates itself, which are noise alone.
    checks : tuple of Check
        Where the final model is compared with what was measured.
    where_before, where_after : Located
        Where the base model and the final model fail.
    driven_before, driven_after : ndarray, shape (T, N)
        Positions [m] of free runs through each block of time with both models.
    stds : dict of str to float
        Standard errors of the shared parameters of the final model, by name.
    smallest : tuple of dict
        Strengths from which effects would have shown: ``name``, ``parameter`` and ``value``.
    asked : tuple of str
        Names that somebody asked to add; empty for a search.
    simulations : int
        Number of recordings that each model simulates.
    seed : int
        Seed of the simulations and of the draws by chance.
    wall_s : float
        Time that the diagnosis took [s].
    """

    data: Recorded
    searched: Recorded
    rounds: tuple[Round, ...]
    base: Entry
    final: Entry
    laws: tuple[Entry, ...]
    floor: dict[str, float]
    checks: tuple[Check, ...]
    where_before: Located
    where_after: Located
    driven_before: Array
    driven_after: Array
    stds: dict[str, float]
    smallest: tuple[dict[str, Any], ...]
    asked: tuple[str, ...]
    simulations: int
    seed: int
    wall_s: float

    @property
    def steps(self) -> tuple[Round, ...]:
        """The rounds that have added something, in order."""
        return tuple(one for one in self.rounds if one.added is not None)

    @property
    def outcome(self) -> Outcome:
        """What the table and the checks say together. Freed constants and noises explain nothing."""
        if any(one.failed for one in self.checks):
            return "not_explained"
        supported = [c for step in self.steps if step.is_supported for c in step.new]
        if not supported:
            return "adequate"
        return "explained" if any(c.explains for c in supported) else "not_explained"

    def headline(self) -> str:
        """Say what the diagnosis concludes."""
        return self._sentences()[0]

    def summary(self) -> str:
        """Return the verdict in words, one line for each finding, as the command line prints it."""
        return "\n".join(self._sentences())

    def _sentences(self) -> list[str]:
        from sugiyama_ros.page.document import document
        from sugiyama_ros.page.words import sentences

        return sentences(plain(document(self)))

    def records(self) -> list[dict[str, Any]]:
        """List the candidates of the first round, the best one first: gains [nats] and p-value."""
        from sugiyama_ros.page.document import document

        found: list[dict[str, Any]] = plain(document(self))["candidates"]
        return found

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw the held-out gains of the candidates, and the errors of free runs before and after."""
        left, right = figure.subplots(1, 2)
        best = [r for r in self.records() if r["heldout_gain_nats"] is not None][:12]
        names, won = [r["name"] for r in best], [r["heldout_gain_nats"] for r in best]
        bars(left, names, won, [r["heldout_gain_se"] for r in best], "held-out gain [nats]")
        runs = "free_run" if self.data.vicinity.is_whole_road else "single_car"
        for label, entry in (("before", self.base), ("after", self.final)):
            found = errors(entry.forecasts)
            values = [0.0, *(found[f"{runs}_{h:g}s_m"] for h in HORIZONS_S)]
            right.plot([0.0, *HORIZONS_S], values, "o-", label=label)
        right.set(xlabel="time ahead [s]", ylabel="error of free runs [m]", ylim=(0.0, None))
        right.legend()

    @checked()
    def save(self, path: str | Path) -> None:
        """Write the diagnosis to a file.

        Parameters
        ----------
        path : str or Path
            ``.yaml`` for a model file with what was added; ``.json`` for the whole document, as ``sugiyama report
            --diagnosis`` reads it; ``.csv`` for the candidates, ``.png`` and ``.pdf`` for the picture.

        Raises
        ------
        InputError
            For another suffix, or a library that is not installed.
        OutputError
            If the file cannot be written.
        """
        if Path(path).suffix == ".yaml":
            from sugiyama_ros.page.document import document
            from sugiyama_ros.page.words import cautions

            write_model(Path(path), self.data, self.final.fit, cautions(plain(document(self))))
            return
        super().save(path)

    def _save_json(self, stream: BinaryIO, _: str) -> None:
        from sugiyama_ros.page.document import document

        stream.write((to_json(document(self), indent=2) + "\n").encode())

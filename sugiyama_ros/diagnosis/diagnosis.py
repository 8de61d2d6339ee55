"""A diagnosis: what is missing from the model, where the model fails, and how it compares with other laws."""

import json
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from sugiyama_ros.diagnosis.addition import Addition
from sugiyama_ros.diagnosis.adequacy import Adequacy, told
from sugiyama_ros.diagnosis.bootstrap import widened
from sugiyama_ros.diagnosis.candidacy import Candidacy
from sugiyama_ros.diagnosis.candidates import Candidate
from sugiyama_ros.diagnosis.chance import widening
from sugiyama_ros.diagnosis.decisions import Searched, searched_with_decisions
from sugiyama_ros.diagnosis.discover import Discovery
from sugiyama_ros.diagnosis.errors import HeldOutErrors
from sugiyama_ros.diagnosis.free_runs import HORIZONS_S
from sugiyama_ros.diagnosis.judging import judged
from sugiyama_ros.diagnosis.law_check import closer_laws
from sugiyama_ros.diagnosis.locate import Located, locate
from sugiyama_ros.diagnosis.orders import grown
from sugiyama_ros.diagnosis.placing import profiled
from sugiyama_ros.diagnosis.prescreen import Promise
from sugiyama_ros.diagnosis.refits import added_to_all, refits
from sugiyama_ros.diagnosis.rival_fits import RivalErrors, start_rivals
from sugiyama_ros.diagnosis.search import Search
from sugiyama_ros.diagnosis.use import ANYTHING, Goal
from sugiyama_ros.fit.cross_validation import Gain
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.model_file import write_model
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.laws.registry import LAWS
from sugiyama_ros.plots import bars
from sugiyama_ros.progress import OnStage
from sugiyama_ros.results import Result, plain
from sugiyama_ros.trajectories.tracks import Tracks
from sugiyama_ros.trajectories.trajectories import Trajectories
from sugiyama_ros.workers import here_or_there

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Number of other laws that are fitted at the same time beside the search, which has work of its own: more take memory.
_ASIDE = 1


@dataclass(frozen=True, eq=False, repr=False)
class Diagnosis(Result):
    """The diagnosis of a recording.

    Parameters
    ----------
    data : Recorded
        The recording.
    base, final : JointFit
        The fitted model without and with the additions.
    named : tuple of Addition
        The additions, in order.
    scored : tuple of Candidacy
        Candidates of the first round, the best one first, without their fits.
    heldout : dict of str to Gain
        Held-out gains of these candidates, by name.
    left_out : tuple of Promise
        Candidates that promised too little in the first round to be fitted.
    discovered : tuple of Discovery
        Forces without a name.
    before, after : HeldOutErrors
        Held-out errors of ``base`` and of ``final``.
    where_before, where_after : Located
        Where ``base`` and ``final`` fail.
    smallest : dict of str to float
        Strength from which each effect would usually have shown, by name.
    refused : tuple of (str, tuple of str)
        Candidates that were not added because of what the model is for, or because their values make no sense, and why.
    rivals : dict of str to dict
        Held-out errors of other laws, by name. Where there are many drivers, a quick diagnosis fits a law to some of
        them only, and less closely to a few if it is far behind. Their number then stands beside the errors as
        ``drivers``.
    closer : dict of str to float
        Errors after 10 s [m] of the laws whose free runs end clearly closer than those of ``final``, the smallest
        first.
    floor : dict of str to dict
        Errors of ``final`` on recordings that it simulates, under the name ``floor``: no model can do better.
    adequacy : Adequacy
        Whether the data give reason to doubt ``final``.
    stds : mapping of str to float
        Standard errors of the shared parameters of ``final``, by name.
    searched : tuple of str
        Names of the candidates that were searched for.
    asked : tuple of str
        Names that somebody asked to add; empty for a search.
    bootstrap_runs : int
        Largest number of simulated recordings on which a p-value rests.
    refitted : int
        Number of simulated recordings to which the final model was fitted from nothing.
    quick : bool
        Whether the diagnosis took shortcuts.
    seed : int
        Seed of the simulated recordings.
    wall_s : float
        Time that the diagnosis took [s].
    """

    data: Recorded
    base: JointFit
    final: JointFit
    named: tuple[Addition, ...]
    scored: tuple[Candidacy, ...]
    heldout: dict[str, Gain]
    left_out: tuple[Promise, ...]
    discovered: tuple[Discovery, ...]
    before: HeldOutErrors
    after: HeldOutErrors
    where_before: Located
    where_after: Located
    smallest: dict[str, float]
    refused: tuple[tuple[str, tuple[str, ...]], ...]
    rivals: dict[str, dict[str, float]]
    closer: dict[str, float]
    floor: dict[str, dict[str, float]]
    adequacy: Adequacy
    stds: Mapping[str, float]
    searched: tuple[str, ...]
    asked: tuple[str, ...]
    bootstrap_runs: int
    refitted: int
    quick: bool
    seed: int
    wall_s: float

    def headline(self) -> str:
        """Say what was added to the model, and how much better the model predicts with it."""
        if not self.named:
            found = "nothing that is missing can be detected in these data"
        else:
            parts = [f"{n.name} (+{n.heldout.nats:.0f} ± {n.heldout.se:.0f} nats held out)" for n in self.named]
            found = "missing from the model: " + ", ".join(parts)
        return f"{found}. {told(self.adequacy)}" if self.adequacy.reasons else found

    def records(self) -> list[dict[str, Any]]:
        """List the candidates of the first round, the best one first: gains [nats], p-value, whether it was added."""
        added = {n.name for n in self.named}
        found = [one for one in self.scored if one.candidate.name in self.heldout]
        return [
            {
                "name": one.candidate.name,
                "kind": one.candidate.kind,
                "added": one.candidate.name in added,
                "heldout_gain_nats": self.heldout[one.candidate.name].nats,
                "heldout_gain_se": self.heldout[one.candidate.name].se,
                "gain_nats": one.gain,
                "p_value": one.p_value,
            }
            for one in sorted(found, key=lambda one: -self.heldout[one.candidate.name].nats)
        ]

    def draw(self, figure: "Figure") -> None:
        """Draw the held-out gains of the candidates, and the errors of free runs before and after."""
        left, right = figure.subplots(1, 2)
        best = self.records()[:12]
        names, gains = [r["name"] for r in best], [r["heldout_gain_nats"] for r in best]
        bars(left, names, gains, [r["heldout_gain_se"] for r in best], "held-out gain [nats]")
        for label, errors in (("before", self.before), ("after", self.after)):
            summary = errors.summary()
            runs = "free_run" if self.data.vicinity.is_whole_road else "single_car"
            values = [0.0, *(summary[f"{runs}_{h:g}s_m"] for h in HORIZONS_S)]
            right.plot([0.0, *HORIZONS_S], values, "o-", label=label)
        right.set(xlabel="time ahead [s]", ylabel="error of free runs [m]", ylim=(0.0, None))
        right.legend()

    def summary(self) -> str:
        """Return the verdict in words, one line for each finding, as the command line prints it.

        Returns
        -------
        str
            The lines.
        """
        from sugiyama_ros.diagnosis.verdict import sentences

        return "\n".join(sentences(self))

    def cautions(self) -> tuple[str, ...]:
        """Return what a user of the final model must know, in words: where it does worse than the base model."""
        return tuple(one for addition in self.named[-1:] for one in addition.worse)

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
            For another suffix.
        OutputError
            If the file cannot be written.
        """
        if Path(path).suffix in (".yaml", ".yml"):
            write_model(Path(path), self.data, self.final, self.cautions())
        else:
            super().save(path)

    def _save_json(self, stream: BinaryIO, _: str) -> None:
        from sugiyama_ros.diagnosis.verdict import document

        stream.write((json.dumps(plain(document(self)), indent=2, allow_nan=False) + "\n").encode())


def diagnose(
    recording: Trajectories | Tracks,
    *,
    seed: int = 0,
    quick: bool = False,
    verdict_only: bool = False,
    goal: Goal = ANYTHING,
    refit: int | None = None,
    workers: int | Executor = 4,
    on_progress: OnStage = lambda what, done, total: None,
) -> Diagnosis:
    """Find what is missing from the model.

    Parameters
    ----------
    recording : Trajectories or Tracks
        The recording: a whole road, or tracks of vehicles that come and go.
    seed : int
        Seed of the simulated recordings.
    quick : bool
        Whether to take shortcuts: fewer simulations, no search for each fold.
    verdict_only : bool
        Whether to leave out the rivals and the forces without a name.
    goal : Goal
        What may be added, and what the model is for.
    refit : int
        Number of fits from nothing to simulated recordings, for the standard errors; 6 or, if ``quick``, 2 by default,
        but none unless names explain the data.
    workers : int or Executor
        Number of threads; or the executor of a Dask cluster, whose workers then fit the other laws.
    on_progress : callable
        Called with the name of the stage, the number of steps done, and the number of all steps.

    Returns
    -------
    Diagnosis
        The verdict with everything that it rests on.

    Raises
    ------
    InputError
        If the recording is too short.
    """
    began = time.monotonic()
    with here_or_there(workers) as (work, cluster), ThreadPoolExecutor(_ASIDE) as aside:
        on_progress("fitting the base model", 0, 1)

        def searched(data: Recorded, base: JointFit) -> Searched:
            begun = Search(data, base, quick, seed, work, goal=goal, on_progress=on_progress)
            # runs beside the search, which cannot always use all workers
            to_beat = begun.before if quick else None
            others = [] if verdict_only else start_rivals(data, to_beat, work, cluster or aside)
            return _carried_out(begun, goal.most, goal.forces and not verdict_only), others

        search, others = searched_with_decisions(searched, recording, work, on_progress)
        on_progress("rival models", 0, 1)
        rivals = {name: one for found in others for name, one in found.result().items()}
        on_progress("finding where the model fails", 0, 1)
        return _summed_up(search, rivals, refit, work, began, on_progress)


def _carried_out(search: Search, most: int, add_forces: bool) -> Search:
    """A search at its end; or with what was asked for, and nothing else."""
    for name in search.asked:
        search.add_asked(name)
    return search if search.asked else grown(search, most, add_forces=add_forces)


def _summed_up(
    search: Search,
    rivals: dict[str, RivalErrors],
    refit: int | None,
    work: ThreadPoolExecutor,
    began: float,
    on_progress: OnStage,
) -> Diagnosis:
    """The diagnosis at the end of a search; ``began``: start on the monotonic clock [s]."""
    # with empty samples in between, the filters approximate more than one simulation tells
    if not search.named and not search.data.is_sparse:
        search.compare_all()
    search.forget()
    compared = ((search.base, search.before), (search.current, search.errors))
    where_before, where_after = (locate(search.data, one.model, e.samples, work) for one, e in compared)
    laws = {name: one.errors for name, one in rivals.items() if name in LAWS and not one.is_far}
    found = judged(search, where_after, laws, work)
    effects = added_to_all(search.data, search.named)
    refitted = _refitted(search, effects, found.adequacy, refit, work, on_progress)
    stds = widened(found.evidence.stds, search.current, refitted, widening(len(refitted)))
    return Diagnosis(
        data=search.data,
        base=search.base,
        final=search.current,
        named=tuple(search.named),
        scored=tuple(search.scored),
        heldout=search.heldout,
        left_out=tuple(search.left_out),
        discovered=tuple(found.evidence.forces),
        before=search.before,
        after=search.errors,
        where_before=where_before,
        where_after=where_after,
        smallest=search.smallest,
        refused=(*search.refused, *((name, _senseless(why)) for name, why in search.senseless.items())),
        rivals={name: one.summary(len(search.errors.predicted_drivers)) for name, one in rivals.items()},
        closer=closer_laws(search.errors, laws),
        floor={"floor": found.floor},
        adequacy=found.adequacy,
        stds=profiled(search.data, search.current, effects, stds, work),
        searched=search.searched,
        asked=search.asked,
        bootstrap_runs=search.runs,
        refitted=len(refitted),
        quick=search.quick,
        seed=search.seed,
        wall_s=time.monotonic() - began,
    )


def _senseless(why: Sequence[str]) -> tuple[str]:
    """Why a candidate was not added whose best values make no sense."""
    return (f"its best values make no physical sense: {', '.join(why)}",)


def _refitted(
    search: Search,
    effects: Sequence[Candidate],
    adequacy: Adequacy,
    refit: int | None,
    work: ThreadPoolExecutor,
    on_progress: OnStage,
) -> list[JointFit]:
    """Fits from nothing to simulated recordings: as many as asked for, else only if the names explain the data."""
    runs = (search.effort.refits if adequacy.outcome == "explained" else 0) if refit is None else refit
    return refits(search.data, search.current, effects, search.seed, runs, work, on_progress)

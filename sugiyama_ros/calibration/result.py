"""The settings and the result of a calibration. The result becomes a document, a table or a model file."""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

import numpy as np

from sugiyama_ros.arguments import checked
from sugiyama_ros.arrays import Array, Mask
from sugiyama_ros.driver.parameters import COUNT, index
from sugiyama_ros.effects.registry import EFFECTS, ROW
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Target
from sugiyama_ros.fit.coordinates import has_both_ends
from sugiyama_ros.fit.driver import SIGMAS, Fit, Formulation, is_determined
from sugiyama_ros.fit.driver_types import OF_RECORDING, Classes, DriverTypes, Population, Predictions
from sugiyama_ros.fit.goals import Goal, KnownGoals
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.laws.registry import PAPERS, law
from sugiyama_ros.results import BLUE, Result, TextTable, counted, plain
from sugiyama_ros.results import figure as in_words
from sugiyama_ros.trajectories.about import About
from sugiyama_ros.trajectories.dense import DenseTracks

if TYPE_CHECKING:
    from matplotlib.figure import Figure, SubFigure

#: Instead of a number of classes: the number that predicts held-out drivers best; the classes of the vehicles.
AUTO, VEHICLE = "auto", "vehicle"
#: Largest number of classes.
MOST_CLASSES = 20
# Values below this one are written with three digits that count.
_SMALL = 0.01
_VAGUE, _NOT_IDENTIFIED = "(not identified)", "not identified"


@dataclass(frozen=True)
class Settings:
    """What a calibration estimates, and how it searches.

    estimated: names of parameters; empty for those that suit the recording; is_regularised: causal: drivers are draws
    from one population, paper: with the paper's penalty; None: causal and on tracks only; profiled: whether intervals
    come from the profile likelihood; effects: names of effects that are fitted, too; classes: number of classes of
    drivers who share all parameters, 0 for none; ``AUTO`` for the number that predicts held-out drivers best;
    ``VEHICLE`` for the classes of the vehicles; goals: what drivers may intend besides driving through.
    """

    formulation: Formulation = "causal"
    estimated: tuple[str, ...] = ESTIMATED
    is_regularised: bool | None = None
    profiled: bool = False
    seed: int = 0
    law: str = PAPERS
    effects: tuple[str, ...] = ()
    classes: int | str = 0
    goals: tuple[Goal, ...] = ()

    def is_pooled(self, on_tracks: bool) -> bool:
        """Whether all drivers are calibrated together, as draws from one population."""
        wanted = on_tracks and not self.profiled if self.is_regularised is None else self.is_regularised
        return bool(self.effects) or self.law != PAPERS or (wanted and self.formulation == "causal")

    def check_classes(self, drivers: int, source: str) -> None:
        """Raise InputError for more classes than drivers."""
        if isinstance(self.classes, int) and drivers < self.classes:
            raise InputError(
                f"{source}: {counted(drivers, 'driver')}, {self.classes} classes; give --classes {drivers} at most"
            )

    def check(self, option: Callable[[str], str] = str) -> None:
        """Raise InputError for settings that contradict each other; ``option`` writes the name of one for the user."""
        effects, regularise, profile = option("effects"), option("regularise"), option("profile")
        is_paper = self.formulation == "paper"
        if self.formulation not in ("paper", "causal"):
            raise InputError(f"{option('formulation')}: {self.formulation!r} is not known; give paper or causal")
        if self.seed < 0:
            raise InputError(f"{option('seed')}: {self.seed} is not possible; give 0 or more")
        if self.seed and not (self.classes or self.goals):
            raise InputError(f"{option('seed')}: only classes and goals are searched at random; leave it out")
        for name, is_given in (
            ("effects", bool(self.effects)),
            ("law", self.law != PAPERS),
            ("classes", bool(self.classes)),
            ("goal", bool(self.goals)),
        ):
            if is_given and is_paper:
                raise InputError(f"{option(name)}: the paper's formulation knows none; use the causal formulation")
        number_of_classes(self.classes, option)
        law(self.law)
        for name in self.effects if self.law != PAPERS else ():
            if name in EFFECTS and EFFECTS[name].acts_on_preferences:
                raise InputError(
                    f"{effects}: {name} acts on the preferences of {PAPERS}, and {self.law} has none; leave out"
                    f" {name} or {option('law')}"
                )
        if self.law != PAPERS and self.estimated:
            raise InputError(
                f"{option('parameters')}: with a law, its parameters, sigma_nu and sigma_a are estimated; leave it out"
            )
        for name, is_given in (("law", self.law != PAPERS), ("effects", bool(self.effects))):
            if is_given and self.is_regularised is False:
                raise InputError(
                    f"{regularise}: cannot be off with {option(name)}, which calibrates all drivers together; leave"
                    " out one of the two"
                )
        pooled = {effects: self.effects, option("law"): self.law != PAPERS, regularise: self.is_regularised}
        others = [name for name, is_given in pooled.items() if is_given]
        if others and self.profiled:
            raise InputError(
                f"{profile}: is for drivers calibrated one by one; leave it out, or {' and '.join(others)}"
            )
        if (self.classes or self.goals) and (others or self.profiled):
            shared, others = option("classes" if self.classes else "goal"), others or [profile]
            raise InputError(
                f"{shared}: the drivers of a class share all parameters; leave it out, or {' and '.join(others)}"
            )
        if (self.classes or self.goals) and self.estimated and {index(n) for n in self.estimated} <= set(OF_RECORDING):
            raise InputError(
                f"{option('parameters')}: {', '.join(self.estimated)}: noises belong to a recording, not to a class;"
                " add a parameter of how drivers drive, such as v_star"
            )


def number_of_classes(given: object, option: Callable[[str], str] = str) -> int | str:
    """Read a number of classes, ``AUTO`` or ``VEHICLE``. Raises InputError."""
    if given in (AUTO, VEHICLE):
        return str(given)
    try:
        count = int(str(given))
    except ValueError:
        count = -1
    if not 0 <= count <= MOST_CLASSES:
        name = option("classes")
        raise InputError(
            f"{name}: {given} is not possible; give a number of classes, {MOST_CLASSES} and as many as there are"
            f" drivers at most, {AUTO}, {VEHICLE}, or 0 for none"
        )
    return count


@dataclass(frozen=True)
class CalibratedDriver:
    """Who drives, and what tracks say of the driver; texts are empty, and numbers NaN or 0, where they do not.

    vehicle: number of the vehicle, or its name where that is no number; number: number of the vehicle in model files;
    leader_class: class of the vehicle ahead most of the time; stretches, following_s: stretches and time [s] that
    count; nis: mean of the squared normalised innovations, which is 1 for a filter that knows its own errors.
    """

    vehicle: int | str
    number: int
    recording: str = ""
    vehicle_class: str = ""
    leader_class: str = ""
    stretches: int = 0
    following_s: float = math.nan
    nis: float = math.nan

    @property
    def shown(self) -> str:
        """Name in tables."""
        return f"{self.recording} {self.vehicle}".strip()


@dataclass(frozen=True)
class ClassMedians:
    """Medians of the drivers of a class, or of a class behind another class; none of what is identified for nobody."""

    vehicle_class: str
    leader_class: str | None
    drivers: int
    medians: Mapping[str, float | None]

    @property
    def shown(self) -> str:
        """Name in tables."""
        own = self.vehicle_class or "all"
        return own if self.leader_class is None else f"{own} behind {self.leader_class or 'unknown'}"


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Result):
    """N calibrated drivers, in the order of the vehicles.

    Parameters
    ----------
    settings : Settings
        What was estimated, and how.
    drivers : tuple of CalibratedDriver
        Who drives.
    rows : ndarray, shape (N, width)
        Row of each driver, at the reference period and in the declared units.
    std : tuple of dict of str to float
        Standard deviations of each driver's estimated parameters, by name, in the declared units.
    identified : tuple of dict of str to bool
        Whether the data determine each driver's estimated parameters, by name.
    interval : ndarray, shape (N, P, 2) or (N, width, 2)
        Ends of the 95 % intervals of the first P entries of a row, which are the paper's parameters, or of all. An end
        that the data do not set, because a bound of the search comes first, is infinite, or 0 towards 0.
    log_likelihood : ndarray, shape (N,)
        Log-likelihood of each driver [nats], without the 2 pi term.
    about : About
        Where the recording comes from.
    road : DenseTracks, optional
        The recording, if it is one lane on which everybody is present.
    shared_std : mapping of str to float
        Standard deviations of the parameters that all drivers share, by name.
    classes : Classes, optional
        Classes of drivers, if the drivers were divided into classes.
    population : Population, optional
        Of which population the drivers are draws.
    held_out : tuple of Predictions
        How well classes and a population predict drivers whom they were not fitted to, if that was asked for.
    """

    settings: Settings
    drivers: tuple[CalibratedDriver, ...]
    rows: Array
    std: tuple[dict[str, float], ...]
    identified: tuple[dict[str, bool], ...]
    interval: Array
    log_likelihood: Array
    about: About
    road: DenseTracks | None = None
    shared_std: Mapping[str, float] | None = None
    classes: Classes | None = None
    population: Population | None = None
    held_out: tuple[Predictions, ...] = ()

    @property
    def vehicle_classes(self) -> tuple[ClassMedians, ...]:
        """Medians of each class of vehicles."""
        return medians_of([(d.vehicle_class, None) for d in self.drivers], self.rows, self.identified)

    @property
    def pairs(self) -> tuple[ClassMedians, ...]:
        """Medians of each class of vehicles behind each class."""
        return medians_of([(d.vehicle_class, d.leader_class) for d in self.drivers], self.rows, self.identified)

    def write(self, target: Target) -> None:
        """Write a model file. Raises OutputError."""
        # Imported here: a calibration that is only printed starts sooner without the code of joint fits.
        from sugiyama_ros.fit.model_file import FittedDrivers, write_drivers

        origin = [d.number for d in self.drivers], self.about.source, self.about.sha256
        found = FittedDrivers(*origin, self.rows, self.std, self.shared_std or {}, float(self.log_likelihood.sum()))
        found = found._replace(names=[d.shown for d in self.drivers])
        types = None if self.classes is None else DriverTypes(self.classes.share, self.classes.rows[:, :COUNT])
        write_drivers(target, found, types, self.population, self._goals())

    def _goals(self) -> KnownGoals | None:
        """The goals, with the shares of the drivers who have them."""
        if self.classes is None or not self.settings.goals:
            return None
        share = dict(zip(self.classes.goals, self.classes.goal_probability.mean(axis=0).tolist(), strict=True))
        return KnownGoals(self.settings.goals, {one.name: share[one.name] for one in self.settings.goals})

    def headline(self) -> str:
        """Say how many drivers were calibrated, and for how many of them each parameter is identified."""
        held = ", ".join(f"{n} of {sum(one[n] for one in self.identified)}" for n in self.settings.estimated)
        total = f"{self.settings.formulation} formulation, log-likelihood {self.log_likelihood.sum():.1f}"
        return f"{counted(len(self.rows), 'driver')}, {total}; identified: {held}"

    def records(self) -> list[dict[str, Any]]:
        """List the drivers.

        Each record has the vehicle and the log-likelihood; on tracks also the recording, the class, the stretches, the
        time [s] that counts and the mean of the squared normalised innovations. For each estimated parameter it has the
        value, the standard deviation, the ends of the 95 % interval, and whether the parameter is identified. With
        classes and goals it has the probability of each.
        """
        records = []
        for number, (driver, d) in enumerate(zip(self.drivers, self._drivers(), strict=True)):
            one = self._who(driver)
            for name in self.settings.estimated:
                low, high = d["interval"][name]
                one |= {name: d[name], f"{name}_std": d["std"][name], f"{name}_low": low, f"{name}_high": high}
                one[f"{name}_identified"] = d["identified"][name]
            records.append(one | self._belongs(number) | {key: d[key] for key in ("log_likelihood", "nis") if key in d})
        return records

    def _belongs(self, number: int) -> dict[str, float]:
        """Probability of each class, and of each goal, of a driver; empty if there is one only."""
        if self.classes is None:
            return {}
        names = self.classes.names or [f"class {k}" for k in range(len(self.classes.share))]
        found = dict(zip(names, self.classes.probability[number].tolist(), strict=True)) if len(names) > 1 else {}
        goals = dict(zip(self.classes.goals, self.classes.goal_probability[number].tolist(), strict=True))
        return found | (goals if self.settings.goals else {})

    def draw(self, figure: "Figure | SubFigure") -> None:
        """Draw each estimated parameter with its standard deviation, by vehicle; on tracks, over the time that counts.

        A parameter that is not identified is an open circle.
        """
        names, rows = self.settings.estimated, self._drivers()
        place = range(len(rows)) if self.road is not None else [d.following_s for d in self.drivers]
        for axes, name in zip(figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0], names, strict=True):
            for at, d in zip(place, rows, strict=True):
                held = d["identified"][name]
                spread = d["std"][name] if held else None
                axes.errorbar(at, d[name], yerr=spread, fmt="o", color=BLUE, mfc=BLUE if held else "none", ms=4)
            axes.set(ylabel=ROW.heading(name))
        if self.road is not None:
            axes.set_xticks(place, [d.shown for d in self.drivers])
        axes.set(xlabel="vehicle" if self.road is not None else "following [s]")

    @checked()
    def save(self, path: str | Path) -> None:
        """Write the calibration to a file.

        Parameters
        ----------
        path : str or Path
            ``.yaml`` for a model file, ``.json`` and ``.csv`` for the records, ``.png`` and ``.pdf`` for the picture.

        Raises
        ------
        InputError
            For any other suffix.
        OutputError
            If the file cannot be written.
        """
        if Path(path).suffix in (".yaml", ".yml"):
            self.write(Path(path))
        else:
            super().save(path)

    def document(self, wall_s: float) -> dict[str, Any]:
        """Collect all results in plain types and SI units, for ``--json``; what is infinite is None.

        wall_s: time [s] that the calibration took.
        """
        drivers = self._drivers()
        document: dict[str, Any] = {
            "formulation": self.settings.formulation,
            "law": self.settings.law,
            "drivers": drivers,
            "effects": self._shared(),
            "log_likelihood": float(self.log_likelihood.sum()),
            "wall_s": wall_s,
        }
        if self.classes is not None:
            document["classes"] = _classes_of(self.classes, self.settings.estimated)
            for driver, probability in zip(drivers, self.classes.probability.tolist(), strict=True):
                driver["class_probability"] = probability
            if self.settings.goals:
                names, shares = self.classes.goals, self.classes.goal_share.tolist()
                document["goals"] = {
                    lane: dict(zip(names, share, strict=True))
                    for lane, share in zip(self.classes.entries, shares, strict=True)
                }
                for driver, probability in zip(drivers, self.classes.goal_probability.tolist(), strict=True):
                    driver["goal_probability"] = dict(zip(names, probability, strict=True))
        if self.population is not None:
            document["population"] = self.population.document()
        if self.held_out:
            document["held_out_drivers"] = [one.document(self.held_out[0]) for one in self.held_out]
        if self.road is None:
            document |= {
                "vehicle_classes": {one.vehicle_class: one.medians for one in self.vehicle_classes},
                "class_pairs": [
                    {"class": p.vehicle_class, "leader_class": p.leader_class, "drivers": p.drivers, **p.medians}
                    for p in self.pairs
                ],
            }
        return plain(document)  # type: ignore[no-any-return]

    def table(self) -> TextTable:
        """Make a table of each driver's parameters with their uncertainty, and of means or medians over drivers.

        A parameter that is not identified has no value, and is not in the mean.
        """
        names, on_tracks = self.settings.estimated, self.road is None
        has_classes = any(driver.vehicle_class or driver.leader_class for driver in self.drivers)
        rows: list[tuple[str, ...]] = []
        held: dict[str, list[float]] = {n: [] for n in names}
        for d, values in zip(self.drivers, self._drivers(), strict=True):
            cells = [self._cell(values, n) for n in names]
            for n, cell in zip(names, cells, strict=True):
                held[n] += [values[n]] if cell != _NOT_IDENTIFIED else []
            belongs = [f"{p:.2f}" for p in self._belongs(len(rows)).values()]
            rows.append((*_row(d, cells, values["log_likelihood"], on_tracks), *belongs))
        if on_tracks:
            pairs = self.pairs if len({one.leader_class for one in self.pairs} - {""}) > 1 else ()
            for one in (*self.vehicle_classes, *pairs):
                cells = ["" if (m := one.medians[n]) is None else _figure(m) for n in names]
                rows.append((f"median of {one.drivers}", one.shown, "", *cells, "", ""))
        else:
            means = [_figure(fmean(held[n])) if held[n] else _NOT_IDENTIFIED for n in names]
            rows.append(("mean", *means, f"{float(self.log_likelihood.mean()):.1f}"))
        title = f"Calibration, {self.settings.formulation} formulation"
        who, last = (("class", "following [s]"), ("NIS",)) if on_tracks else ((), ())
        headings = ("vehicle", *who, *map(ROW.heading, names), "log-likelihood [nats]", *last, *self._belongs(0))
        rows = [(*row, *[""] * (len(headings) - len(row))) for row in rows]
        if on_tracks and not has_classes:
            headings, rows = (headings[0], *headings[2:]), [(row[0], *row[2:]) for row in rows]
        return TextTable(title, headings, tuple(rows), left=1 + has_classes if on_tracks else 0)

    def class_sentences(self) -> list[str]:
        """Say the share and the parameters of each class, and which models predict held-out drivers better.

        The list is empty if the drivers were not divided into classes.
        """
        if self.classes is None:
            return []
        names, lines = self.settings.estimated, []
        for number, one in enumerate(_classes_of(self.classes, names)):
            values = ", ".join(f"{n} {_figure(one[n])} ({_ends(*one['interval'][n])})" for n in names)
            lines.append(f"class {one.get('name', number)}: {one['share']:.0%} of the drivers, {values}")
        for lane, shares in zip(self.classes.entries, self.classes.goal_share.tolist(), strict=True):
            if self.settings.goals:
                who = ", ".join(f"{name} {one:.0%}" for name, one in zip(self.classes.goals, shares, strict=True))
                lines.append(f"goals{f' of lane {lane}' if lane else ''}: {who}")
        for model in self.held_out[1:]:
            found, said = model.document(self.held_out[0]), []
            if math.isfinite(found["whole"]):
                said.append(f"{found['whole']:+.2f} ± {found['whole_std']:.2f}")
            said.append(f"{found['later']:+.2f} ± {found['later_std']:.2f} for the second half, knowing the first")
            lines.append(f"held-out drivers, {model.name} against one class [nats a driver]: {'; '.join(said)}")
        return lines

    def shared_sentences(self) -> list[str]:
        """Say the values of the parameters that all drivers share, one line for each effect."""
        said = {
            name: ", ".join(f"{p} {v['value']:.4g} {_within(v['std'], '{:.2g}'.format)}" for p, v in values.items())
            for name, values in self._shared().items()
        }
        return [f"{name}: {values or 'nothing of it was found'}" for name, values in said.items()]

    def _drivers(self) -> list[dict[str, Any]]:
        """Collect the results of each driver in plain types."""
        places = {name: ROW.entries.index(name) for name in self.settings.estimated}
        columns = (self.drivers, self.rows, self.log_likelihood, self.std, self.interval, self.identified)
        return [
            {
                **self._who(driver),
                **{name: float(row[k]) for name, k in places.items()},
                "log_likelihood": float(value),
                **({"nis": driver.nis} if self.road is None else {}),
                "std": std,
                "interval": {name: interval[k].tolist() for name, k in places.items()},
                "identified": identified,
            }
            for driver, row, value, std, interval, identified in zip(*columns, strict=True)
        ]

    def _who(self, d: CalibratedDriver) -> dict[str, Any]:
        if self.road is not None:
            return {"vehicle": d.vehicle}
        who = {"recording": d.recording, "vehicle": d.vehicle, "class": d.vehicle_class}
        return {**who, "stretches": d.stretches, "following_s": d.following_s}

    def has_value(self, name: str) -> Mask:
        """Return of which drivers (N,) an estimated parameter has a value.

        The parameter is identified, or the driver is a draw from a population that says enough of it, although the
        driver's own samples say little.
        """
        return np.array([self._has_value(d, name) for d in self._drivers()])

    def _has_value(self, d: Mapping[str, Any], name: str) -> bool:
        interval = np.array(d["interval"][name])
        is_drawn = self.population is not None and bool(is_determined(d["std"][name], d[name], interval))
        return bool(d["identified"][name]) or is_drawn

    def _cell(self, d: Mapping[str, Any], name: str) -> str:
        known = _ends(*d["interval"][name]) if self.settings.profiled else _within(d["std"][name])
        return f"{_figure(d[name])} {known}" if self._has_value(d, name) and known != _VAGUE else _NOT_IDENTIFIED

    def _shared(self) -> dict[str, dict[str, dict[str, float]]]:
        """Value and std of each shared parameter, by effect and parameter; nothing for an effect that was not found.

        The shared parameters of ``driver.parameters`` stand under ``constants``.
        """
        shared: dict[str, dict[str, dict[str, float]]] = {name: {} for name in self.settings.effects if name in EFFECTS}
        for entry, std in (self.shared_std or {}).items():
            effect, _, parameter = entry.rpartition(".")
            value = float(self.rows[0, ROW.entries.index(entry)])
            shared.setdefault(effect or "constants", {})[parameter] = {"value": value, "std": std}
        return shared


def of_fits(
    settings: Settings,
    drivers: Sequence[CalibratedDriver],
    fits: Sequence[Fit],
    about: About,
    road: DenseTracks | None = None,
) -> Calibration:
    """Return the calibration that fits of single drivers make."""
    names = settings.estimated
    return Calibration(
        settings=settings,
        drivers=tuple(drivers),
        rows=ROW.with_effects(np.array([fit.parameters for fit in fits])),
        std=tuple({name: float(fit.std[index(name)]) for name in names} for fit in fits),
        identified=tuple({name: fit.identified(name) for name in names} for fit in fits),
        interval=np.array([fit.interval for fit in fits]),
        log_likelihood=np.array([fit.log_likelihood for fit in fits]),
        about=about,
        road=road,
    )


def of_classes(
    settings: Settings,
    drivers: Sequence[CalibratedDriver],
    classes: Classes,
    about: About,
    road: DenseTracks | None = None,
    held_out: tuple[Predictions, ...] = (),
) -> Calibration:
    """Return the calibration in which each driver has the parameters of the likeliest class."""
    names, likeliest = settings.estimated, classes.probability.argmax(axis=1)
    places, interval = [index(name) for name in names], classes.interval[likeliest]
    std = np.ptp(interval, axis=-1) / (2.0 * SIGMAS)
    determined = is_determined(std, classes.own_rows, interval)
    return Calibration(
        settings=settings,
        drivers=tuple(drivers),
        rows=classes.own_rows,
        std=tuple(dict(zip(names, one, strict=True)) for one in std[:, places].tolist()),
        identified=tuple(dict(zip(names, one, strict=True)) for one in determined[:, places].tolist()),
        interval=interval,
        log_likelihood=classes.log_likelihood,
        about=about,
        road=road,
        classes=classes,
        population=classes.population(names),
        held_out=held_out,
    )


def medians_of(
    groups: Sequence[tuple[str, str | None]], rows: Array, identified: Sequence[Mapping[str, bool]]
) -> tuple[ClassMedians, ...]:
    """Return the medians of each group of drivers, from their rows (N, ...) and what of them is identified."""
    found = []
    for group in sorted(set(groups), key=lambda one: (one[0], one[1] or "")):
        own = [k for k, of in enumerate(groups) if of == group]
        medians: dict[str, float | None] = {}
        for name in identified[0]:
            known = [float(rows[k, ROW.entries.index(name)]) for k in own if identified[k][name]]
            medians[name] = float(np.median(known)) if known else None
        found.append(ClassMedians(group[0], group[1], len(own), medians))
    return tuple(found)


def _row(d: CalibratedDriver, cells: Sequence[str], log_likelihood: float, on_tracks: bool) -> tuple[str, ...]:
    if not on_tracks:
        return (d.shown, *cells, f"{log_likelihood:.1f}")
    return (d.shown, d.vehicle_class, f"{d.following_s:.0f}", *cells, f"{log_likelihood:.1f}", f"{d.nis:.2f}")


def _ends(low: float, high: float) -> str:
    """Ends of an interval, as text."""
    ends = [_figure(end) if has_both_ends(np.array([end])) else "" for end in (low, high)]
    if all(ends):
        return " to ".join(ends)
    return f"at least {ends[0]}" if ends[0] else f"at most {ends[1]}" if ends[1] else _NOT_IDENTIFIED


def _figure(value: float) -> str:
    """A value of a parameter, as text; a small one keeps its digits."""
    return in_words(value) if 0.0 < abs(value) < _SMALL else f"{value:.3f}"


def _within(std: float, write: Callable[[float], str] = _figure) -> str:
    """How well a parameter is known, as text."""
    return f"± {write(std)}" if math.isfinite(std) else _VAGUE


def _classes_of(classes: Classes, names: Sequence[str]) -> list[dict[str, Any]]:
    """Collect the share of the drivers, the parameters and their 95 % intervals, for each class."""
    places = [index(name) for name in names]
    return [
        {
            **({"name": classes.names[k]} if classes.names else {}),
            "share": float(classes.share[k]),
            **dict(zip(names, row[places].tolist(), strict=True)),
            "interval": dict(zip(names, interval[places].tolist(), strict=True)),
        }
        for k, (row, interval) in enumerate(zip(classes.rows, classes.interval, strict=True))
    ]

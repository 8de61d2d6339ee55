"""A fitted model as a YAML file: active effects, parameters of every driver, standard deviations, how often drivers
decide, and origin of the data.
"""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass
from difflib import get_close_matches
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import yaml

from sugiyama_ros.arrays import Array, Ints, Mask
from sugiyama_ros.driver.parameters import COUNT, NAMES, check_for_filter, index, population
from sugiyama_ros.effects.discovered_force import COVARIATES
from sugiyama_ros.effects.discovered_force import EFFECT as FORCE_EFFECT
from sugiyama_ros.effects.registry import EFFECTS, GROUP, ROW, active, effect, index_of, strengths, switch_on
from sugiyama_ros.errors import InputError
from sugiyama_ros.files import Target, number, read_yaml, writing
from sugiyama_ros.fit.driver_types import DriverTypes, Population
from sugiyama_ros.fit.goals import Goal, KnownGoals
from sugiyama_ros.fit.joint import JointFit
from sugiyama_ros.fit.recording import Recorded
from sugiyama_ros.fit.standard_errors import own_stds, shared_stds
from sugiyama_ros.laws.registry import LAWS, PAPERS, law, name_of, number_of
from sugiyama_ros.plugins import FAILED
from sugiyama_ros.road import DECISIONS_S, LENGTHS_M, RINGS_M

_FORMAT = 1
# What a file may say, and what it may say of one driver.
_KEYS = (
    *("sugiyama_model", "version", "data", "road", "decision_period_s", "individual", "effects", "shared_std"),
    *("drivers", "cautions", "population", "goals", "classes"),
)
_OF_DRIVER = ("name", "parameters", "std", "law", "effects", "length_m")
# libyaml, if it is installed, is ten times faster
_DUMPER = getattr(yaml, "CSafeDumper", yaml.SafeDumper)


@dataclass(frozen=True)
class Conditions:
    """Where and how drivers drove whom a model was fitted to; None and empty where it is not known.

    ring_m: circumference [m] of the road; 0 if it is open; decision_period_s: time [s] from one decision of a driver to
    the next; length_m: (N,), lengths of the drivers' vehicles [m]; individual: names of the parameters that each driver
    has their own values of; all drivers share the others.
    """

    ring_m: float | None = None
    decision_period_s: float | None = None
    length_m: tuple[float, ...] = ()
    individual: tuple[str, ...] = ()

    def of_experiment(self, vehicles: int) -> dict[str, Any]:
        """Return the fields of an experiment on this road, with these decisions, and the lengths of all vehicles."""
        known = {"ring_m": self.ring_m, "period_s": self.decision_period_s}
        found: dict[str, Any] = {name: value for name, value in known.items() if value is not None}
        return {**found, "length_m": self.length_m} if len(self.length_m) == vehicles else found


def decisions_between(period_s: float, decision_period_s: float | None) -> int:
    """Return how often drivers decide from one sample to the next, ``period_s`` [s] later; once if it is not known."""
    return 1 if decision_period_s is None else max(1, round(period_s / decision_period_s))


_UNKNOWN = Conditions()


@dataclass(frozen=True, eq=False)
class ModelFile:
    """The contents of a model file: vehicles (N,), rows (N, WIDTH), active effects, and the origin of the data.

    conditions: where and how the drivers drove; types: classes of drivers, if they were divided; population: of which
    the drivers are draws, if that is known; goals: what drivers may intend, if that is known; cautions: what somebody
    who uses the model must know, in words.
    """

    vehicle: Ints
    rows: Array
    effects: tuple[str, ...]
    source: str
    sha256: str
    conditions: Conditions = _UNKNOWN
    types: DriverTypes | None = None
    population: Population | None = None
    goals: KnownGoals | None = None
    cautions: tuple[str, ...] = ()

    def effects_to_fit(self) -> tuple[str, ...]:
        """Return the effects if a fit can find all of them; none if one has no start, or for another law."""
        have_starts = all(effect(name).is_searched for name in self.effects)
        return self.effects if have_starts and (self.rows[:, ROW.law] == number_of(PAPERS)).all() else ()

    def name(self, left_out: Sequence[str] = ()) -> str:
        """Return the name of the model in a comparison: its law, if it is not the paper's, and the effects in use."""
        law = name_of(float(self.typical[ROW.law]))
        parts = [*([law] if law != PAPERS else []), *(effect for effect in self.effects if effect not in left_out)]
        return f"file: {', '.join(parts) or 'base'}"

    def is_of(self, sha256: str) -> bool | None:
        """Whether the drivers are those of a recording with this checksum; None if one of the two does not say it."""
        return sha256 == self.sha256 if sha256 and self.sha256 else None

    def rows_of(self, vehicles: Ints, sha256: str = "") -> Array:
        """Return the rows (N, WIDTH) of some vehicles of a recording with this checksum.

        A vehicle that is not in the file has the typical driver. In another recording than the file's, equal numbers
        are other people, of whom the file knows what it says of everybody.
        """
        if self.is_of(sha256) is False:
            return np.tile(self.other, (len(vehicles), 1))
        known = {int(v): k for k, v in enumerate(self.vehicle)}
        return np.array([self.rows[known[int(v)]] if int(v) in known else self.typical for v in vehicles])

    def has(self, effect: str) -> Mask:
        """Return which drivers (N,) an effect acts on."""
        return np.asarray(self.rows[:, strengths(effect)].any(axis=1))

    @property
    def of_a_moment(self) -> tuple[str, ...]:
        """The effects that are tied to a time of the file's own recording."""
        covariate = self.rows[:, index_of(FORCE_EFFECT.name, "covariate")]
        over_time = FORCE_EFFECT.name if (covariate == COVARIATES.index("time") + 1.0).any() else ""
        return tuple(n for n in self.effects if n == over_time or any(p.axis == "time" for p in EFFECTS[n].parameters))

    def simulated(self, vehicles: int) -> Array:
        """Return the rows (N, WIDTH) of so many drivers: all of the file, or those with the numbers from 0 on."""
        return self.rows_of(self.vehicle if vehicles == len(self.vehicle) else np.arange(vehicles))

    @property
    def typical(self) -> Array:
        """The row (WIDTH,) of the median driver, of those who drive by the most frequent law.

        Where the file knows their population, it is the population's median. Drivers without an effect say nothing of
        where and how it acts.
        """
        laws, drivers = np.unique(self.rows[:, ROW.law], return_counts=True)
        typical: Array = np.median(self.rows[self.rows[:, ROW.law] == laws[drivers.argmax()]], axis=0)
        for name, (median, _) in (self.population.parameters if self.population is not None else {}).items():
            typical[index(name)] = median
        for name in self.effects:
            constants = [k for k in range(ROW.width)[ROW.places[name]] if k not in strengths(name)]
            typical[constants] = np.median(self.rows[self.has(name)][:, constants], axis=0)
        return typical

    @property
    def other(self) -> Array:
        """The row (WIDTH,) of a driver of another recording: the typical one, without effects of a moment."""
        row = self.typical
        for name in self.of_a_moment:
            row[ROW.places[name]] = [p.default for p in EFFECTS[name].parameters]
        return row


def drivers_of(file: Path | None, law_name: str, option: Callable[[str], str] = str) -> ModelFile:
    """Return a model file, or without one a typical driver of a law, who stands for every vehicle.

    option: writes the name of an option for the user. Raises InputError, also for a file and another law at once.
    """
    if file is None:
        law(law_name)
        row = drive_by(ROW.with_effects(population()), law_name)
        return ModelFile(np.array([-1]), row[None], (), "", "")
    found = read_model(file)
    if law_name != PAPERS:
        one, other = option("law"), option("model")
        raise InputError(
            f"{one}: the model file {file} says by which law its drivers drive; leave out {one} or {other}"
        )
    return found


def write_model(target: Target, data: Recorded, fitted: JointFit, cautions: Sequence[str] = ()) -> None:
    """Write a fitted model to a file. Raises OutputError."""
    with ThreadPoolExecutor(1) as work:
        own, shared = own_stds(fitted), shared_stds(data, fitted, work)
    around, model = data.vicinity, fitted.model
    conditions = Conditions(
        ring_m=around.road.circumference_m,
        decision_period_s=around.period_s,
        length_m=tuple(around.length_m[:, : data.drivers].max(axis=0).tolist()),
        individual=tuple(ROW.entries[k] for k in model.individual),
    )
    origin = around.numbers, around.source, around.sha256
    drivers = FittedDrivers(*origin, model.rows, own, shared, fitted.log_likelihood, conditions)
    write_drivers(target, drivers._replace(names=[one.shown for one in around.names]), cautions=cautions)


class FittedDrivers(NamedTuple):
    """N drivers for a model file, and what they were fitted to.

    numbers: numbers of the vehicles; source, sha256: name and checksum of the recording; rows: (N, WIDTH), row of each
    driver; own_std: standard deviations of each driver's parameters; shared_std: of the parameters that all share;
    log_likelihood: log-likelihood of the fit [nats]; conditions: where and how the drivers drove; names: names of the
    vehicles in the recording; empty where their numbers are their names.
    """

    numbers: Sequence[int]
    source: str
    sha256: str
    rows: Array
    own_std: Sequence[Mapping[str, float]]
    shared_std: Mapping[str, float]
    log_likelihood: float
    conditions: Conditions = _UNKNOWN
    names: Sequence[str] = ()


def write_drivers(
    target: Target,
    fitted: FittedDrivers,
    types: DriverTypes | None = None,
    population: Population | None = None,
    goals: KnownGoals | None = None,
    cautions: Sequence[str] = (),
) -> None:
    """Write the parameters of drivers as a model file. Raises OutputError."""
    numbers, source, sha256, rows, own_std, shared_std, log_likelihood, conditions, names = fitted
    drivers = {
        v: {**({} if name == str(v) else {"name": name}), **_driver(row, std)}
        for v, name, row, std in zip(numbers, names or map(str, numbers), rows, own_std, strict=True)
    }
    for about, length_m in zip(drivers.values(), conditions.length_m, strict=False):
        about["length_m"] = length_m
    document = {
        "sugiyama_model": _FORMAT,
        "version": version("sugiyama_ros"),
        "data": {"source": source, "sha256": sha256, "log_likelihood": log_likelihood},
        "road": {"ring_m": conditions.ring_m},
        "decision_period_s": conditions.decision_period_s,
        "individual": list(conditions.individual),
        "effects": list(active(rows)),
        "shared_std": dict(shared_std),
        "drivers": drivers,
    }
    if cautions:
        document["cautions"] = list(cautions)
    if population is not None:
        document["population"] = population.document()
    if goals is not None:
        document["goals"] = [{**asdict(one), "share": goals.share[one.name]} for one in goals.goals]
    if types is not None:
        document["classes"] = [
            {"share": float(share), "parameters": dict(zip(NAMES, row.tolist(), strict=True))}
            for share, row in zip(types.share, types.rows, strict=True)
        ]
    with writing(target) as stream:
        stream.write(yaml.dump(document, Dumper=_DUMPER, sort_keys=False, allow_unicode=True).encode())


def _driver(row: Array, std: Mapping[str, float]) -> dict[str, Any]:
    """The parameters of a driver with their standard deviations, and the effects that act on them."""
    return {
        "parameters": {name: float(v) for name, v in zip(NAMES, row, strict=False)},
        "std": dict(std),
        **_law(row),
        "effects": {
            name: {p.name: float(row[index_of(name, p.name)]) for p in effect(name).parameters} for name in active(row)
        },
    }


def _law(row: Array) -> dict[str, Any]:
    """The law of a driver who does not drive by the paper's, with its parameters."""
    name = name_of(float(row[ROW.law]))
    if name == PAPERS:
        return {}
    values = row[ROW.law_places[name]].tolist()
    return {"law": {name: {p.name: v for p, v in zip(LAWS[name].parameters, values, strict=True)}}}


def drive_by(row: Array, name: str, values: Mapping[str, float] | None = None) -> Array:
    """Return the row (WIDTH,) of a driver who drives by a law, with its usual values if none are given.

    Raises InputError.
    """
    declared, found = law(name).parameters, row.copy()
    found[ROW.law] = number_of(name)
    if name == PAPERS:
        return found
    values = {p.name: p.default for p in declared} if values is None else values
    if set(values) != {p.name for p in declared}:
        raise InputError(f"law {name}: give {', '.join(p.name for p in declared)}")
    for place, p in zip(range(ROW.width)[ROW.law_places[name]], declared, strict=True):
        if not p.lower <= values[p.name] <= p.upper:
            raise InputError(
                f"law {name}: {p.name} {values[p.name]:g} is out of bounds; give {p.lower:g} to {p.upper:g}"
            )
        found[place] = values[p.name]
    return found


def read_model(path: Path) -> ModelFile:
    """Read a model file. Raises InputError."""
    document = read_yaml(path)
    if not isinstance(document, dict) or document.get("sugiyama_model") != _FORMAT:
        raise InputError(
            f"{path}: is not a model file of format {_FORMAT}; write one with `sugiyama calibrate FILE -o model.yaml`"
        )
    _check_keys(document, _KEYS, str(path))
    drivers = document.get("drivers")
    if not isinstance(drivers, dict) or not drivers:
        raise InputError(f"{path}: drivers: give the parameters of each driver by the number of the vehicle")
    rows, lengths = [], []
    for vehicle, about in drivers.items():
        where = f"{path}: drivers: {str(vehicle)[:40]}"
        try:
            if type(vehicle) is not int or not 0 <= vehicle < 1 << 31:
                raise InputError("is not the number of a vehicle; give 0 to 2147483647")
            rows.append(_row(about))
            if "length_m" in about:
                lengths.append(_within(about["length_m"], "length_m", LENGTHS_M))
        except InputError as error:
            raise InputError(f"{where}: {error}") from None
        except (KeyError, TypeError, ValueError, AttributeError) as error:
            raise InputError(f"{where}: {_wrong(error)}; give every parameter a number") from None
    types = _types(path, document["classes"]) if "classes" in document else None
    drawn = _population(path, document["population"]) if "population" in document else None
    intended = _goals(path, document["goals"]) if "goals" in document else None
    about_data = document.get("data")
    known = about_data if isinstance(about_data, dict) else {}
    stacked = np.array(rows)
    cautions = document.get("cautions", [])
    if not isinstance(cautions, list) or not all(isinstance(one, str) for one in cautions):
        raise InputError(f"{path}: cautions: give a list of sentences, or leave it out")
    source, checksum = str(known.get("source", "")), str(known.get("sha256", ""))
    return ModelFile(
        vehicle=np.array(list(drivers)),
        rows=stacked,
        effects=active(stacked),
        source=source,
        sha256=checksum,
        conditions=_conditions(path, document, tuple(lengths) if len(lengths) == len(rows) else ()),
        types=types,
        population=drawn,
        goals=intended,
        cautions=tuple(cautions),
    )


def _row(about: Mapping[str, Any]) -> Array:
    """The row (WIDTH,) of a driver in a model file. Raises InputError, KeyError, TypeError or ValueError."""
    row: Array = np.zeros(ROW.width)
    _check_keys(about, _OF_DRIVER)
    given, by = about["parameters"], _mapping(about.get("law", {}), "law")
    _check_keys(given, NAMES, "parameters")
    row[:COUNT] = [number(given[name], name) for name in NAMES]
    if len(by) > 1:
        raise InputError(f"law: gives {', '.join(map(str, by))}; a driver has one law, so leave out all others")
    for name, values in by.items():
        row = drive_by(row, str(name), {str(p): number(v, str(p)) for p, v in _mapping(values, str(name)).items()})
    for name, values in _mapping(about.get("effects", {}), "effects").items():
        _check_installed(str(name))
        row = switch_on(row, str(name), {str(p): number(v, str(p)) for p, v in _mapping(values, str(name)).items()})
    check_for_filter(row[:COUNT])
    return row


def _check_keys(given: Any, known: Sequence[str], where: str = "") -> None:
    """Raise InputError if there is no mapping, or for a key that no model file has, which would change nothing."""
    for key in _mapping(given, where or "entry"):
        if key not in known:
            near = get_close_matches(str(key).lower(), known, 1)
            cure = f"did you mean {near[0]}?" if near else f"give {', '.join(known)}"
            raise InputError(f"{f'{where}: ' if where else ''}{str(key)[:40]!r} is not known; {cure}")


def _mapping(given: Any, where: str) -> Mapping[Any, Any]:
    """Return a mapping of a document. Raises InputError."""
    if not isinstance(given, dict):
        raise InputError(f"{where}: is {str(given)[:40]!r}; give names with their values, such as name: 1.0")
    return given


def _conditions(path: Path, document: Mapping[str, Any], length_m: tuple[float, ...]) -> Conditions:
    """Where and how the drivers of a model file drove. Raises InputError."""
    road, individual = document.get("road", {}), document.get("individual", [])
    try:
        if not isinstance(road, dict):
            raise InputError("road: give ring_m, or leave it out")
        _check_keys(road, ("ring_m",), "road")
        if not isinstance(individual, list):
            raise InputError("individual: give a list of names of parameters, or leave it out")
        ring_m, period_s = road.get("ring_m"), document.get("decision_period_s")
        unknown = [str(name)[:80] for name in individual if not _is_fitted(str(name))]
        if unknown:
            raise InputError(f"individual: {unknown[0]!r} is not the name of a parameter that is fitted; leave it out")
        return Conditions(
            ring_m=None if ring_m is None else _within(ring_m, "ring_m", (0.0, RINGS_M[1])),
            decision_period_s=None if period_s is None else _within(period_s, "decision_period_s", DECISIONS_S),
            length_m=length_m,
            individual=tuple(individual),
        )
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _is_fitted(entry: str) -> bool:
    """Whether a fit can find an entry of a row: the number of a law, and what a search leaves as it is, are none."""
    owner, _, name = entry.rpartition(".")
    is_fixed = owner in EFFECTS and name in EFFECTS[owner].fixed
    return entry in NAMES or (entry in ROW.entries and bool(owner) and not is_fixed)


def _within(given: Any, name: str, bounds: tuple[float, float]) -> float:
    """Return a number of a file that is within bounds. Raises InputError."""
    value = number(given, name)
    if not bounds[0] <= value <= bounds[1]:
        raise InputError(f"{name}: {value:g} is not possible; give {bounds[0]:g} to {bounds[1]:g}")
    return value


def _check_installed(name: str) -> None:
    """Raise InputError for an effect that is not known here: a model file can outlive the package of an effect."""
    if name not in EFFECTS and (GROUP, name) not in FAILED:
        raise InputError(f"effect {name[:80]!r}: not known here; was its package uninstalled? install it again")


def _types(path: Path, classes: Any) -> DriverTypes:
    """Return the classes in a model file. Raises InputError."""
    try:
        for one in classes:
            _check_keys(one, ("share", "parameters"))
            _check_keys(one["parameters"], NAMES, "parameters")
        share = np.array([number(one["share"], "share") for one in classes])
        rows = np.array([[number(one["parameters"][name], name) for name in NAMES] for one in classes])
        if not len(share) or not (share > 0.0).all():
            raise ValueError("share")
        for row in rows:
            check_for_filter(row)
    except InputError as error:
        raise InputError(f"{path}: classes: {error}") from None
    except (KeyError, TypeError, ValueError) as error:
        raise InputError(f"{path}: classes: {_wrong(error)}; give share and every parameter") from None
    return DriverTypes(share / share.sum(), rows)


def _population(path: Path, given: Any) -> Population:
    """Return the population in a model file. Raises InputError."""
    found: dict[str, tuple[float, float]] = {}
    medians = population()
    try:
        _check_keys(given, NAMES)
        for name, about in given.items():
            _check_keys(about, ("median", "log_std"), str(name))
            median, std = number(about["median"], f"{name}: median"), number(about["log_std"], f"{name}: log_std")
            if std < 0.0:
                raise InputError(f"{name}: log_std: {std:g} is not possible; give 0 or more")
            found[str(name)] = median, std
            medians[index(name)] = median
        check_for_filter(medians)
    except InputError as error:
        raise InputError(f"{path}: population: {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: population: {_wrong(error)}; give median and log_std of parameters") from None
    return Population(found)


def _goals(path: Path, given: Any) -> KnownGoals:
    """Return the goals in a model file. Raises InputError."""
    goals, shares = [], {}
    try:
        if not isinstance(given, list):
            raise ValueError("no list")
        for one in given:
            _check_keys(one, ("name", "place", "speed", "deceleration", "lane", "share"))
            if not isinstance(one["name"], str):
                raise InputError(f"name: is {str(one['name'])[:40]!r}; give letters, digits and underscores")
            values = {key: number(one[key], key) for key in ("place", "speed", "deceleration", "share")}
            shares[one["name"]] = values.pop("share")
            goals.append(Goal(one["name"], **values, lane=str(one.get("lane", ""))))
        if not goals or not all(share > 0.0 for share in shares.values()) or not sum(shares.values()) < 1.0:
            raise ValueError("share")
    except InputError as error:
        raise InputError(f"{path}: goals: {error}") from None
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: goals: {_wrong(error)}; give name, place, speed, deceleration and share") from None
    return KnownGoals(tuple(goals), shares)


def _wrong(error: Exception) -> str:
    """What is wrong with a document that raises an error when it is read."""
    return f"{error} is missing" if isinstance(error, KeyError) else "is not of the form that a model file has"

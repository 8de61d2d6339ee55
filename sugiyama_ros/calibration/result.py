"""The settings and the result of a calibration. The result becomes a document, a table or a model file."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import fmean
from typing import TYPE_CHECKING, Any

from sugiyama_ros.arrays import Array
from sugiyama_ros.driver.parameters import index
from sugiyama_ros.effects.registry import ROW
from sugiyama_ros.fit.classes import Classes
from sugiyama_ros.fit.driver import Formulation
from sugiyama_ros.fit.driver_types import DriverTypes
from sugiyama_ros.fit.smooth_positions import ESTIMATED
from sugiyama_ros.laws.registry import PAPERS
from sugiyama_ros.outputs import Target
from sugiyama_ros.plots import BLUE
from sugiyama_ros.results import Result
from sugiyama_ros.tables import TextTable
from sugiyama_ros.trajectories.trajectories import Trajectories

if TYPE_CHECKING:
    from matplotlib.figure import Figure

_VAGUE = "(not identified)"
#: What stands in tables instead of the value of a parameter that the data do not determine.
NOT_IDENTIFIED = "not identified"


@dataclass(frozen=True)
class Settings:
    """What a calibration estimates, and how it searches.

    Parameters
    ----------
    formulation : {"causal", "paper"}
        ``"paper"`` smooths the states that the drivers perceive. ``"causal"`` filters them.
    estimated : tuple of str
        Names of the parameters to estimate.
    is_regularised : bool
        Whether the paper's penalty is added to the likelihood of each driver.
    profiled : bool
        Whether the intervals come from the profile likelihood.
    seed : int
        Seed of the random numbers.
    law : str
        Name of the law by which the drivers drive.
    """

    formulation: Formulation = "causal"
    estimated: tuple[str, ...] = ESTIMATED
    is_regularised: bool = False
    profiled: bool = False
    seed: int = 0
    law: str = PAPERS


@dataclass(frozen=True, eq=False, repr=False)
class Calibration(Result):
    """N calibrated drivers, in the order of the vehicles.

    Parameters
    ----------
    trajectories : Trajectories
        The recording.
    settings : Settings
        What was estimated, and how.
    rows : ndarray, shape (N, width)
        Row of each driver, at the reference period and in the declared units.
    std : tuple of dict of str to float
        Standard deviations of each driver's estimated parameters, by name, in the declared units.
    identified : tuple of dict of str to bool
        Whether the data determine each driver's estimated parameters, by name.
    interval : ndarray, shape (N, P, 2) or (N, width, 2)
        Ends of the 95 % intervals of the first P entries of a row, which are the paper's parameters, or of all.
    log_likelihood : ndarray, shape (N,)
        Log-likelihood of each driver [nats], without the 2 pi term.
    shared_std : mapping of str to float
        Standard deviations of the parameters that all drivers share, by name.
    classes : Classes, optional
        Classes of drivers, if the drivers were divided into classes.
    """

    trajectories: Trajectories
    settings: Settings
    rows: Array
    std: tuple[dict[str, float], ...]
    identified: tuple[dict[str, bool], ...]
    interval: Array
    log_likelihood: Array
    shared_std: Mapping[str, float]
    classes: Classes | None = None

    def write(self, target: Target) -> None:
        """Write a model file.

        Parameters
        ----------
        target : Path or Output
            The file, in YAML.

        Raises
        ------
        OutputError
            If the file cannot be written.
        """
        # Imported here: a calibration that is only printed starts sooner without the code of joint fits.
        from sugiyama_ros.fit.model_file import write_drivers

        total, types = float(self.log_likelihood.sum()), None
        if self.classes is not None:
            types = DriverTypes(self.classes.share, self.classes.rows)
        write_drivers(target, self.trajectories, self.rows, self.std, self.shared_std, total, types)

    def headline(self) -> str:
        """Say how many drivers were calibrated, and for how many of them each parameter is identified."""
        drivers, names = len(self.rows), self.settings.estimated
        held = ", ".join(f"{name} of {sum(one[name] for one in self.identified)}" for name in names)
        kind = f"{self.settings.formulation} formulation"
        return f"{drivers} drivers, {kind}, log-likelihood {self.log_likelihood.sum():.1f}; identified: {held}"

    def records(self) -> list[dict[str, Any]]:
        """List the drivers.

        Each record has the number of the vehicle and the log-likelihood. For each estimated parameter it has the value,
        the standard deviation, the ends of the 95 % interval, and whether the parameter is identified.
        """
        return [
            {
                "vehicle": d["vehicle"],
                **{
                    column: value
                    for name in self.settings.estimated
                    for column, value in (
                        (name, d[name]),
                        (f"{name}_std", d["std"][name]),
                        (f"{name}_low", d["interval"][name][0]),
                        (f"{name}_high", d["interval"][name][1]),
                        (f"{name}_identified", d["identified"][name]),
                    )
                },
                "log_likelihood": d["log_likelihood"],
            }
            for d in self._drivers()
        ]

    def draw(self, figure: "Figure") -> None:
        """Draw each estimated parameter of each driver with its standard deviation.

        A parameter that is not identified is an open circle.
        """
        names = self.settings.estimated
        rows = self._drivers()
        for axes, name in zip(figure.subplots(len(names), 1, sharex=True, squeeze=False)[:, 0], names, strict=True):
            for k, d in enumerate(rows):
                held = d["identified"][name]
                spread = d["std"][name] if held else None
                axes.errorbar(k, d[name], yerr=spread, fmt="o", color=BLUE, mfc=BLUE if held else "none", ms=4)
            axes.set(ylabel=ROW.heading(name))
        axes.set_xticks(range(len(rows)), [str(d["vehicle"]) for d in rows])
        axes.set(xlabel="vehicle")

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
        """Collect all results in plain types and SI units, for ``--json``.

        Parameters
        ----------
        wall_s : float
            Time [s] that the calibration took.

        Returns
        -------
        dict
            ``formulation``, ``law``, ``drivers``, ``effects``, ``log_likelihood`` and ``wall_s``. With classes of
            drivers, also ``classes`` and ``bic``.
        """
        drivers = self._drivers()
        found: dict[str, Any] = {
            "formulation": self.settings.formulation,
            "law": self.settings.law,
            "drivers": drivers,
            "effects": self._shared(),
            "log_likelihood": float(self.log_likelihood.sum()),
            "wall_s": wall_s,
        }
        if self.classes is not None:
            found |= {"classes": _classes_of(self.classes, self.settings.estimated), "bic": self.classes.bic}
            for driver, probability in zip(drivers, self.classes.probability.tolist(), strict=True):
                driver["class_probability"] = probability
        return found

    def table(self) -> TextTable:
        """Make a table of each driver's parameters with their uncertainty, and of means over drivers.

        A parameter that is not identified has no value, and is not in the mean.
        """
        names, profiled, rows = self.settings.estimated, self.settings.profiled, []
        held: dict[str, list[float]] = {n: [] for n in names}
        for d in self._drivers():
            cells = []
            for n in names:
                known = "{:.3f} to {:.3f}".format(*d["interval"][n]) if profiled else _within(d["std"][n], ".3f")
                cells.append(f"{d[n]:.3f} {known}" if d["identified"][n] and known != _VAGUE else NOT_IDENTIFIED)
                held[n] += [d[n]] if cells[-1] != NOT_IDENTIFIED else []
            rows.append((str(d["vehicle"]), *cells, f"{d['log_likelihood']:.1f}"))
        means = [f"{fmean(held[n]):.3f}" if held[n] else "nan" for n in names]
        rows.append(("mean", *means, f"{float(self.log_likelihood.mean()):.1f}"))
        title = f"Calibration, {self.settings.formulation} formulation"
        return TextTable(title, ("vehicle", *map(ROW.heading, names), "log-likelihood [nats]"), tuple(rows))

    def class_sentences(self) -> list[str]:
        """Say the share and the parameters of each class, and the information criterion.

        The list is empty if the drivers were not divided into classes.
        """
        if self.classes is None:
            return []
        names, lines = self.settings.estimated, []
        for number, one in enumerate(_classes_of(self.classes, names)):
            values = ", ".join(f"{n} {one[n]:.3f} {_within(one['std'][n], '.3f')}" for n in names)
            lines.append(f"class {number}: {one['share']:.0%} of the drivers, {values}")
        bic = f"Bayesian information criterion {self.classes.bic:.1f}"
        return [*lines, f"{bic}: the best number of classes has the smallest criterion"]

    def shared_sentences(self) -> list[str]:
        """Say the values of the parameters that all drivers share, one line for each effect."""
        return [
            f"{name}: " + ", ".join(f"{p} {v['value']:.4g} {_within(v['std'], '.2g')}" for p, v in values.items())
            for name, values in self._shared().items()
        ]

    def _drivers(self) -> list[dict[str, Any]]:
        """Collect the results of each driver in plain types."""
        names = self.settings.estimated
        places = [ROW.entries.index(name) for name in names]
        columns = (self.trajectories.vehicle, self.rows, self.log_likelihood, self.std, self.interval, self.identified)
        return [
            {
                "vehicle": int(vehicle),
                **{name: float(row[k]) for name, k in zip(names, places, strict=True)},
                "log_likelihood": float(value),
                "std": std,
                "interval": {name: interval[k].tolist() for name, k in zip(names, places, strict=True)},
                "identified": identified,
            }
            for vehicle, row, value, std, interval, identified in zip(*columns, strict=True)
        ]

    def _shared(self) -> dict[str, dict[str, dict[str, float]]]:
        """Value and std of each shared parameter, by effect and parameter.

        The shared parameters of ``driver.parameters`` stand under ``constants``.
        """
        found: dict[str, dict[str, dict[str, float]]] = {}
        for entry, std in self.shared_std.items():
            effect, _, parameter = entry.rpartition(".")
            value = float(self.rows[0, ROW.entries.index(entry)])
            found.setdefault(effect or "constants", {})[parameter] = {"value": value, "std": std}
        return found


def _within(std: float, form: str) -> str:
    """How well a parameter is known, as text."""
    return f"± {std:{form}}" if math.isfinite(std) else _VAGUE


def _classes_of(classes: Classes, names: Sequence[str]) -> list[dict[str, Any]]:
    """Collect the share of the drivers, the parameters and their std, for each class."""
    places = [index(name) for name in names]
    return [
        {
            "share": float(share),
            **dict(zip(names, row[places].tolist(), strict=True)),
            "std": dict(zip(names, std[places].tolist(), strict=True)),
        }
        for share, row, std in zip(classes.share, classes.rows, classes.std, strict=True)
    ]

"""Simulated vehicles as a source of measured positions."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rclpy.parameter import Parameter as RosParameter
from sugiyama_msgs.srv import SetDriver

from sugiyama_ros.arrays import Array
from sugiyama_ros.controllers.registry import controlled_by
from sugiyama_ros.driver.parameters import COUNT, NAMES, defaults
from sugiyama_ros.effects.registry import ROW, read_effects
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.model_file import ModelFile, read_model
from sugiyama_ros.nodes.base import incoming
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.nodes.base.incoming import RefusedError
from sugiyama_ros.nodes.base.node import ERROR, Health
from sugiyama_ros.nodes.base.parameters import declare_driver
from sugiyama_ros.nodes.source import Source, TrueTopics, answer
from sugiyama_ros.road import Road
from sugiyama_ros.simulation.experiment import Experiment, changed, set_up
from sugiyama_ros.simulation.junction import JunctionSimulator
from sugiyama_ros.simulation.result import parameters_of
from sugiyama_ros.simulation.scenes import SCENES, road_of, scene_simulator
from sugiyama_ros.simulation.simulator import Simulator
from sugiyama_ros.trajectories.about import SIMULATED
from sugiyama_ros.trajectories.placing import Positions
from sugiyama_ros.trajectories.tracks import LINE
from sugiyama_ros.trajectories.truth import TrueDriver

# The scene that is none: a ring, or an open road.
_ROAD = "road"


class _SimulatedPositions:
    """A running simulation as samples. It only goes forward. ``steps`` is 0 if it has no end."""

    start_s = 0.0
    source = SIMULATED
    sha256 = ""

    def __init__(self, simulator: Simulator, steps: int) -> None:
        self.simulator = simulator
        self.road, self.period_s = simulator.road, simulator.period_s
        self.steps, self.controlled = steps, simulator.controlled
        self.collisions = 0

    def at(self, step: int) -> Positions:
        """Sample number ``step``, which is the current sample or the next."""
        s = self.simulator
        if step > s.step_number:
            self.collisions += len(s.step())
        return Positions(list(range(len(s.length_m))), s.leader.tolist(), s.measure().tolist(), s.length_m.tolist())

    def motion(self) -> Array:
        """True position [m], speed [m/s], acceleration [m/s^2] and gap [m] of each vehicle, (N, 4)."""
        s = self.simulator
        return np.stack([s.road.wrap(s.position_m), s.speed, s.acceleration, s.gap_m], axis=1)


class _SimulatedJunction:
    """A running simulation of a junction as samples: vehicles come in, let others pass, and leave.

    It ends after a number of steps, or where none is given, when the last vehicle has left: before, ``steps`` is 0.
    """

    start_s = 0.0
    source = SIMULATED
    sha256 = ""

    def __init__(self, simulator: JunctionSimulator, steps: int) -> None:
        self.simulator = simulator
        self.road, self.period_s = Road(), simulator.period_s
        self.controlled: Sequence[int] = ()
        self.steps, self.collisions, self._step = steps, 0, 0

    def at(self, step: int) -> Positions:
        """Sample number ``step``, which is the current sample or the next."""
        s = self.simulator
        if step > self._step:
            self.collisions += len(s.step())
            self._step = step
        here, (leader, shift, line) = s.on_road, s.see()
        if not self.steps and s.entered.all() and not len(here):
            self.steps = step + 1
        position = s.measure().tolist() if len(here) else []
        lines = dict(zip(LINE, line.T.tolist(), strict=True))
        return Positions(
            here.tolist(), leader.tolist(), position, s.length_m[here].tolist(), **lines, leader_shift_m=shift.tolist()
        )

    def motion(self) -> Array:
        """True motion of each vehicle, (N, 4), as of a simulated road; NaN for those who are not there."""
        s, here = self.simulator, self.simulator.on_road
        leader, shift, _ = s.see()
        gap = s.place[leader] + shift - s.place[here] - 0.5 * (s.length_m[leader] + s.length_m[here])
        motion = np.full((len(s.length_m), 4), np.nan)
        gap = np.where(leader >= 0, gap, np.inf)
        motion[here] = np.stack([s.place[here], s.speed[here], s.acceleration[here], gap], axis=1)
        return motion


class SimulatorNode(Source):
    """Simulates drivers, and sends the positions that a camera would measure, and the truth.

    The drivers are those of the file ``model``, or else drivers as in the paper. A parameter of a driver that is given
    at the start, or set later, holds for all drivers; the service ``~/set_driver`` changes one of them. Other
    parameters of the node: ``vehicles``, ``ring``, ``start``, ``start_gap``, ``lengths``, ``period``, ``duration``,
    ``spread``, ``effects``, ``seed``, ``controlled``, ``controller``, and the parameters of `Source`. With the
    ``scene`` roundabout, for example, vehicles come in at random; how they stand at the start has no meaning there.
    """

    samples: _SimulatedPositions | _SimulatedJunction

    def __init__(self, **options: Any) -> None:
        super().__init__("simulator", **options)
        self._truth = TrueTopics(self, range(len(self.samples.simulator.length_m)))
        self._tell_drivers(range(len(self.samples.simulator.length_m)))
        self.create_service(SetDriver, "~/set_driver", self._on_set_driver)
        self.add_post_set_parameters_callback(self._on_set)

    def open(self) -> _SimulatedPositions | _SimulatedJunction:
        """A simulation with the node's parameters."""
        option = self.option
        known = f"{_ROAD}, or {', '.join(SCENES)}"
        scene = option("scene", _ROAD, f"{known}: vehicles come in, let others pass, and leave")
        if scene not in (_ROAD, *SCENES):
            raise InputError(f"scene: {scene!r} is not known; give {known}")
        path = self.path("model", "model file (YAML) with drivers and effects")
        model = None if path is None else read_model(path)
        count = 22 if model is None else len(model.vehicle)
        vehicles = option("vehicles", count, "number of vehicles; by default as in the model file", (1, 1000))
        usual = {} if model is None else model.conditions.of_experiment(vehicles)
        several = list(usual.get("length_m", [0.0]))
        lengths = option("lengths", several, "length of each vehicle, or of all [m]; 0: the usual")
        given = tuple(float(length) for length in lengths)
        ended = "time [s] after which the simulation ends; 0: never"
        spread = "relative std of v_star and kappa_v over the drivers"
        experiment = Experiment(
            ring_m=option("ring", usual.get("ring_m", 230.0), "circumference [m]; 0: an open road", (0.0, 1e5)),
            duration_s=option("duration", 0.0, ended, (0.0, 1e6)),
            gap_m=option("start_gap", 2.0, "gap [m] between vehicles at the start, in a jam", (0.1, 1e3)),
            period_s=option("period", usual.get("period_s", 1.0 / 3.0), "time [s] between samples", (0.05, 1.0)),
            spread=option("spread", 0.0, spread, (0.0, 1.0)),
            seed=option("seed", 0, "seed of the noise", (0, 2**31 - 1)),
            start=option("start", "jam", "start in a jam, or with equal gaps on a ring"),
            length_m=() if given == (0.0,) else given,
        )
        texts = self.texts("effects", "NAME:PARAMETER=VALUE[,...], each")
        road = experiment.road if scene == _ROAD else road_of(scene)
        rows = changed(self._drivers(vehicles, model), {}, read_effects(texts, "effects"), road)
        numbers = self.vehicles("controlled", "numbers of vehicles that the controller drives; -1: none")
        controller = option("controller", "", "NAME[:KEY=VALUE[,...]]: what drives the controlled vehicles")
        controlled = controlled_by(numbers or None, controller or None)
        steps = experiment.samples if experiment.duration_s else 0
        if scene != _ROAD:
            if controlled is not None:
                raise InputError("controlled: drivers alone come to a scene; leave it out, or the scene")
            simulator = scene_simulator(scene, rows, experiment.seed, experiment.spread, experiment.period_s)
            return _SimulatedJunction(simulator, steps)
        return _SimulatedPositions(set_up(experiment, rows, controlled), steps)

    def send_more(self, stamp_ns: int) -> None:
        """Send the truth."""
        self._truth.send_motion(stamp_ns, self.samples.motion())

    def health(self) -> Health:
        """ERROR once vehicles have collided, because the model is not valid after that; else as `Source`."""
        collisions = self.samples.collisions
        if collisions:
            return Health(ERROR, f"{collisions} collisions", {"step": self.next_step, "collisions": collisions})
        return super().health()

    def _drivers(self, vehicles: int, model: ModelFile | None) -> Array:
        """Rows (N, WIDTH) of the drivers at the start."""
        rows = ROW.with_effects(defaults(vehicles)) if model is None else model.simulated(vehicles)
        usual = np.median(rows[:, :COUNT], axis=0)
        declare_driver(self, usual)
        for k, name in enumerate(NAMES):
            value = self.get_parameter(name).value
            if value != usual[k]:
                rows[:, k] = value
        return rows

    def _on_set(self, parameters: Sequence[RosParameter]) -> None:
        """Change all drivers, if a parameter of drivers was set."""
        wanted = {p.name: float(p.value) for p in parameters if p.name in NAMES}
        if wanted:
            rows = self.samples.simulator.drivers.copy()
            for name, value in wanted.items():
                rows[:, NAMES.index(name)] = value
            self.samples.simulator.change(rows)
            self._tell_drivers(range(len(rows)))

    def _on_set_driver(self, request: SetDriver.Request, response: SetDriver.Response) -> SetDriver.Response:
        s, vehicle = self.samples.simulator, request.vehicle
        try:
            if not 0 <= vehicle < len(s.length_m):
                raise RefusedError(f"vehicle {vehicle}: not on the road; give 0 to {len(s.length_m) - 1}")
            if vehicle in self.samples.controlled:
                raise RefusedError(f"vehicle {vehicle}: a controller drives it; give the number of a driver")
            values = incoming.named_values(f"vehicle {vehicle}", request.name, request.value)
            rows = s.drivers.copy()
            rows[vehicle] = _changed_driver(rows[vehicle], values)
            s.change(rows)
        except (InputError, RefusedError) as error:
            return answer(response, str(error))
        self._tell_drivers([vehicle])
        return answer(response)

    def _tell_drivers(self, vehicles: Sequence[int]) -> None:
        """Tell with which parameters some drivers drive from the next sample on."""
        time_s = self.samples.start_s + self.next_step * self.samples.period_s
        for vehicle in set(vehicles) - set(self.samples.controlled):
            drive = TrueDriver(time_s, vehicle, parameters_of(self.samples.simulator.drivers[vehicle]))
            self._truth.send_parameters(round(time_s * NS), drive)


def _changed_driver(row: Array, values: Mapping[str, float]) -> Array:
    """A driver's row (WIDTH,) with other values, by ``parameter`` or ``effect.parameter``. Raises InputError."""
    effects: dict[str, dict[str, float]] = {}
    own: dict[str, float] = {}
    for name, value in values.items():
        effect, dot, parameter = name.partition(".")
        if dot:
            effects.setdefault(effect, {})[parameter] = value
        else:
            own[name] = value
    return changed(row[None], own, effects)[0]

"""What a run consists of: names of its nodes and topics, parameters of its nodes."""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from sugiyama_ros.driver.parameters import NAMES, population
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.model_file import read_model
from sugiyama_ros.formats import read_trajectories
from sugiyama_ros.formats.writing import make_directory
from sugiyama_ros.nodes.saved_state import file_of, read_learnt
from sugiyama_ros.trajectories.trajectories import Trajectories

REPLAY, RECORDER, CRITIC = "/replay", "/recorder", "/critic"


def namespaces(vehicles: Iterable[int]) -> list[str]:
    """Namespace of each vehicle, /vehicle_07; with as many digits as the largest number needs, at least two."""
    numbers = list(vehicles)
    width = max(2, len(str(max(numbers, default=0))))
    return [f"/vehicle_{number:0{width}}" for number in numbers]


def estimators(spaces: Iterable[str]) -> list[str]:
    """Full names of the estimators in the vehicles' namespaces."""
    return [f"{space}/estimator" for space in spaces]


def step_topics(spaces: Iterable[str]) -> list[str]:
    """Full names of the topics with one message a step."""
    return ["/clock", "/measured", *(f"{space}/{topic}" for space in spaces for topic in ("state", "innovation"))]


@dataclass(frozen=True)
class Plan:
    """Replay ``source``, which holds ``trajectories``, and record it in ``output``.

    rate: times real time; 0 is as fast as the nodes take it. model: file with the drivers and effects from which the
    estimators start; critic: whether a critic listens; save_state: directory in which the estimators keep what they
    have learnt; resume: one from which they go on.
    """

    trajectories: Trajectories
    source: Path
    output: Path
    rate: float
    model: Path | None = None
    critic: bool = False
    save_state: Path | None = None
    resume: Path | None = None

    @classmethod
    def read(
        cls,
        source: Path,
        output: Path,
        rate: float,
        ring_m: float | None,
        model: Path | None = None,
        critic: bool = False,
        save_state: Path | None = None,
        resume: Path | None = None,
    ) -> "Plan":
        """A plan for a file of trajectories; ``ring_m`` [m] where the file does not tell.

        Raises InputError or OutputError.
        """
        if model is not None:
            read_model(model)
        if save_state is not None:
            make_directory(save_state)
        plan = cls(read_trajectories(source, ring_m), source, output, rate, model, critic, save_state, resume)
        if resume is not None:
            kept = [path for v in plan.trajectories.vehicle.tolist() if (path := file_of(resume, v)).exists()]
            if not kept:
                raise InputError(f"{resume}: nothing is known of these vehicles; give a directory of --save-state")
            for path in kept:
                read_learnt(path)
        return plan

    @property
    def namespaces(self) -> list[str]:
        """Namespace of each vehicle."""
        return namespaces(self.trajectories.vehicle.tolist())

    @property
    def estimators(self) -> list[str]:
        """Full names of the estimators."""
        return estimators(self.namespaces)

    @property
    def step_topics(self) -> list[str]:
        """Full names of the topics with one message a step."""
        return step_topics(self.namespaces)

    @property
    def estimator(self) -> dict[str, Any]:
        """Parameters of every estimator."""
        given = {"model": self.model, "save_state": self.save_state, "resume": self.resume}
        return {name: str(path) for name, path in given.items() if path is not None}

    @property
    def followers(self) -> list[str]:
        """Full names of the nodes that the replay waits for, but for the recorder."""
        return [*self.estimators, *([CRITIC] if self.critic else [])]

    @property
    def replay(self) -> dict[str, Any]:
        """Parameters of the replay."""
        return {
            "source": str(self.source),
            "ring": self.trajectories.road.circumference_m,
            "rate": float(self.rate),
            "wait_for": [RECORDER, *self.followers],
        }

    @property
    def recorder(self) -> dict[str, Any]:
        """Parameters of the recorder."""
        t = self.trajectories
        about = {
            "source": t.source,
            "sha256": t.sha256,
            "vehicles": len(t.vehicle),
            "steps": len(t.position_m),
            "rate": self.rate or "max",
            "model": str(self.model or ""),
            "start_parameters": json.dumps(dict(zip(NAMES, population().tolist(), strict=True))),
        }
        return {
            "output": str(self.output),
            "paced_topics": self.step_topics,
            "metadata": [f"{key}={value}" for key, value in about.items()],
        }

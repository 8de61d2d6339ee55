"""What an estimator has learnt, in a file or from a keeper. An estimator that starts later can go on from it."""

import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from sugiyama_msgs.msg import DriverParameters

from sugiyama_ros.errors import InputError
from sugiyama_ros.filters.learnt import Learnt
from sugiyama_ros.nodes.base.cdr_messages import NS
from sugiyama_ros.outputs import writing


@dataclass(frozen=True, eq=False)
class Kept:
    """What an estimator has learnt, and the stamp [ns] of the last sample that it used."""

    learnt: Learnt
    until_ns: int


def file_of(directory: Path, vehicle: int) -> Path:
    """File in which the estimator of a vehicle keeps what it has learnt."""
    return directory / f"vehicle_{vehicle:02}.json"


def kept_in(message: DriverParameters) -> Kept:
    """What an estimator had learnt when it published the message."""
    places = np.flatnonzero(message.estimated)
    value = np.array(message.value)[places]
    covariance = np.array(message.covariance).reshape(2 * [len(message.value)])[np.ix_(places, places)]
    learnt = Learnt(tuple(message.name[k] for k in places), np.log(value), covariance / np.outer(value, value))
    return Kept(learnt, message.header.stamp.sec * NS + message.header.stamp.nanosec)


def write_learnt(path: Path, kept: Kept) -> None:
    """Write what was learnt into a file. Raises OutputError."""
    learnt = kept.learnt
    document = {
        "names": learnt.names,
        "mean": learnt.mean.tolist(),
        "covariance": learnt.covariance.tolist(),
        "until_ns": kept.until_ns,
    }
    with writing(path) as stream:
        stream.write(json.dumps(document).encode())


def read_learnt(path: Path) -> Kept:
    """Read a file that ``write_learnt`` has written. Raises InputError."""
    try:
        document = json.loads(path.read_text())
        names = tuple(map(str, document["names"]))
        mean, covariance = (np.array(document[name], dtype=np.float64) for name in ("mean", "covariance"))
        if mean.shape != (len(names),) or covariance.shape != 2 * mean.shape or not np.isfinite(mean).all():
            raise ValueError
        np.linalg.cholesky(covariance)
        until_ns = int(document["until_ns"])
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror}; give a directory of --save-state") from None
    except (KeyError, TypeError, ValueError):
        raise InputError(f"{path}: is no state that an estimator has saved; give a directory of --save-state") from None
    return Kept(Learnt(names, mean, covariance), until_ns)

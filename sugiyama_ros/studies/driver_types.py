"""Are there types of drivers, and how sure is that?"""

from typing import Any

import numpy as np
from scipy.cluster.hierarchy import dendrogram, fcluster, linkage
from scipy.spatial.distance import pdist, squareform

from sugiyama_ros.arrays import Array, Ints
from sugiyama_ros.driver.parameters import KAPPA_V, SIGMA_A, V_STAR
from sugiyama_ros.errors import InputError
from sugiyama_ros.fit.driver import calibrate
from sugiyama_ros.studies.study import Answer, Asked, Study

_PLACES, _MOST, _DRAWS = [SIGMA_A, V_STAR, KAPPA_V], 6, 200
# Clusters that the figure shows, as in the paper; there must be more drivers than that.
_SHOWN = 4
# What drivers are whose sigma_a, v* or kappa_v is above the mean, and below it.
_ABOVE, _BELOW = ("unsteady", "fast", "cautious"), ("steady", "slow", "aggressive")
_NAMES = ("sigma_a [m/s²]", "v* [m/s]", "kappa_v [s]")


def silhouette(points: Array, label: Ints) -> float:
    """Measure how well points belong to their clusters.

    points: (N, K), points; label: (N,), cluster of each point.

    References
    ----------
    Rousseeuw, J. Comput. Appl. Math. 20 (1987) 53.
    """
    distance = squareform(pdist(points))
    widths = []
    for i, own in enumerate(label):
        same = (label == own) & (np.arange(len(label)) != i)
        if not same.any():
            widths.append(0.0)
            continue
        inside = distance[i, same].mean()
        nearest = min(distance[i, label == other].mean() for other in np.unique(label) if other != own)
        widths.append((nearest - inside) / max(nearest, inside))
    return float(np.mean(widths))


def adjusted_rand(a: Ints, b: Ints) -> float:
    """Measure how well two clusterings of the same points agree.

    a, b: (N,), cluster of each point.

    References
    ----------
    Hubert and Arabie, J. Classification 2 (1985) 193.
    """
    table = np.array([[np.sum((a == x) & (b == y)) for y in np.unique(b)] for x in np.unique(a)])

    def pairs(n: Array | Ints) -> float:
        return float(np.sum(n * (n - 1) / 2))

    both, rows, columns = pairs(table), pairs(table.sum(axis=1)), pairs(table.sum(axis=0))
    chance = rows * columns / pairs(np.array([len(a)]))
    return (both - chance) / (0.5 * (rows + columns) - chance)


def _type_of(points: Array) -> str:
    """Name a type by its most distinct trait, as the paper does; points: (n, 3), standardised parameters."""
    mean = points.mean(axis=0)
    trait = int(np.argmax(np.abs(mean)))
    return (_ABOVE if mean[trait] > 0.0 else _BELOW)[trait]


def _answer(asked: Asked) -> Answer:
    """Cluster the drivers by standardised sigma_a, v* and kappa_v (Ward's method).

    The number of clusters with the largest silhouette is the best one. To see how stable the clusters are, estimates
    are drawn within their errors and clustered again; the table has the agreement with the first clustering. The figure
    has the tree, and all three planes of the parameters.
    """
    fits = [fit for fit in calibrate(asked.measured, "paper") if fit.identified("v_star")]
    if len(fits) <= _SHOWN:
        raise InputError(
            f"study types: v_star is identified for {len(fits)} drivers; give a recording of at least {_SHOWN + 1}"
        )
    values = np.array([fit.parameters[_PLACES] for fit in fits])
    std = np.array([fit.std[_PLACES] for fit in fits])
    centre, scale = values.mean(axis=0), values.std(axis=0)
    points = (values - centre) / scale
    tree = linkage(points, "ward")
    counts = range(2, min(_MOST, len(fits) - 1) + 1)  # fewer clusters than drivers
    labels = {n: fcluster(tree, n, "maxclust") for n in counts}
    rng = np.random.default_rng(asked.seed)
    rows = []
    for n in counts:
        agreement = []
        for _ in range(_DRAWS):
            drawn = (values + std * rng.standard_normal(values.shape) - centre) / scale
            agreement.append(adjusted_rand(labels[n], fcluster(linkage(drawn, "ward"), n, "maxclust")))
        rows.append(
            {
                "clusters": n,
                "silhouette": silhouette(points, labels[n]),
                "agreement of draws": float(np.mean(agreement)),
                "vehicles": "; ".join(
                    f"{_type_of(points[own])}: {' '.join(str(fits[i].vehicle) for i in np.flatnonzero(own))}"
                    for own in (labels[n] == k for k in np.unique(labels[n]))
                ),
                "drivers": len(fits),
            }
        )

    def draw(figure: Any) -> None:
        (tree_axes, first), (second, third) = figure.subplots(2, 2)
        dendrogram(tree, labels=[fit.vehicle for fit in fits], ax=tree_axes)
        tree_axes.set(xlabel="vehicle", ylabel="distance")
        for axes, (x, y) in zip((first, second, third), ((0, 1), (1, 2), (2, 0)), strict=True):
            for k in np.unique(labels[_SHOWN]):
                own = labels[_SHOWN] == k
                axes.scatter(values[own, x], values[own, y], label=_type_of(points[own]))
            for fit, at in zip(fits, values, strict=True):
                axes.annotate(str(fit.vehicle), at[[x, y]], fontsize="xx-small")
            axes.set(xlabel=_NAMES[x], ylabel=_NAMES[y])
        first.legend(fontsize="x-small")

    return Answer(tuple(rows), draw)


STUDY = Study(
    name="types",
    question="Are there types of drivers?",
    paper="Four broadly meaningful clusters (section 5.3).",
    answer=_answer,
    takes=("source", "seed"),
)

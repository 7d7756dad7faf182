"""How long one posture takes: to be recognised, to become occupancy, and through the node over DDS.

Medians of single calls, taken in one process on one core; what each grows with is measured by changing one thing at a
time. Machines differ and are shared, so ratios within one run say more than the figures.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from humanpred_ros import plugins
from humanpred_ros.errors import UsageError
from humanpred_ros.evaluation.predictor_bench.growth import Growth, growth_of_default, growth_of_reaching
from humanpred_ros.evaluation.predictor_bench.node import NodeResult, bench_nodes
from humanpred_ros.evaluation.predictor_bench.people import People
from humanpred_ros.evaluation.predictor_bench.timing import Timing, update_seconds
from humanpred_ros.human.model import HumanModel
from humanpred_ros.motion.motion import MotionLibrary
from humanpred_ros.occupancy.predictor import PredictorRequest, make_predictor


@dataclass(frozen=True)
class PredictorBench:
    """All that `humanpred bench predictor` measures.

    Attributes:
        library: name of the library; motions, classes: its size.
        recognition: by classifier.
        update: whole update by predictor, recognition included, on P1's grid.
        growth: of the default classifier and predictor, and of reaching with the number of places.
        nodes: the node over DDS, by human and predictor; empty if left out.
    """

    library: str
    motions: int
    classes: int
    recognition: dict[str, Timing]
    update: dict[str, Timing]
    growth: tuple[Growth, ...]
    nodes: tuple[NodeResult, ...]


def bench_predictor(
    library: MotionLibrary,
    demos: MotionLibrary | None = None,
    *,
    n_motions: int,
    folder: Path | None,
    report: Callable[[str], None],
) -> PredictorBench:
    """Measure everything.

    Args:
        library: its first `n_motions` of the first class are played, and not trained on.
        demos: reaches of P2's human, which need no classes; None leaves that human out.
        n_motions: how many.
        folder: new folder where the node's runs are kept; None leaves the node out.
        report: told what is measured next.

    Raises:
        HumanPredError: an unusable library, or a node that failed.
    """
    people = People.of(library, n_motions)
    everybody = [people]
    if demos is not None:
        HumanModel.mocap23().check_dofs(demos.dof_names)
        everybody.append(People.of(demos, n_motions))
    report(f"training on {len(people.training)} motions")
    model, human, grid = people.model, people.human, people.grid()
    if model is None:
        raise UsageError(
            f"bench predictor: wanted a library with classes, {library.name} has none; name another, or "
            "give reaches without classes as --demos"
        )
    recognition = {}
    for name in ("forest", "gmm"):
        report(f"classifier {name}")
        recognition[name] = Timing.of(update_seconds(model.classifier(name), people.played))
    update = {}
    for name in plugins.names(plugins.PREDICTORS):
        report(f"predictor {name}")
        predictor = make_predictor(name, PredictorRequest(human, grid, np.eye(4), model))
        update[name] = Timing.of(update_seconds(predictor, people.played))
    growth = (*growth_of_default(people, model, report), *growth_of_reaching(everybody, report))
    nodes = tuple(bench_nodes(everybody, folder, report)) if folder is not None else ()
    return PredictorBench(library.name, len(library), len(library.labels), recognition, update, growth, nodes)

"""What declared error ellipses change: `python scripts/shape_value.py`.

On patrols of a recording whose errors have a shape, every reader works twice: with the
declared covariances, and with the standard deviations alone. Positions are the same.
Rows print both shares and their difference, with 95 % intervals over walking groups,
of false alarms over routes.
"""

import argparse
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Final

import numpy as np

from attacks.following.logs import follow_fleets
from attacks.reconstruction.gaussian_process import GaussianProcess
from attacks.reconstruction.ou_rts import OuRTS
from isac_track import datasets
from isac_track.command_line import DONE, Parser, exit_code
from isac_track.config import StageSettings
from isac_track.intervals import Estimate, cluster_weights, difference, ratio_estimates
from isac_track.mechanisms.paper import Raw
from isac_track.mechanisms.protections import Ou
from isac_track.patrols import make_patrol
from isac_track.patrols.answers import disclose
from isac_track.patrols.estimators import estimate_positions
from isac_track.patrols.fleet_logs import fleet_log
from isac_track.patrols.intervals import REPLICATES, cluster_numbers, sum_clusters
from isac_track.patrols.knowledge import guesses_from_map
from isac_track.patrols.network import Network, SensedPatrol, sense_patrol, share_sensed
from isac_track.patrols.patrol import Patrol, horizon_scans
from isac_track.patrols.utility import (
    answer_forecasts,
    conflicts_in,
    false_alarm_queries,
    missed_futures,
    true_conflicts,
)
from isac_track.place import placed
from isac_track.policies.samples import Everything, Near
from isac_track.protocols import AttackContext, Mechanism, Predictor
from isac_track.rng import stream
from isac_track.types import (
    Bools,
    Floats,
    Ints,
    Knowledge,
    Tracks,
    derived,
    squared_lengths,
)
from predictors.kalman import KalmanCV, KalmanIMM

_SLOW: Final = Ou(0.4)
_NEAR: Final = Near(6.0)
_ROBOTS: Final = {
    "`kalman_imm`": (Raw(), KalmanIMM(noise="declared")),
    "`kalman_cv`": (Raw(), KalmanCV(noise="declared")),
    "aware robot, `ou:0.4`,": (_SLOW, KalmanCV(noise="declared", aware=True)),
}
_REBUILT: Final = {
    "`gaussian_process` knows": (Raw(), GaussianProcess()),
    "`ou_rts` knows, `ou:0.4`": (_SLOW, OuRTS()),
}


@dataclass(frozen=True, eq=False, slots=True)
class Shares:
    """Hits and trials of N people or routes, and the cluster of each."""

    hits: Floats  # (N,)
    trials: Floats  # (N,)
    cluster: Ints  # (N,)


@dataclass(frozen=True, eq=False, slots=True)
class Task:
    """A sensed patrol and the settings of the comparison."""

    sensed: SensedPatrol
    settings: StageSettings
    guesses: Floats  # (N, 2) m, from the map.

    @property
    def patrol(self) -> Patrol:
        """The patrol."""
        return self.sensed.patrol

    @property
    def epsilon_m(self) -> float:
        """Distance below which a place is known, m."""
        return self.settings.privacy.epsilon_m

    def walk_shares(self, flags: Bools, offsets: Ints) -> Shares:
        """Count flags of people, whose flags lie between offsets."""
        hits = np.add.reduceat(flags.astype(float), offsets[:-1])
        return self.people_shares(hits, np.diff(offsets).astype(float))

    def people_shares(self, hits: Floats, trials: Floats) -> Shares:
        """Return counts of people; walking groups are clusters."""
        return Shares(hits, trials, cluster_numbers(self.patrol.people.group))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command; return its exit code."""
    command = Parser(
        prog="python scripts/shape_value.py",
        description="What declared error ellipses change for readers on patrol.",
    )
    command.add_argument("--dataset", metavar="NAME|PATH", default="students03")
    command.add_argument("--antennas", metavar="N", type=int, default=8)
    command.add_argument("--law", choices=("radial", "isotropic"), default="radial")
    command.add_argument("--segment", metavar="S", type=float)
    command.add_argument("--fleets", metavar="N", type=int, default=20)
    return exit_code(lambda: _run(command.parse_args(arguments)))


def _run(options: argparse.Namespace) -> int:
    recorded = datasets.load(options.dataset).tracks
    print("| keeps | reader | with ellipses | without | difference |")
    print("|:--|:--|--:|--:|--:|")
    for scaling in ("trace", "information"):
        changes = {
            "sensing.measurement": "range_bearing",
            "sensing.scaling": scaling,
            "sensing.n_antennas": options.antennas,
            "sensing.law": options.law,
            "patrol.fleets": options.fleets,
        }
        if options.segment is not None:
            changes["patrol.segment_s"] = options.segment
        task = make_task(recorded, StageSettings().changed(changes))
        for name, shaped, plain in compared(task):
            cells = [_cell(each) for each in (shaped, plain, difference(shaped, plain))]
            print(f"| {scaling} | {name} | {' | '.join(cells)} |", flush=True)
    return DONE


def make_task(recorded: Tracks, settings: StageSettings) -> Task:
    """Sense the people of a recording on patrol."""
    tracks = placed(recorded, settings=settings)
    patrol = make_patrol(tracks, settings=settings, seed=0)
    sensed = sense_patrol(patrol, forecaster=KalmanCV(), settings=settings, seed=0)
    guesses = guesses_from_map(patrol, epsilon_m=settings.privacy.epsilon_m)
    return Task(sensed, settings, guesses)


def compared(task: Task) -> Iterator[tuple[str, Estimate, Estimate]]:
    """Yield each reader with its share, with covariances and without."""
    for name, mechanism, read in _readers(task):
        network = share_sensed(task.sensed, mechanism=mechanism)
        plain = replace(network, release=derived(network.release, cov=None))
        yield name, *_estimates([read(network), read(plain)])


def _readers(
    task: Task,
) -> Iterator[tuple[str, Mechanism, Callable[[Network], Shares]]]:
    for estimator in ("smooth", "radial"):
        yield (
            f"log, `{estimator}` knows",
            Raw(),
            lambda network, by=estimator: known_from_log(task, network, estimator=by),
        )
    yield (
        "chains of `near:6` know",
        Raw(),
        lambda network: known_by_chains(task, network),
    )
    for name, (mechanism, attack) in _REBUILT.items():
        yield (
            name,
            mechanism,
            lambda network, by=attack: known_by_attack(task, network, by),
        )
    for name, (mechanism, robot) in _ROBOTS.items():
        yield (
            f"{name} misses",
            mechanism,
            lambda network, by=robot: missed(task, network, by),
        )
        yield (
            f"{name} alarms falsely",
            mechanism,
            lambda network, by=robot: false_queries(task, network, by),
        )


def known_from_log(task: Task, network: Network, *, estimator: str) -> Shares:
    """Return the known instants of people, if everything is sent."""
    grid = task.patrol.grid
    log = fleet_log(network, disclose(network, Everything()), robots=np.arange(1))
    estimate = estimate_positions(
        log,
        t=grid.t,
        offsets=grid.offsets,
        estimator=estimator,
        fallback_xy=np.repeat(task.guesses, np.diff(grid.offsets), axis=0),
    )
    is_known = squared_lengths(estimate - grid.xy) < task.epsilon_m**2
    return task.walk_shares(is_known, grid.offsets)


def known_by_chains(task: Task, network: Network) -> Shares:
    """Return the instants known by chains of answers, over all fleets."""
    following = follow_fleets(
        network,
        disclose(network, _NEAR),
        estimator="smooth",
        guesses=task.guesses,
        epsilon_m=task.epsilon_m,
        seed=0,
    )
    known = following.known.sum(axis=1)
    trials = following.instants * float(following.known.shape[1])
    return task.people_shares(known.astype(float), trials)


def known_by_attack(
    task: Task, network: Network, attack: OuRTS | GaussianProcess
) -> Shares:
    """Return the samples that an attack with SIGMA rebuilds to within epsilon."""
    people = task.patrol.people
    granted = frozenset({Knowledge.SIGMA, Knowledge.MECHANISM})
    context = AttackContext(
        rng=stream(0, "shape value"),
        epsilon_m=task.epsilon_m,
        granted=granted & (attack.uses | attack.requires),
        mechanism=network.mechanism,
    )
    rebuilt = attack.fit(context)(network.release)
    is_known = squared_lengths(rebuilt.xy - people.xy) < task.epsilon_m**2
    return task.walk_shares(is_known, people.offsets)


def missed(task: Task, network: Network, robot: Predictor) -> Shares:
    """Return the future conflicts of each person that robots miss, and all."""
    patrol = task.patrol
    counts = missed_futures(
        *_conflicts(task, network, robot), horizon=horizon_scans(task.settings)[-1]
    )
    person, n = patrol.presences.person, len(patrol.people)
    hits = (counts.hits & counts.trials).sum(axis=1)
    return task.people_shares(
        np.bincount(person, weights=hits, minlength=n),
        np.bincount(person, weights=counts.trials.sum(axis=1), minlength=n),
    )


def false_queries(task: Task, network: Network, robot: Predictor) -> Shares:
    """Return the queries of each robot with a false alarm, and all; routes alone."""
    patrol = task.patrol
    false = false_alarm_queries(
        patrol,
        *_conflicts(task, network, robot),
        horizon=horizon_scans(task.settings)[-1],
    )
    trials = np.full(patrol.n_robots, float(patrol.query_scan.size))
    return Shares(false.astype(float), trials, np.arange(patrol.n_robots))


def _conflicts(task: Task, network: Network, robot: Predictor) -> tuple[Ints, Ints]:
    """Return the scans until true and foreseen conflicts, (E, R)."""
    patrol, radius_m = task.patrol, task.settings.conflict.safety_radius_m
    answers = answer_forecasts(network, disclose(network, Everything()), robot)
    return (
        true_conflicts(patrol, safety_radius_m=radius_m),
        conflicts_in(patrol, answers, safety_radius_m=radius_m),
    )


def _estimates(shares: Sequence[Shares]) -> list[Estimate]:
    """Return the shares over clusters, with the same draws."""
    cluster = shares[0].cluster
    hits, trials = (
        sum_clusters(np.stack(columns, axis=1), cluster).T
        for columns in (
            [share.hits for share in shares],
            [share.trials for share in shares],
        )
    )
    weights = cluster_weights(
        n_clusters=int(cluster.max()) + 1, n_replicates=REPLICATES, seed=0
    )
    return ratio_estimates(
        numerator=hits,
        denominator=trials,
        weights=weights,
        is_share=[True] * len(hits),
    )


def _cell(estimate: Estimate) -> str:
    value, low, high = (
        100.0 * number for number in (estimate.value, estimate.ci_low, estimate.ci_high)
    )
    return f"{value:.1f} [{low:.1f}, {high:.1f}]"


if __name__ == "__main__":
    sys.exit(main())

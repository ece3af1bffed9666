"""Reconstruction attacks on the log of a fleet: whether they know where people are.

An attack is given true identities, as the estimators of `known_share` are. It knows the
site, the declared errors, the mechanism and, to learn from, what was sent of the other
half of the people, with their true places. It never learns from people it is scored on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

import numpy as np

from attacks.following.logs import first_half
from evaluation.compute.frames import hide_sigma
from evaluation.compute.guards import copy_for_user_plugin, guarded
from evaluation.compute.sharing import call_attack
from isac_track.errors import SettingsError
from isac_track.measurement import scalar_covariance
from isac_track.noise import MIN_VARIANCE_M2
from isac_track.patrols.estimators import estimate_positions
from isac_track.patrols.fleet_logs import Log, fleet_log
from isac_track.protocols import (
    USUAL,
    WALK_KNOWLEDGE,
    AttackContext,
    Reconstructor,
    TrainingSet,
    attack_kind,
    grants,
)
from isac_track.rng import stream
from isac_track.types import (
    Bools,
    Floats,
    Ints,
    Knowledge,
    Release,
    squared_lengths,
    stretches,
)

if TYPE_CHECKING:
    from isac_track.patrols.answers import Disclosure
    from isac_track.patrols.network import Network
    from isac_track.plugins import Plugin

READINGS: Final = ("interpolate", "smooth")
"""Estimators between the reconstructed entries; that which knows more counts."""
_EVERYONE: Final = frozenset({Knowledge.SCENE, Knowledge.SIGMA})
_ORACLE: Final = "oracle"


@dataclass(frozen=True, slots=True)
class LogAttack:
    """An attack on logs, and the adversary that runs it."""

    plugin: Plugin
    adversary: str
    granted: frozenset[Knowledge]


def log_attack(plugin: Plugin) -> LogAttack:
    """Return an attack with all knowledge that it takes and an adversary can have.

    SettingsError for a linkage attack, or if an attack needs more than a log offers.
    """
    if attack_kind(plugin.instance) == "linkage":
        raise SettingsError(
            f"--attack {plugin.spec}: the board runs reconstruction attacks; a linker"
            " runs in evaluation.matrix (--attack, --task)"
        )
    rows = grants(plugin.instance, everyone=_EVERYONE, nobody=WALK_KNOWLEDGE)
    lesser = {name: rows[name] for name in USUAL if name in rows and name != _ORACLE}
    if not lesser:
        needs = sorted(item.name for item in plugin.instance.requires & WALK_KNOWLEDGE)
        raise SettingsError(
            f"--attack {plugin.spec}: it needs {', '.join(needs)}, which a log does"
            " not hold; leave it out"
        )
    adversary, granted = [*lesser.items()][-1]
    return LogAttack(plugin, adversary, granted)


@dataclass(frozen=True, eq=False, slots=True)
class Logs:
    """The answers of a policy to all fleets, and the guesses without."""

    network: Network
    disclosure: Disclosure
    guesses: Floats  # (N, 2) m, places of people without an entry.
    epsilon_m: float  # Distance below which a place is known.
    seed: int

    def fleet(self, number: int) -> Log:
        """Return the log of a fleet."""
        size = self.network.patrol.robots_per_fleet
        return self._log(np.arange(size) + number * size)

    @property
    def everything(self) -> Log:
        """The logs of all fleets together."""
        return self._log(np.arange(self.network.patrol.n_robots))

    def _log(self, robots: Ints) -> Log:
        return fleet_log(self.network, self.disclosure, robots=robots)


def known_by_attack(logs: Logs, attack: LogAttack) -> Ints:
    """Count the instants that each fleet's log reveals through an attack, (N, F).

    The reading between entries is that of `READINGS` which knows more over all people
    and fleets. PluginError names an attack that fails.
    """
    patrol = logs.network.patrol
    is_first = first_half(patrol.people.group)
    halves = is_first, ~is_first
    everything = logs.everything
    fitted = [
        _fit(logs, everything, attack, fold=fold, others=~half)
        for fold, half in enumerate(halves)
    ]
    by_log: dict[bytes, Ints] = {}  # Fleets often hold equal logs; for this call.
    fleets = []
    for number in range(patrol.n_fleets):
        log = logs.fleet(number)
        key = log.sample.tobytes() + log.xy.tobytes()
        if key not in by_log:
            for reconstruct, half in zip(fitted, halves, strict=True):
                log = _attacked(logs.network, log, attack, reconstruct, half)
            by_log[key] = _count(logs, log)
        fleets.append(by_log[key])
    known = np.stack(fleets, axis=-1)
    return np.asarray(known[known.sum(axis=(1, 2)).argmax()])


def _fit(
    logs: Logs, log: Log, attack: LogAttack, *, fold: int, others: Bools
) -> Reconstructor | None:
    """Fit an attack on the log of some people, (N,); None without an entry of them."""
    rows, offsets = _entries(log, others)
    if not rows.size:
        return None
    network, plugin = logs.network, attack.plugin
    release = _as_release(network, log, rows, offsets)
    release = copy_for_user_plugin(hide_sigma(release, attack.granted), plugin)
    truth = network.patrol.people.xy[log.sample[rows]]
    context = AttackContext(
        rng=stream(logs.seed, "board", plugin.spec, "half", fold),
        epsilon_m=logs.epsilon_m,
        granted=attack.granted,
        mechanism=network.mechanism,
        train=TrainingSet(release, truth),
    )
    fitted: Reconstructor = guarded(
        f"attack {plugin.spec!r}", lambda: plugin.instance.fit(context)
    )
    return fitted


def _attacked(
    network: Network,
    log: Log,
    attack: LogAttack,
    reconstruct: Reconstructor | None,
    people: Bools,
) -> Log:
    """Return a log with the entries of some people, (N,), as an attack rebuilds them.

    Without a fitted attack they stay as they were sent.
    """
    rows, offsets = _entries(log, people)
    if reconstruct is None or not rows.size:
        return log
    plugin = attack.plugin
    release = hide_sigma(_as_release(network, log, rows, offsets), attack.granted)
    rebuilt = call_attack(
        reconstruct,
        copy_for_user_plugin(release, plugin),
        name=f"attack {plugin.spec!r}",
    )
    xy, variance = log.xy.copy(), log.variance.copy()
    cov = None if log.cov is None else log.cov.copy()
    xy[rows] = rebuilt.xy
    if rebuilt.std is not None:
        variance[rows] = np.maximum(rebuilt.std**2, MIN_VARIANCE_M2)
        if cov is not None:
            cov[rows] = scalar_covariance(variance[rows])
    return replace(log, xy=xy, variance=variance, cov=cov)


def _entries(log: Log, people: Bools) -> tuple[Ints, Ints]:
    """Return rows and offsets of the entries of those people who have entries."""
    sizes = np.diff(log.offsets)
    rows = np.flatnonzero(people & (sizes > 0))
    return stretches(log.offsets[rows], sizes[rows])


def _as_release(network: Network, log: Log, rows: Ints, offsets: Ints) -> Release:
    """Return entries of a log as a release, with the declared standard deviations."""
    per_axis = 1.0 if network.sensed.law == "isotropic" else 0.5
    return Release(
        t=log.t[rows],
        xy=log.xy[rows],
        sigma=np.sqrt(log.variance[rows] / per_axis),
        offsets=offsets,
        pseudonym=tuple(map(str, range(offsets.size - 1))),
        cov=None if log.cov is None else log.cov[rows],
    )


def _count(logs: Logs, log: Log) -> Ints:
    """Count the known instants of each person by each of `READINGS`, (K, N)."""
    grid = logs.network.patrol.grid
    guess = np.repeat(logs.guesses, np.diff(grid.offsets), axis=0)
    counts = []
    for reading in READINGS:
        estimate = estimate_positions(
            log, t=grid.t, offsets=grid.offsets, estimator=reading, fallback_xy=guess
        )
        is_known = squared_lengths(estimate - grid.xy) < logs.epsilon_m**2
        counts.append(np.add.reduceat(is_known.astype(np.int64), grid.offsets[:-1]))
    return np.stack(counts)

"""Simulated runs in which it is known whether a descriptor measures linkability.

No tracks and no attack: people, mechanism levels, and for each level how much of a
person shows (the descriptor) and how often the person is linked. A world is *valid* if
success is one function of the descriptor whatever the mechanism, *fooled* if the
dissociation controls lower the descriptor and leave success as it is, *flat* if nothing
lowers success, *empty* if nothing has any effect.
"""

from dataclasses import dataclass

import numpy as np
from helpers.addresses import address_at
from helpers.estimates import ratio_estimate
from helpers.mechanisms import RULE, make_sweeps
from scipy.stats import norm

from evaluation.estimates.linked_people import LinkedProbes
from evaluation.estimates.metrics import EQUAL_ALARMS
from evaluation.estimates.strongest import strongest_by_task
from evaluation.plan.address import parse_consumer
from evaluation.plan.presets import SHARED
from evaluation.verdict.sections import build_verdict, linked_people_sections
from evaluation.verdict.verdict_json import verdict_json

KINDS = ("valid", "fooled", "flat", "empty")
RULES = ("", RULE)
FIXED, FID = (0.2, 0.5, 0.8, 1.0), (1.0, 100.0, 1e4)
CONTROLS = ("correlated", "offset", "thin")
LINKER, TASK, CHANCE = "rerelease/shape", "rerelease", 0.01
SMOOTHER = "kalman_rts"
PREDICTOR = "least_squares"
SCALES = {"plr": 1.0, "ael": 2.0, "mel": 5.0}


@dataclass(frozen=True)
class World:
    kind: str
    n_people: int = 240
    n_replicates: int = 200
    stranger: bool = False
    """Whether to add a user's mechanism, without an adding rule: fixed noise."""

    def levels(self):
        """Family, level and mechanism, in the order of a run."""
        yield "raw", None, "raw"
        for rule in RULES:
            yield from (("fixed", level, f"fixed{rule}") for level in FIXED)
            yield from (("fid", level, f"fid{rule}") for level in FID)
            yield "correlated", 0.75, f"correlated{rule}"
            yield (
                "thin",
                4.0,
                f"thin:{rule.removeprefix(':')}{',' * bool(rule)}d_sigma=0.75",
            )
        yield "offset", 0.3, "offset"
        yield "thin", 4.0, "thin"
        yield from (("mine:Ou", level, "mine:Ou") for level in FIXED if self.stranger)

    def noise(self, family, level):
        """How strong a level is, 0 (raw) to 1."""
        strength = {"raw": 0.0, "correlated": 0.8, "offset": 0.5, "thin": 0.3}
        if family == "fid":
            return {1.0: 0.75, 100.0: 0.6, 1e4: 0.3}[level]
        return strength.get(family, level)

    def shows(self, family, level):
        """Mean descriptor."""
        return 0.5 if self.kind == "empty" else 0.55 - 0.4 * self.noise(family, level)

    def links(self, family, level):
        """Probability that a person is linked."""
        if self.kind == "empty":
            return CHANCE
        if self.kind == "flat" or (self.kind == "fooled" and family in CONTROLS):
            return 0.75
        return 0.75 - (0.55 - self.shows(family, level)) * 1.2

    def misses(self, family, level):
        if self.kind == "empty":
            return 0.2
        # FID costs less for what it hides.
        return 0.1 + (0.2 if family == "fid" else 0.3) * self.noise(family, level)


def run(world, *, seed):
    """Return the verdict of a world."""
    estimates, levels = simulated(
        world, rng=np.random.default_rng([seed, KINDS.index(world.kind)])
    )
    return planted_verdict(estimates, {TASK: levels})


def planted_verdict(estimates, levels):
    """Return the verdict of estimates and of the tracks of each task's levels."""
    manifest = {
        "dataset": {"name": "planted", "simulated": True},
        "identity": {"seed": 0},
        "settings": {"preset": "paper", "scenes": 500, "predictors": [PREDICTOR]},
    }
    sweeps = make_sweeps(estimates)
    best = strongest_by_task(estimates, sweeps.families)
    about = {"strongest": best, "manifest": manifest}
    linked_people = linked_people_sections(levels, sweeps, **about)
    return verdict_json(build_verdict(sweeps, linked_people, **about))


def simulated(world, *, rng):
    """Return every metric of a run and the tracks of its levels."""
    n = world.n_people
    cluster = np.arange(n) // 2  # people walk in pairs
    n_pairs = n // 2
    weights = (
        rng.multinomial(n_pairs, np.full(n_pairs, 1 / n_pairs), world.n_replicates)
        * 1.0
    )
    own, habit = rng.normal(size=n), rng.normal(size=n)
    habit = 0.7 * habit + 0.7 * np.repeat(rng.normal(size=n // 2), 2)
    nuisance = rng.normal(size=(n, 2))
    estimates, levels = {}, []

    def put(key, values, *, share=True):
        sums = {
            "numerator": values.reshape(-1, 2).sum(axis=1),
            "denominator": np.full(n_pairs, 2.0),
        }
        estimates[key] = ratio_estimate(**sums, weights=weights, is_share=share)

    for family, level, mechanism in world.levels():
        mean, linked = world.shows(family, level), world.links(family, level)
        luck = rng.normal(size=n)
        plr = np.clip(mean * np.exp(0.25 * own + 0.25 * luck - 0.06), 0, 1)
        drawn = 0.6 * habit + 0.8 * rng.normal(size=n)
        if world.kind == "valid":  # what shows of a track is what links it
            drawn = 0.6 * drawn + 0.8 * luck
            drawn *= -1.0
        hit = (drawn < norm.ppf(linked)).astype(float)
        for metric, scale in SCALES.items():
            noisy = scale * plr * np.exp(0.05 * rng.normal(size=n))
            put(address_at(mechanism, level, SHARED, metric), noisy, share=False)
            rebuilt = noisy * (1.0 if world.kind == "empty" else 1.5)
            after = rebuilt * np.exp(0.05 * rng.normal(size=n) - 0.05**2 / 2)
            put(
                address_at(mechanism, level, SMOOTHER, metric, "informed"),
                after,
                share=False,
            )
        put(address_at(mechanism, level, LINKER, "rank1", "informed"), hit)
        put(
            address_at(mechanism, level, LINKER, "chance", "informed"),
            np.full(n, CHANCE),
            share=False,
        )
        for metric in ("missed_conflict_rate", EQUAL_ALARMS):
            missed = rng.random(n) < world.misses(family, level)
            put(address_at(mechanism, level, PREDICTOR, metric), missed.astype(float))
        seen = np.column_stack([plr, plr * np.exp(0.02 * rng.normal(size=n))])
        descriptors = {name: seen * scale for name, scale in SCALES.items()}
        levels.append(
            LinkedProbes(
                mechanism,
                level,
                parse_consumer(LINKER, "informed"),
                hit,
                hit,
                np.full(n, CHANCE),
                cluster,
                tuple(map(str, range(n_pairs))),
                descriptors,
                nuisance,
                strangers=np.ones((3, n), dtype=int),
            )
        )
    return estimates, levels

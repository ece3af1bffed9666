"""The records of patrols as `verdict.json` has them, written and read."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from evaluation.estimates.families import Family
from evaluation.estimates.json_numbers import json_interval, read_interval
from evaluation.estimates.patrols import PatrolNumber
from evaluation.verdict.patrol_records import (
    USUAL_LIMITS,
    PatrolLimits,
    PatrolOption,
    PatrolProposal,
)
from evaluation.verdict.patrols import (
    choose_policy,
    farthest_horizon,
    lacking_part,
    patrol_options,
)


def patrols_json(
    numbers: Sequence[PatrolNumber], *, families: Mapping[str, Family]
) -> dict[str, Any]:
    """Return the options of a run and the usual proposal: `patrols` of the verdict."""
    options = patrol_options(numbers, families=families)
    proposal = choose_policy(options, USUAL_LIMITS, horizon_s=farthest_horizon(options))
    return {
        "recommended": proposal_json(proposal),
        "options": [option_json(option) for option in options],
        "lacks": lacking_part(numbers),
        "by_construction": _built_in(numbers),
    }


def option_json(option: PatrolOption) -> dict[str, Any]:
    """Return an option; ends of an interval that is not there are None."""
    return {
        "robot": option.robot,
        "horizon_s": option.horizon_s,
        "mechanism": option.mechanism,
        "level": option.level,
        "policy": option.policy,
        "may_be_proposed": option.may_be_proposed,
        **json_interval("missed", option.missed),
        **json_interval("lost", option.lost),
        **json_interval("known", option.known),
        **json_interval("followed", option.followed),
        "n": option.n,
    }


def proposal_json(proposal: PatrolProposal | None) -> dict[str, Any]:
    """Return a proposal; empty if there is none."""
    if proposal is None:
        return {}
    proposed = option_json(proposal.option)
    return {
        "robot": proposal.robot,
        "horizon_s": proposal.horizon_s,
        "limits": proposal.limits.named,
        "everything": option_json(proposal.everything),
        "best": proposed if proposal.is_within else None,
        "nearest": None if proposal.is_within else proposed,
        "has_interval": proposal.has_interval,
    }


def read_options(patrols: Mapping[str, Any]) -> list[PatrolOption]:
    """Return the options in `patrols` of a verdict, which may be empty."""
    return [_read_option(content) for content in patrols.get("options", ())]


def read_proposal(patrols: Mapping[str, Any]) -> PatrolProposal | None:
    """Return the usual proposal in `patrols` of a verdict; None if it has none."""
    content = patrols.get("recommended")
    if not content:
        return None
    best = content["best"]
    return PatrolProposal(
        robot=content["robot"],
        horizon_s=content["horizon_s"],
        limits=PatrolLimits(**{"lost": None} | content["limits"]),
        everything=_read_option(content["everything"]),
        option=_read_option(best or content["nearest"]),
        is_within=best is not None,
    )


def _read_option(content: Mapping[str, Any]) -> PatrolOption:
    return PatrolOption(
        robot=content["robot"],
        horizon_s=content["horizon_s"],
        mechanism=content["mechanism"],
        level=content["level"],
        policy=content["policy"],
        may_be_proposed=content["may_be_proposed"],
        missed=read_interval(content, "missed"),
        lost=read_interval(content, "lost"),
        known=read_interval(content, "known"),
        followed=read_interval(content, "followed"),
        n=content["n"],
    )


def _built_in(numbers: Iterable[PatrolNumber]) -> list[dict[str, Any]]:
    """Return the robots whose `withheld_share` follows from the construction."""
    return [
        {
            "mechanism": number.address.mechanism,
            "level": number.address.level,
            "policy": number.address.policy,
            "consumer": number.address.consumer,
            "world": number.address.world.text,
        }
        for number in numbers
        if number.is_by_construction
    ]

"""Addresses of numbers, from the columns of a row."""

from evaluation.plan.address import Address, parse_consumer
from evaluation.store.entries import Entry


def address_at(
    mechanism: str,
    level: float | None,
    consumer: str,
    metric: str,
    knowledge: str = "",
) -> Address:
    """Return the address of a metric of a consumer at a level."""
    return parse_consumer(consumer, knowledge).measured(metric).at(mechanism, level)


def entry_at(consumer, knowledge="", *, kind="shared", where=("raw", None), **fields):
    """An entry of a manifest: a consumer at a mechanism and level."""
    mechanism, level = where
    address = parse_consumer(consumer, knowledge).at(mechanism, level)
    return Entry(address, kind, **{"spec": mechanism} | fields)

"""Addresses of numbers, from the columns of a row."""

from evaluation.plan.address import Address, parse_consumer


def address_at(
    mechanism: str,
    level: float | None,
    consumer: str,
    metric: str,
    knowledge: str = "",
) -> Address:
    """Return the address of a metric of a consumer at a level."""
    return parse_consumer(consumer, knowledge).measured(metric).at(mechanism, level)

"""The project's own metrics against the metric suite."""

from __future__ import annotations

from isac_track.testing import OWN, parametrize_metric_checks


@parametrize_metric_checks(OWN)
def test_own_metrics(check):
    check()

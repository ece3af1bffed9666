"""What ellipses change: each reader twice, on the same positions."""

import shape_value

from isac_track.config import StageSettings
from isac_track.intervals import difference

FEW = StageSettings().changed(
    {
        "sensing.measurement": "range_bearing",
        "sensing.scaling": "information",
        "sensing.n_antennas": 3,
        "patrol.fleets": 2,
        "patrol.segment_s": 10.0,
    }
)


def test_each_reader_works_with_and_without_ellipses(tracks):
    gaps = {
        name: difference(shaped, plain)
        for name, shaped, plain in shape_value.compared(
            shape_value.make_task(tracks, FEW)
        )
    }
    assert len(gaps) == 11
    assert gaps["log, `smooth` knows"].value > 0.0
    assert gaps["`gaussian_process` knows"].value > 0.0
    assert all(abs(gap.value) < 0.3 for gap in gaps.values())

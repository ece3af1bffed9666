"""The baseline: where everybody was last seen, by a plain loop over tracks."""

import numpy as np

from isac_track import plugins
from isac_track.types import Release


def test_everybody_stays_where_they_were_last_shared():
    (plugin,) = plugins.parse("predictors", "constant_position")
    offsets, xy = np.array([0, 3, 4]), np.arange(8.0).reshape(4, 2)
    release = Release(np.array([0.0, 1.0, 2.0, 5.0]), xy, None, offsets, ("a", "b"))
    prediction = plugin.instance.predict(release, np.array([[3.0, 9.0], [6.0, 7.0]]))
    for track, mean in zip(release, prediction.mean, strict=True):
        assert [*map(tuple, mean)] == [tuple(track.xy[-1])] * 2
    assert prediction.cov is None

"""Sensed pedestrian tracks, shared: the pipeline of the paper and its privacy descriptors.

Import the stages as modules (``from isac_track import sensing, sharing, privacy``): each
file is one stage, data flows one way (see ``docs/``).
"""

__version__ = "0.1.0"

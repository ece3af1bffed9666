"""The plan of a run: presets, settings, axes; no module here computes anything."""

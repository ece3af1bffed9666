"""What a run crosses: presets, settings, axes and the plan; nothing is computed here."""

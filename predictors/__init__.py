"""The robot's forecasts of where pedestrians will be, one file each."""

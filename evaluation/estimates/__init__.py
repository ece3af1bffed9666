"""Estimates from finished cells: no prose, no ink."""

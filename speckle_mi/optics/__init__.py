"""Geometrical optics of the way from target to detector: surfaces, exact tracing, ray aiming, interpolated paths."""

"""Coherent sums from points to points: the one propagator behind free space, apertures and pupils."""

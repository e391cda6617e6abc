"""Optical surfaces, exact ray tracing and ray aiming in float64."""

"""Rigid motions, frames, planes of points and outlines: the geometry that everything else is written in."""

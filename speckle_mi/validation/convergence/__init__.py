"""Error against run time of every method on a scene."""

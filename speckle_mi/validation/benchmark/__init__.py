"""Run times beside peers, measured in one run."""

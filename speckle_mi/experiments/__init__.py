"""Many frames together: sweeps of the target, and what theory expects of them."""

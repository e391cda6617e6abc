"""Stiff and extreme cases, each against an independent reference: where the computation holds, and where it says no."""

"""The complex field on the detector: the stages of the plan, summed."""

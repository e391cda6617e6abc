"""What a designer asks of many assemblies: what tolerances do to one, which is best, what the best would be."""

"""What results look like: tables, plots, text."""

"""Stiff and extreme cases against independent references."""

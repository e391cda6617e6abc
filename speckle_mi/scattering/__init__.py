"""The beam on the rough surface: scatterers that belong to the material."""

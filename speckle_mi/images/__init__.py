"""Field images and other pictures, read and written."""

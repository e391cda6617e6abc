"""What a scene holds, as plain float64 data, and how it is read and written."""

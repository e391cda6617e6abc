"""What is measured on images: shift and correlation, centre of gravity, speckle statistics, sensitivities."""

"""From measurements to parameters: alignment of frames, least squares, robust and recursive fits, choice of terms."""

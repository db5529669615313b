"""Identification from measurements: alignment of frames, least squares, robust and recursive fits, choice of terms."""

"""Boards and cameras: printing a board, detecting its corners in pictures, reading and writing lenses."""

"""Boards and cameras: printing a board, finding its corners in pictures, reading and writing lenses."""

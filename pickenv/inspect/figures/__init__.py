"""Figures for papers and reports."""

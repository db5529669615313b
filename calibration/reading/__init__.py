"""Measured files of any instrument, through descriptions of their columns."""

"""Readers of measurement files of any instrument; a description of the columns says how a file is laid out."""

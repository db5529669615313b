"""Run folders, and the numbers behind figures, recordings and reports."""

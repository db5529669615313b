"""Tolerance studies: populations of arms, each drawn, calibrated and sent to fruit; what share of them is good enough.

A study (`config`) is a list of settings; every setting is run on the same arms, fruit and calibration poses. Chunks of
arms go to an executor (`executors`), their rows into a Parquet data set (`table`) that a killed study resumes from.
"""

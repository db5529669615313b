"""The multi-arm harvester of Li 2016: machine, pick points, zones, assignment, interference, and picking with it."""

"""The environment Harvest: picking with the multi-arm machine of Li 2016."""

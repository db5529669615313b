"""Harvest: the machine of Li 2016 as an environment."""

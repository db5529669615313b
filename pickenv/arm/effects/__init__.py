"""Causes of an arm's error, as subclasses of `Effect`."""

"""Recorded episodes, and networks that learn from them alone."""

"""Recorded episodes, and networks that learn from recorded episodes alone."""

"""Scripted, visual-servoing, adaptive and learned policies."""

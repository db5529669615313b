"""The kinds of measurement beyond poses and positions: what each reads, and the unknowns that it brings along."""

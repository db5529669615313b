"""The true arm: geometry and effects together, drawn, read from files, moved."""

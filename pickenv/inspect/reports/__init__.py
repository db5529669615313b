"""Pages: one HTML file without outside resources each."""

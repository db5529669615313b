"""Report pages, each one HTML file without outside resources."""

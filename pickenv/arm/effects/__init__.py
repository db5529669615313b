"""What makes an arm miss: one file per effect."""

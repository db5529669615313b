"""What runs leave on disk, and the numbers that pictures start from."""

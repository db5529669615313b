"""Arms as files: TOML and URDF in."""

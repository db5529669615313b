"""Arms as files: TOML, URDF, MJCF and UR kinematics in, URDF out."""

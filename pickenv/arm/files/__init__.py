"""Read arms from TOML, URDF, MJCF and UR kinematics files, and write them as URDF or MJCF."""

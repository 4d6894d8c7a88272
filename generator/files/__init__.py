"""File formats: pictures, TOML, meshes, and limits on what a file may claim to hold."""

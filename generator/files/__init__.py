"""How things lie on disk: pictures, TOML, meshes, and what a file may claim before it is believed."""

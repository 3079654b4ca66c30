"""Files people write and read: TOML, meshes, poses, results, presets."""

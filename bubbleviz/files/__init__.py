"""File formats: TOML, meshes, poses, results, presets."""

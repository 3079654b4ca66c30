"""The depth camera: intrinsics to rays, range images, ray casting, the operators D and S."""

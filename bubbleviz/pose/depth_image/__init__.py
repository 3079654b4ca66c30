"""The pose by the whole depth image: the exact membrane pressed by the object."""

"""Bodies in images, whole poses, steering of meshes and avatars."""

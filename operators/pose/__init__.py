"""From markers on a body to the pose of its whole skeleton."""

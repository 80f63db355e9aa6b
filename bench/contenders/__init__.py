"""The engines that are compared, one file each; a file runs in that engine's own environment."""

"""A segmentation against annotations: readers, scores, pictures, and the command."""

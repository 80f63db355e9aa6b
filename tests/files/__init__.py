"""Files of other programs, in and out, and files from strangers."""

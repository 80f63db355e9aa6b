"""Features of a posture or a muscle at one moment, for neighbours and segmentation to compare (thesis, sections 2.1 to 2.4)."""
